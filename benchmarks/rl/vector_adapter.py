"""The batched environment as an agent in training sees it: its observations and its actions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from benchmarks.rl.adapter import AdapterSettings, AgentAdapter
from controllers.policy import where_lanes
from fbl_gym.arm import Array
from fbl_gym.interface import Interface


def check_same_step(env: VectorEnv) -> None:
    """Refuse an environment whose last step of an episode does not start the next one."""
    mode = env.metadata["autoreset_mode"]
    if mode != AutoresetMode.SAME_STEP:
        raise ValueError(f'env must be made with autoreset_mode="SameStep", got {mode.value!r}')


class VectorAdapter(VectorWrapper):
    """A wrapper with an agent's observations and actions, for an environment in SAME_STEP mode."""

    def __init__(self, env: VectorEnv, settings: AdapterSettings) -> None:
        super().__init__(env)
        check_same_step(env)
        self._interface: Interface = env.unwrapped.interface  # type: ignore[attr-defined]
        self._adapter = AgentAdapter(settings, self._interface)
        self.single_observation_space = spaces.Box(-10.0, 10.0, (self._adapter.size,), dtype=np.float64)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every lane, as Gymnasium's `VectorEnv.reset`."""
        self._observation, infos = self.env.reset(seed=seed, options=options)
        self._state = self._adapter.initial(self._observation)
        return self._observe(), infos

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Take one step with the agent's actions [n x 2], as Gymnasium's `VectorEnv.step`."""
        torque, state = self._adapter.torque(actions, self._observation, self._state)
        q, v = (self._observation[:, self._interface.layout[name]] for name in ("position", "velocity"))
        self._observation, rewards, terminated, truncated, infos = self.env.step(
            self._interface.action_from_torque(torque, q, v)
        )
        if "final_obs" in infos:
            done, final = infos["_final_obs"], infos["final_obs"]
            for lane in np.flatnonzero(done):
                # The truth is already that of the next episode, so take the context of one step
                # before.
                lane_state, context = tuple(part[lane : lane + 1] for part in state), self._context[lane : lane + 1]
                final[lane] = self._adapter.observe(final[lane][None], lane_state, context)[0]
            state = where_lanes(done, self._adapter.initial(self._observation), state)
        self._state = state
        return self._observe(), rewards, terminated, truncated, infos

    def _observe(self) -> Array:
        self._context = self._adapter.context(self.env, self.num_envs)
        return self._adapter.observe(self._observation, self._state, self._context)


class SideBySide(VectorEnv[Array, Array, Array]):
    """Several environments of the same spaces as one, each with its lanes; all in SAME_STEP mode.

    Args:
        envs: one or more; their lanes follow one another.
    """

    def __init__(self, envs: Sequence[VectorEnv]) -> None:
        for env in envs:
            check_same_step(env)
        self.envs, self.metadata = tuple(envs), envs[0].metadata
        ends = np.cumsum([env.num_envs for env in envs])
        self._cuts, self.num_envs = ends[:-1], int(ends[-1])
        self.single_observation_space = envs[0].single_observation_space
        self.single_action_space = envs[0].single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every lane; `seed` has one for each lane, or is None."""
        seeds = [None] * len(self.envs) if seed is None else [part.tolist() for part in np.split(seed, self._cuts)]
        pairs = zip(self.envs, seeds, strict=True)
        return np.concatenate([env.reset(seed=part, options=options)[0] for env, part in pairs]), {}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Take one step with the actions [n x 2], as Gymnasium's `VectorEnv.step`."""
        parts = zip(self.envs, np.split(actions, self._cuts), strict=True)
        *signals, infos = zip(*(env.step(part) for env, part in parts), strict=True)
        observations, rewards, terminated, truncated = (np.concatenate(signal) for signal in signals)
        done = terminated | truncated
        if not done.any():
            return observations, rewards, terminated, truncated, {}
        none = [np.full(env.num_envs, None, dtype=object) for env in self.envs]
        final = np.concatenate([info.get("final_obs", empty) for info, empty in zip(infos, none, strict=True)])
        return observations, rewards, terminated, truncated, {"final_obs": final, "_final_obs": done}

    def close(self, **kwargs: Any) -> None:
        """Close the environments."""
        for env in self.envs:
            env.close(**kwargs)
