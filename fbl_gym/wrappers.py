"""Wrappers for agents: observations in error coordinates, and residual actions on a policy.

Each exists for the single and for the vector environment. For acceleration actions, use the
environment's `action="acceleration"`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from fbl_gym.arm import Array
from fbl_gym.checks import check_number
from fbl_gym.interface import Interface, Layout

_CLIP = 10.0
_MOTION = ("position", "velocity", "acceleration")
_HANGING = np.array([-np.pi / 2, 0.0])


class ErrorScales:
    """The function from an observation to error coordinates.

    Each entry is divided by a fixed scale and clipped to [-10, 10]. The entries are, two of each:

    * tracking errors (reference less measured) of position, velocity and acceleration, for the
      sensors in `slots`;
    * measured position, less -pi/2 for joint 1, so that a hanging arm is at zero;
    * measured velocity;
    * acceleration of the reference;
    * for each previewed sample, its difference from the reference now (position, velocity,
      acceleration: six entries);
    * previous actions as a share of their bound, the last first.

    Args:
        interface: of the environment.
        slots: names of the slots that are used, where the observation has them. The reference
            always is.
        scales: of the errors of position [rad], velocity [rad/s] and acceleration [rad/s^2].
    """

    def __init__(
        self,
        interface: Interface,
        slots: Sequence[str] = ("position", "velocity", "preview", "previous_actions"),
        scales: Sequence[float] = (0.1, 1.0, 10.0),
    ) -> None:
        self.scales = dict(zip(_MOTION, scales, strict=True))
        used = {*slots, *(f"reference_{name}" for name in _MOTION)}
        self.layout = Layout(tuple(slot for slot in interface.layout.slots if slot.name in used))
        self.action_limit = interface.action_limit[0], interface.action_limit[1]
        self.size = len(self(np.zeros((1, interface.layout.size)))[0])

    def __call__(self, observations: Array) -> Array:
        """Return observations [... x layout.size] in error coordinates, [... x size]."""
        layout = self.layout
        parts = [
            (observations[..., layout[f"reference_{name}"]] - observations[..., layout[name]]) / scale
            for name, scale in self.scales.items()
            if name in layout
        ]
        parts.append(observations[..., layout["position"]] - _HANGING)
        if "velocity" in layout:
            parts.append(observations[..., layout["velocity"]])
        parts.append(observations[..., layout["reference_acceleration"]] / self.scales["acceleration"])
        if "preview" in layout:
            parts.append(self._preview(observations))
        if "previous_actions" in layout:
            actions = observations[..., layout["previous_actions"]]
            parts.append(actions / np.resize(self.action_limit, actions.shape[-1]))
        return np.clip(np.concatenate(parts, axis=-1), -_CLIP, _CLIP)

    def _preview(self, observations: Array) -> Array:
        preview = observations[..., self.layout["preview"]]
        now = [observations[..., self.layout[f"reference_{name}"]] for name in self.scales]
        samples = preview.reshape(*preview.shape[:-1], -1, 6)
        scale = np.repeat([*self.scales.values()], 2)
        return ((samples - np.concatenate(now, axis=-1)[..., None, :]) / scale).reshape(preview.shape)

    def single_precision(self, observations: Array, infos: dict[str, Any] | None = None) -> Any:
        """Return error coordinates as float32; convert `final_obs` of the infos of a batch, too."""
        if infos and "final_obs" in infos:
            final = infos["final_obs"]
            for lane in np.flatnonzero(infos["_final_obs"]):
                final[lane] = self(final[lane]).astype(np.float32)
        return self(observations).astype(np.float32)

    @property
    def space(self) -> spaces.Box:
        """Return the box of error coordinates, [size] of float32."""
        bound = np.full(self.size, _CLIP, dtype=np.float32)
        if "previous_actions" in self.layout:
            actions = self.layout["previous_actions"]
            bound[actions.start - actions.stop :] = 1.0
        return spaces.Box(-bound, bound)


class ErrorCoordinates(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """A wrapper with the observations of `fbl_gym/TwoLinkArmTracking-v0`; see `ErrorScales`.

    It goes over other wrappers, such as `Residual`.

    Args:
        env: a `TwoLinkArmEnv`, wrapped or not, with unchanged observations.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._errors = ErrorScales(env.unwrapped.interface)  # type: ignore[attr-defined]
        self.observation_space = self._errors.space

    def observation(self, observation: Array) -> Any:
        """Return an observation [layout.size] in error coordinates."""
        return self._errors.single_precision(observation)


