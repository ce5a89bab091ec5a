"""The batched environment as a `VecEnv` of stable-baselines3."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from stable_baselines3.common.vec_env import VecEnv

from benchmarks.rl.vector_adapter import check_same_step
from fbl_gym.arm import Array
from fbl_gym.env_common import check_reset_options


class ArmVecEnv(VecEnv):
    """A `VecEnv` of SB3 over a `TwoLinkArmVectorEnv`, equal to a `DummyVecEnv` bit for bit.

    The environment, wrapped or not, is in SAME_STEP mode: the last step of an episode returns the
    first observation of the next.
    """

    def __init__(self, env: VectorEnv) -> None:
        check_same_step(env)
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = dict(env.metadata)

    def reset(self) -> Array:
        """Start an episode in every lane, with the seeds of `seed()` if it was called since."""
        for options in self._options:
            check_reset_options(options, ())
        observations, _ = self.env.reset(seed=self._seeds)  # type: ignore[arg-type]
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return observations

    def step_async(self, actions: Array) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        """Take one step; return observations, rewards, dones and infos as SB3 defines them."""
        observations, rewards, terminated, truncated, batch_infos = self.env.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": cut} for cut in (truncated & ~terminated).tolist()]
        if "cost" in batch_infos:
            last = batch_infos.get("final_info", batch_infos)["cost"]
            for info, cost in zip(infos, np.where(done, last, batch_infos["cost"]).tolist(), strict=True):
                info["cost"] = cost
        for lane in np.flatnonzero(done):
            infos[lane]["terminal_observation"] = batch_infos["final_obs"][lane]
            self.reset_infos[lane] = {}
        return observations, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> list[Any]:
        """Return a frame of each lane."""
        return list(self.env.render() or ())

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute for each lane: its part of `truth`, else the common value."""
        lanes = self._get_indices(indices)
        value = getattr(self.env, attr_name) if hasattr(self.env, attr_name) else getattr(self.env.unwrapped, attr_name)
        if attr_name == "truth":
            parts = vars(value).items()
            return [dataclasses.replace(value, **{name: part[lane] for name, part in parts}) for lane in lanes]
        return [value for _ in lanes]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ARG002
        """Raise an `AttributeError`, since the lanes share one environment."""
        raise AttributeError(f"the lanes share one environment: make it with {attr_name}={value!r} for all lanes")

    def env_method(self, method_name: str, *_: Any, **__: Any) -> list[Any]:
        """Raise an `AttributeError`, since the lanes share one environment."""
        raise AttributeError(f"the lanes share one environment: a single lane has no method {method_name!r}")

    def env_is_wrapped(self, _: type, indices: Any = None) -> list[bool]:
        """Return False for each lane, since no lane has wrappers."""
        return [False for _ in self._get_indices(indices)]
