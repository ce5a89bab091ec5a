"""The environments `fbl_gym/TwoLinkArmTracking-v0`, on which agents learn with default settings."""

from __future__ import annotations

from typing import Any

from gymnasium import spaces
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from fbl_gym.envs.env import TwoLinkArmEnv
from fbl_gym.envs.error_scales import ErrorScales
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array


class _InErrorCoordinates:
    """Base of environments, single or batched, that observe `ErrorScales`."""

    device: str
    _batch: Any

    def _scale(self, interface: Interface) -> spaces.Box:
        """Prepare the observations, and return the box of one."""
        self._errors = ErrorScales(interface)
        return self._errors.space

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start episodes; return observations [size], of a batch [num_envs x size], and infos."""
        observations, infos = super().reset(seed=seed, options=options)  # type: ignore[misc]
        return self._scaled(observations, {}), infos

    def step(self, action: Array) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Hold an action [2], of a batch [num_envs x 2], for `control_dt`; see `reset`."""
        observations, rewards, terminated, truncated, infos = super().step(action)  # type: ignore[misc]
        return self._scaled(observations, infos), rewards, terminated, truncated, infos

    def _scaled(self, observations: Any, infos: dict[str, Any]) -> Any:
        """Return observations in error coordinates, and change `final_obs` to them."""
        if self.device == "cpu":
            return self._errors.single_precision(observations, infos)
        if "final_obs" in infos:
            infos["final_obs"] = self._batch.scaled(infos["final_obs"], self._errors.columns)
        return self._batch.scaled(observations, self._errors.columns)


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
    less the reference now. Values outside the range are clipped.

    `interface` and `layout` describe the observation of `TwoLinkArmEnv`. The laws of `controllers`
    read that one.

    Args:
        scenario: as in `TwoLinkArmEnv`.
        past_actions: least number of previous actions in the observation.
        **options: as in `TwoLinkArmEnv`.
    """

    def __init__(self, scenario: Any = None, *, past_actions: int = 1, **options: Any) -> None:
        super().__init__(scenario, past_actions=past_actions, **options)
        self.observation_space = self._scale(self.interface)


class TwoLinkArmTrackingVectorEnv(_InErrorCoordinates, TwoLinkArmVectorEnv, VectorEnv[Array, Array, Array]):
    """Arms of `TwoLinkArmTrackingEnv`, stepped together, as in `TwoLinkArmVectorEnv`.

    `VectorEnv` is named since skrl looks for it among the direct bases.
    """

    def __init__(self, num_envs: int = 1, scenario: Any = None, *, past_actions: int = 1, **options: Any) -> None:
        super().__init__(num_envs, scenario, past_actions=past_actions, **options)
        self.single_observation_space = self._scale(self.interface)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
