"""The batched environment as a `VecEnv` of stable-baselines3, whose own wrappers refuse Gymnasium's vector environments."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv

from fbl_gym.arm import Array
from fbl_gym.env_common import check_reset_options


class ArmVecEnv(VecEnv):
    """A `TwoLinkArmVectorEnv`, wrapped or not, for SB3: bit for bit a `DummyVecEnv` of as many single environments.

    Args:
        env: in SAME_STEP mode, so that the step that ends an episode returns the next one's first observation.
    """

    def __init__(self, env: VectorEnv) -> None:
        mode = env.metadata["autoreset_mode"]
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f'env must be made with autoreset_mode="SameStep", got {mode.value!r}')
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = dict(env.metadata)

    def reset(self) -> Array:
        """Start an episode in every lane, with the seeds of `seed()` if it was called since the last reset."""
        for options in self._options:
            check_reset_options(options, ())
        observations, _ = self.env.reset(seed=self._seeds)  # type: ignore[arg-type]
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return observations

    def step_async(self, actions: Array) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        observations, rewards, terminated, truncated, more = self.env.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": cut} for cut in (truncated & ~terminated).tolist()]
        for lane in np.flatnonzero(done):
            infos[lane]["terminal_observation"] = more["final_obs"][lane]
            self.reset_infos[lane] = {}
        return observations, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> list[Any]:
        """A frame of each lane."""
        return list(self.env.render() or ())

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute for each lane: of `truth` the lane's own part, of anything else what all lanes share."""
        lanes = self._get_indices(indices)
        value = getattr(self.env, attr_name) if hasattr(self.env, attr_name) else getattr(self.env.unwrapped, attr_name)
        if attr_name == "truth":
            parts = vars(value).items()
            return [dataclasses.replace(value, **{name: part[lane] for name, part in parts}) for lane in lanes]
        return [value for _ in lanes]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ARG002
        raise AttributeError(f"the lanes share one environment: make it with {attr_name}={value!r}, for all or none")

    def env_method(self, method_name: str, *_: Any, **__: Any) -> list[Any]:
        raise AttributeError(f"the lanes share one environment, so none has a method {method_name!r} of its own")

    def env_is_wrapped(self, _: type, indices: Any = None) -> list[bool]:
        """False: no lane is wrapped on its own."""
        return [False for _ in self._get_indices(indices)]
