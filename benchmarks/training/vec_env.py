"""The batched environment for training: with an agent's view of it, and as SB3's `VecEnv`."""

from itertools import chain
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from stable_baselines3.common.vec_env import VecEnv

from benchmarks.agents.adapter import AdapterSettings, AgentAdapter
from controllers.base import where_lanes
from controllers.registry import interface_of
from fbl_gym.envs.env_common import check_reset_options
from fbl_gym.envs.side_by_side import SideBySideVectorEnv
from fbl_gym.model.arm import Array


class VectorAdapter(VectorWrapper):
    """A wrapper with an agent's observations and actions, for an environment in SAME_STEP mode.

    A step lasts until the agent's next decision, and its reward is the mean one. Where an episode
    ends within a step, the law under the agent begins the next one alone.

    Attributes:
        decision: time between two decisions [s].
    """

    def __init__(self, env: VectorEnv, settings: AdapterSettings) -> None:
        super().__init__(env)
        self._interface = interface_of(env)
        self._adapter = AgentAdapter(settings, self._interface)
        self.decision = self._adapter.hold * self._interface.control_dt
        self.single_observation_space = spaces.Box(-10.0, 10.0, (self._adapter.size,), dtype=np.float64)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every lane, as Gymnasium's `VectorEnv.reset`."""
        self._observation, infos = self.env.reset(seed=seed, options=options)
        state, mask = self._adapter.initial(self._observation), (options or {}).get("reset_mask")
        self._state: Any = state if mask is None else where_lanes(mask, state, self._state)
        return self._adapter.observe(self._observation, self._state), infos

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Take one step with the agent's actions [n x 2], as Gymnasium's `VectorEnv.step`."""
        adapter, layout = self._adapter, self._interface.layout
        total, final = np.zeros(self.num_envs), np.full(self.num_envs, None, dtype=object)
        ends, begun, ended = np.zeros((2, self.num_envs), dtype=bool), dict[str, Any](), dict[str, Any]()
        state = self._state._replace(age=np.zeros_like(self._state.age))  # the agent decides in every lane
        for _ in range(adapter.hold):
            torque, state = adapter.torque(actions, self._observation, state)
            q = self._observation[:, layout["position"]]
            v = self._observation[:, layout["velocity"]] if "velocity" in layout else np.zeros_like(q)
            given = self._interface.action_from_torque(torque, q, v)
            self._observation, rewards, terminated, truncated, infos = self.env.step(given)
            running, done = ~ends.any(axis=0), np.logical_or(terminated, truncated)
            total[running] += rewards[running]
            if done.any():
                last = self._observation.copy()
                last[done] = np.stack(infos["final_obs"][done])
                observed = adapter.observe(last, state)
                for lane in np.flatnonzero(running & done):
                    final[lane] = observed[lane]
                context = {name: infos[name] for name in ("context", "_context") if name in infos}
                for found, kept in ((context, begun), (infos.get("final_info", {}), ended)):
                    for name, values in found.items():
                        kept[name] = where_lanes(running & done, values, kept.get(name, np.zeros_like(values)))
                ends |= running & np.array([terminated, truncated], dtype=bool)
                state = where_lanes(done, adapter.initial(self._observation), state)
            state = state._replace(age=np.maximum(state.age, 1))
        if ends.any():
            infos |= {"final_obs": final, "_final_obs": ends.any(axis=0), **begun}
            infos |= {"final_info": ended, "_final_info": ends.any(axis=0)}
        self._state = state
        return adapter.observe(self._observation, state), total / adapter.hold, *ends, infos


class ArmVecEnv(VecEnv):
    """A `VecEnv` of SB3 over one or more `TwoLinkArmVectorEnv` of the same spaces, wrapped or not.

    The lanes of the environments follow one another. Each environment is in SAME_STEP mode: the
    last step of an episode returns the first observation of the next. A step is equal to that of a
    `DummyVecEnv` bit for bit.
    """

    def __init__(self, *envs: VectorEnv) -> None:
        for mode in (env.metadata["autoreset_mode"] for env in envs):
            if mode != AutoresetMode.SAME_STEP:
                raise ValueError(f'env must be made with autoreset_mode="SameStep", got {mode.value!r}')
        parts = (env.envs if isinstance(env, SideBySideVectorEnv) else (env,) for env in envs)
        self._batch = batch = SideBySideVectorEnv(*chain(*parts))
        super().__init__(batch.num_envs, batch.single_observation_space, batch.single_action_space)
        self.metadata = batch.metadata

    def reset(self) -> Array:
        """Start an episode in every lane, with the seeds of `seed()` if it was called since.

        Each environment has the seeds from the first on.
        """
        for options in self._options:
            check_reset_options(options, ())
        observations, infos = self._batch.reset(seed=self._seeds[0])
        self.reset_infos = _split(infos, [{} for _ in range(self.num_envs)])
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: Array) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        """Take one step; return observations, rewards, dones and infos as SB3 defines them."""
        observations, rewards, *ends, batch_infos = self._batch.step(self._actions)
        terminated, truncated = (flags.astype(bool) for flags in ends)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": cut} for cut in (truncated & ~terminated).tolist()]
        for lane in np.flatnonzero(done):
            infos[lane]["terminal_observation"] = batch_infos["final_obs"][lane]
            self.reset_infos[lane] = {}
        # A lane that ended has the measures of its last step, and the context of its next episode.
        context: Any = {name: batch_infos.pop(name) for name in ("context", "_context") if name in batch_infos}
        _split(batch_infos, infos)
        _split(batch_infos.get("final_info", {}), infos)
        _split(context, self.reset_infos)
        return observations, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the environments."""
        self._batch.close()

    def get_images(self) -> list[Any]:
        """Return a frame of each lane."""
        return [*(self._batch.render() or ())]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return for each lane the attribute of its batch, wrapped or not."""
        lanes = [env for env in self._batch.envs for _ in range(env.num_envs)]
        envs = [lanes[lane] for lane in self._get_indices(indices)]
        return [getattr(env if hasattr(env, attr_name) else env.unwrapped, attr_name) for env in envs]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ARG002
        """Raise an `AttributeError`, since the lanes share one environment."""
        raise AttributeError(f"the lanes share one environment: make it with {attr_name}={value!r} for all lanes")

    def env_method(self, method_name: str, *_: Any, **__: Any) -> list[Any]:
        """Raise an `AttributeError`, since the lanes share one environment."""
        raise AttributeError(f"the lanes share one environment: a single lane has no method {method_name!r}")

    def env_is_wrapped(self, _: type, indices: Any = None) -> list[bool]:
        """Return False for each lane, since no lane has wrappers."""
        return [False for _ in self._get_indices(indices)]


def _split(batch_infos: dict[str, Any], infos: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Add to the infos of lanes what a batch reports of them; return them."""
    for name, values in batch_infos.items():
        if f"_{name}" in batch_infos and not name.startswith("final_"):
            for lane in np.flatnonzero(batch_infos[f"_{name}"]):
                infos[lane][name] = values[lane].tolist() if values.ndim == 1 else values[lane]
    return infos
