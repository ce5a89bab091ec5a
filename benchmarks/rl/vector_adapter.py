"""The batched environment as an agent in training sees it: its observations and its actions."""

from __future__ import annotations

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
