"""The environments `fbl_gym/TwoLinkArmTracking-v0`, on which agents learn with default settings."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from fbl_gym.envs.env import TwoLinkArmEnv
from fbl_gym.envs.error_scales import ErrorScales
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import check_flag, check_pair, check_whole


class _InErrorCoordinates:
    """Base of environments, single or batched, that observe `ErrorScales`."""

    device: str
    interface: Interface
    observation_space: Any
    single_observation_space: Any
    _batch: Any
    _frames: Any

    def __init__(
        self, *arguments: Any, past_actions: int = 1, history: int = 0, fine: Any = None, drive: bool = False, **options: Any
    ) -> None:  # fmt: skip
        super().__init__(*arguments, past_actions=past_actions, **options)  # type: ignore[call-arg]
        fine = None if fine is None else check_pair("fine", fine, above=0)
        self._errors = ErrorScales(self.interface, fine=fine, drive=check_flag("drive", drive))
        self._history = check_whole("history", history, high=10_000)
        if history and self.device != "cpu":
            raise ValueError(f"history must be 0 with device='cuda', got {history}: stack the tensors in your program")
        bound = np.tile(self._errors.space.high, history + 1)
        self.observation_space = spaces.Box(-bound, bound)
        if isinstance(self, VectorEnv):
            self.single_observation_space = self.observation_space
            self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._frames = np.zeros(self.observation_space.shape, np.float32)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start episodes; return observations [size], of a batch [num_envs x size], and infos."""
        observations, infos = super().reset(seed=seed, options=options)  # type: ignore[misc]
        return self._stacked(self._scaled(observations), slice(-self._errors.size)), infos

    def step(self, action: Array) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Hold an action [2], of a batch [num_envs x 2], for `control_dt`; see `reset`."""
        observations, rewards, terminated, truncated, infos = super().step(action)  # type: ignore[misc]
        final, earlier = infos.get("final_obs"), slice(self._errors.size, None)
        if final is not None and self.device == "cuda":
            infos["final_obs"] = self._scaled(final)
        elif final is not None:
            for lane in np.flatnonzero(infos["_final_obs"]):
                last = self._scaled(final[lane])
                final[lane] = np.append(self._frames[lane, earlier], last) if self._history else last
        return self._stacked(self._scaled(observations), earlier), rewards, terminated, truncated, infos

    def state(self) -> Any:
        """Return a copy of the state, see `TwoLinkArmEnv.state`, with the earlier observations."""
        state = super().state()  # type: ignore[misc]
        return (state, self._frames.copy()) if self._history else state

    def set_state(self, state: Any) -> None:
        """Go on from a state, see `TwoLinkArmEnv.set_state`."""
        frames: Any = None
        if self._history:
            state, frames = state if isinstance(state, tuple) and len(state) == 2 else (None, None)
            state = state if np.shape(frames) == self._frames.shape else None
        super().set_state(state)  # type: ignore[misc]
        self._frames = frames

    def _stacked(self, observations: Any, earlier: slice) -> Any:
        """Return observations behind the earlier ones, or behind zeros where an episode begins."""
        if not self._history:
            return observations
        begins = self._batch.field("step")[:, None] == 0
        frames = np.where(begins, np.float32(0.0), self._frames[..., earlier]).reshape(*observations.shape[:-1], -1)
        self._frames = np.concatenate([frames, observations], axis=-1)
        return self._frames.copy()

    def _scaled(self, observations: Any) -> Any:
        """Return observations in error coordinates."""
        if self.device == "cuda":
            return self._batch.scaled(observations, self._errors.columns)
        return self._errors(observations, np.float32)


class TwoLinkArmTrackingEnv(_InErrorCoordinates, TwoLinkArmEnv):
    """An uncertain two-link arm that follows a reference, with observations for learning agents.

    ## Description

    Arm, actions, reward, episodes and options are those of `TwoLinkArmEnv`. Only the observation
    differs: it has errors instead of references, scaled to numbers of order one, and the last
    action, because the reward has a price on the change of the torque. Readings of the acceleration
    are left out. The observation has the same shape with and without that sensor.

    ## Observation space

    `Box((12,), float32)`

    | index | name | unit | range |
    |---|---|---|---|
    | 0, 1 | error of the position, reference less measured | 0.1 rad | -10 to 10 |
    | 2, 3 | error of the velocity | rad/s | -10 to 10 |
    | 4, 5 | position, less -pi/2 for joint 1 | rad | -10 to 10 |
    | 6, 7 | velocity | rad/s | -10 to 10 |
    | 8, 9 | acceleration of the reference | 10 rad/s^2 | -10 to 10 |
    | 10, 11 | previous action | of its bound | -1 to 1 |

    A delay or lag of the drive adds the earlier actions that still act.
    With `preview=n`, 6 n entries precede the previous actions: the coming samples of the reference,
    less the reference now. With `drive=True`, seven more follow these: the shortest and longest
    delay and the smallest and largest lag of the drive's data sheet [0.05 s], and 1 for the
    robot's class of servo, direct and geared, else 0. Values outside the range are clipped.

    With `history=n`, n earlier observations precede all this, the oldest first, and zeros before
    the episode: the observation of SB3's `VecFrameStack` with n + 1 frames.

    `interface` and `layout` describe the observation of `TwoLinkArmEnv`. The laws of `controllers`
    read that one.

    Args:
        scenario: as in `TwoLinkArmEnv`.
        past_actions: least number of previous actions in the observation.
        history: number of earlier observations in the observation; 0 with `device="cuda"`.
        fine: scales s of the errors of position [rad] and velocity [rad/s], such as (0.002, 0.05).
            Entries 0 to 3 are then asinh(error / s), linear below s and logarithmic above, with
            errors within 1 rad and 10 rad/s. None: linear.
        drive: True if the observation has the drive's data sheet.
        **options: as in `TwoLinkArmEnv`.
    """


class TwoLinkArmTrackingVectorEnv(_InErrorCoordinates, TwoLinkArmVectorEnv, VectorEnv[Array, Array, Array]):
    """Arms of `TwoLinkArmTrackingEnv`, stepped together, as in `TwoLinkArmVectorEnv`.

    `VectorEnv` is named since skrl looks for it among the direct bases.
    """
