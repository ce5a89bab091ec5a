"""The environments `fbl_gym/TwoLinkArmTracking-v0`, on which agents learn with default settings."""

from __future__ import annotations

from typing import Any

from gymnasium.vector.utils import batch_space

from fbl_gym.arm import Array
from fbl_gym.env import TwoLinkArmEnv
from fbl_gym.vector_env import TwoLinkArmVectorEnv
from fbl_gym.wrappers import ErrorScales


class TwoLinkArmTrackingEnv(TwoLinkArmEnv):
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
        self._errors = ErrorScales(self.interface)
        self.observation_space = self._errors.space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode, as `TwoLinkArmEnv.reset`."""
        observation, info = super().reset(seed=seed, options=options)
        return self._errors.single_precision(observation), info

    def step(self, action: Array) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold an action for `control_dt`, as `TwoLinkArmEnv.step`."""
        observation, reward, terminated, truncated, info = super().step(action)
        return self._errors.single_precision(observation), reward, terminated, truncated, info


class TwoLinkArmTrackingVectorEnv(TwoLinkArmVectorEnv):
    """Arms of `TwoLinkArmTrackingEnv`, stepped together, as in `TwoLinkArmVectorEnv`."""

    def __init__(self, num_envs: int = 1, scenario: Any = None, *, past_actions: int = 1, **options: Any) -> None:
        super().__init__(num_envs, scenario, past_actions=past_actions, **options)
        self._errors = ErrorScales(self.interface)
        self.single_observation_space = self._errors.space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode in every lane, or in some, as `TwoLinkArmVectorEnv.reset`."""
        observations, infos = super().reset(seed=seed, options=options)
        return self._errors.single_precision(observations), infos

    def step(self, actions: Array) -> tuple[Any, Array, Any, Any, dict[str, Any]]:
        """Hold each lane's action for `control_dt`, as `TwoLinkArmVectorEnv.step`."""
        observations, rewards, terminated, truncated, infos = super().step(actions)
        return self._errors.single_precision(observations, infos), rewards, terminated, truncated, infos
