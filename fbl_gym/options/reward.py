"""The reward: bounded, with a slope at zero error.

    r = 1 - (w_t T + w_e E + w_c C) / (w_t + w_e + w_c)       in [0, 1]

T is the tracking term in [0, 1] of the true error |e| = |e_1| + |e_2| [rad]:
    "log"  T = min(1, log(1 + |e| / resolution) / log(1 + worst / resolution))
    "l1"   T = min(1, |e| / worst)
E is the mean of |u_i|, where u is the torque command as a fraction of its limit. C is the mean of
|u_i - u_i before| / 2. Both are zero for an arm without torque limits.

A diverged arm gets 0 and the episode ends. No reward is negative, so ending an episode early never
pays. There is no squared error, because its slope vanishes near zero, where good policies differ.
"""

from typing import Any, ClassVar, Literal

import numpy as np

from fbl_gym.exact import log1p
from fbl_gym.model.arm import Array
from fbl_gym.records.record import Option, choice, number


class Reward(Option):
    """The weights and scales of the reward.

    Args:
        tracking: form of the tracking term.
        worst: error `|e|` from which on the tracking term is 1.
        resolution: error `|e|` at which the logarithm bends; unused by "l1".
        weight_tracking: weight w_t of the tracking term.
        weight_effort: weight w_e of the effort.
        weight_chatter: weight w_c of the chatter.
    """

    tracking: Literal["log", "l1"] = choice("log", ("log", "l1"))
    worst: float = number(2.0, unit="rad", low=1e-6)
    resolution: float = number(1e-3, unit="rad", low=1e-9, high=1e3)
    weight_tracking: float = number(1.0, low=0)
    weight_effort: float = number(0.02, low=0)
    weight_chatter: float = number(0.1, low=0)

    derived: ClassVar = {
        "reward_logarithmic": bool, "reward_scale": float, "reward_norm": float, "reward_weights": (float, 3)
    }  # fmt: skip

    def validate(self) -> None:
        """Refuse weights that are all zero."""
        weights = {name: value for name, value in vars(self).items() if name.startswith("weight_")}
        if sum(weights.values()) == 0:
            raise ValueError(f"at least one of {', '.join(weights)} must be positive, got {weights}")

    def pack(self, packer: Any) -> None:
        """Write form, scales and weights."""
        settings, logarithmic = packer.settings, self.tracking == "log"
        settings["reward_logarithmic"] = logarithmic
        settings["reward_scale"] = 1 / self.resolution if logarithmic else 1 / self.worst
        settings["reward_norm"] = 1 / log1p(self.worst / self.resolution) if logarithmic else 0.0
        settings["reward_weights"] = self.shares

    @property
    def shares(self) -> tuple[float, float, float]:
        """Return each weight over the sum of all: of tracking, effort and chatter."""
        total = self.weight_tracking + self.weight_effort + self.weight_chatter
        return self.weight_tracking / total, self.weight_effort / total, self.weight_chatter / total

    def losses(self, error: Array, effort: Array, chatter: Array) -> dict[str, Array]:
        """Return the equation's three terms, weighted; the reward is 1 less their sum.

        Args:
            error: tracking error [n x 2] rad.
            effort: torque command as a fraction of its limit, [n x 2], not negative.
            chatter: C of the equation, [n].
        """
        distance = np.abs(error).sum(axis=-1)
        tracking = distance / self.worst
        if self.tracking == "log":
            tracking = np.log1p(distance / self.resolution) / np.log1p(self.worst / self.resolution)
        terms = np.minimum(tracking, 1.0), effort.mean(axis=-1), chatter
        names = ("tracking_loss", "effort_loss", "chatter_loss")
        return {name: share * term for name, share, term in zip(names, self.shares, terms, strict=True)}