class VectorErrorCoordinates(VectorWrapper):
    """`ErrorCoordinates` over a `TwoLinkArmVectorEnv`, in every autoreset mode, with `final_obs`.

    Args:
        env: a `TwoLinkArmVectorEnv`, wrapped or not, with unchanged observations.
    """

    def __init__(self, env: VectorEnv) -> None:
        super().__init__(env)
        self._errors = ErrorScales(env.unwrapped.interface)  # type: ignore[attr-defined]
        self.single_observation_space = self._errors.space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Reset the environment and return observations in error coordinates."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return self._errors.single_precision(observations), infos

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Make a step and return observations in error coordinates."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        return self._errors.single_precision(observations, infos), rewards, terminated, truncated, infos


class BasePolicy(Protocol):
    """A policy under a residual: anything with stable-baselines3's `predict`."""

    def predict(
        self, observation: Array, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Array, Any]:
        """Return the action for an observation, and the next state; see `controllers.policy`."""
        ...


class _Base:
    """The policy under a residual, its state, and its next observation and episode starts."""

    def __init__(self, policy: BasePolicy, scale: float, low: Array, high: Array) -> None:
        self.policy, self.scale = policy, check_number("scale", scale, above=0)
        self.low, self.high = low.astype(float), high.astype(float)
        self.state: Any = None

    def begin(self, observation: Array, starts: Any) -> None:
        self.observation, self.starts = observation, starts

    def act(self, residual: Array) -> Array:
        """Return the base policy's action plus the scaled residual, within the action box."""
        action, self.state = self.policy.predict(
            self.observation, state=self.state, episode_start=self.starts, deterministic=True
        )
        half = 0.5 * (self.high - self.low)
        residual = np.clip(np.asarray(residual, dtype=float), -1.0, 1.0)
        return np.clip(action + self.scale * half * residual, self.low, self.high)


class Residual(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """A wrapper that adds the agent's action, in [-1, 1], to a policy's.

    The policy sees the environment's observation. For an agent in error coordinates, wrap this in
    `ErrorCoordinates`.

    Args:
        env: a `TwoLinkArmEnv`, wrapped or not, with unchanged observations.
        policy: anything with `predict`, such as `controllers.make("pid-flm", env)`.
        scale: largest residual, as a fraction of the environment's action bound.
    """

    def __init__(self, env: gym.Env[Any, Any], policy: BasePolicy, scale: float = 0.2) -> None:
        RecordConstructorArgs.__init__(self, policy=policy, scale=scale)
        super().__init__(env)
        box = env.action_space
        assert isinstance(box, spaces.Box)
        self._base = _Base(policy, scale, box.low, box.high)
        self.action_space = spaces.Box(-1.0, 1.0, box.shape, dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Reset the environment and the policy."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._base.state = None
        self._base.begin(observation, None)
        return observation, info

    def step(self, action: Array) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Make a step under the sum of the policy's action and a residual, [2] within [-1, 1]."""
        _check_residual(action, (2,))
        result = self.env.step(self._base.act(action))
        self._base.begin(result[0], None)
        return result


class VectorResidual(VectorWrapper):
    """`Residual` over a `TwoLinkArmVectorEnv`, in every autoreset mode.

    Args:
        env: a `TwoLinkArmVectorEnv`, wrapped or not, with unchanged observations.
        policy, scale: as in `Residual`.
    """

    def __init__(self, env: VectorEnv, policy: BasePolicy, scale: float = 0.2) -> None:
        super().__init__(env)
        box = env.single_action_space
        assert isinstance(box, spaces.Box)
        self._base = _Base(policy, scale, box.low, box.high)
        self.single_action_space = spaces.Box(-1.0, 1.0, box.shape, dtype=np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._done = np.zeros(self.num_envs, dtype=bool)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Reset the environment, and the policy in the lanes that begin an episode."""
        mask = (options or {}).get("reset_mask")
        observations, infos = self.env.reset(seed=seed, options=options)
        starts = np.ones(self.num_envs, dtype=bool) if mask is None else mask.copy()
        self._done = np.where(starts, False, self._done)
        self._base.begin(observations, starts)
        return observations, infos

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Make a step with residuals, [num_envs x 2] within [-1, 1]; see `Residual.step`."""
        _check_residual(actions, (self.num_envs, 2))
        result = self.env.step(self._base.act(actions))
        observations, done = result[0], result[2] | result[3]
        # A lane restarts one step after its end in NEXT_STEP mode, at once in SAME_STEP mode.
        mode = self.env.metadata["autoreset_mode"]
        self._base.begin(observations, done if mode == AutoresetMode.SAME_STEP else self._done)
        self._done = done if mode == AutoresetMode.NEXT_STEP else np.zeros_like(done)
        return result


def _check_residual(action: Any, shape: tuple[int, ...]) -> None:
    """Refuse a wrong residual before the base policy's state advances."""
    array = np.asarray(action)
    if array.shape != shape or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise ValueError(f"action must be finite numbers of shape {shape}, got {action!r}")
