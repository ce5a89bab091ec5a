"""The reward: bounded, and with a slope at zero error.

    r = 1 - (w_t T + w_e E + w_c C) / (w_t + w_e + w_c)       in [0, 1]

T is the tracking term in [0, 1] of the true error |e| = |e_1| + |e_2| [rad]:
    "log"  T = min(1, log(1 + |e| / resolution) / log(1 + worst / resolution))
    "l1"   T = min(1, |e| / worst)
E is the mean of |u_i|, the commanded torque as a fraction of its limit, and C the mean of |u_i - u_i before| / 2. Both are zero
for an arm without torque limits. A diverged arm gets 0, and nothing after it: since no reward is negative, ending an
episode early never pays. A squared error has no slope near zero, where the best policies differ, so it isn't offered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fbl_gym.checks import check_choice, check_number
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class Reward:
    """The weights and scales of the reward.

    Args:
        tracking: "log" or "l1".
        worst: |e| [rad] from which on the tracking term is 1.
        resolution: |e| [rad] at which the logarithm bends; unused by "l1".
        weight_tracking, weight_effort, weight_chatter: w_t, w_e and w_c, zero or more, not all zero.
    """

    tracking: Literal["log", "l1"] = "log"
    worst: float = 2.0
    resolution: float = 1e-3
    weight_tracking: float = 1.0
    weight_effort: float = 0.02
    weight_chatter: float = 0.1

    def __post_init__(self) -> None:
        weights = {name: check_number(name, getattr(self, name), low=0) for name in _WEIGHTS}
        if sum(weights.values()) == 0:
            raise ValueError(f"at least one of {', '.join(_WEIGHTS)} must be positive, got {weights}")
        set_fields(
            self,
            tracking=check_choice("tracking", self.tracking, ("log", "l1")),
            worst=check_number("worst", self.worst, above=0),
            resolution=check_number("resolution", self.resolution, above=0),
            **weights,
        )


_WEIGHTS = ("weight_tracking", "weight_effort", "weight_chatter")
