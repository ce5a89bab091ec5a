"""Limits beyond which an arm has diverged, and constraints that it shall keep."""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fbl_gym.model.arm import Array
from fbl_gym.records.record import Option, Pair, choice, number, pair


class Limits(Option):
    """The limits beyond which an arm has diverged, and the ranges of the interface's numbers.

    Args:
        position: largest distance of a joint from its start; readings saturate at twice that.
        velocity: largest joint velocity; readings saturate at twice that.
        acceleration: range of the acceleration sensor and of the reference's acceleration.
        command: range of an acceleration action.
        error: an arm is lost once a joint has been farther than this from its reference for
            `error_time`; None: however far.
        error_time: see `error`.
    """

    position: float = number(4 * np.pi, unit="rad", above=0, kernel="max_position")
    velocity: float = number(100.0, unit="rad/s", above=0, kernel="max_velocity")
    acceleration: float = number(1e5, unit="rad/s^2", above=0)
    command: float = number(100.0, unit="rad/s^2", above=0, high=1e30)
    error: float | None = number(None, unit="rad", above=0, kernel="max_error", none=np.inf)
    error_time: float = number(1.0, unit="s", above=0)

    derived: ClassVar = {"sensor_range": (float, 3), "error_steps": float}

    def pack(self, packer: Any) -> None:
        """Write the ranges of the sensors, and `error_time` in control steps."""
        settings = packer.settings
        settings["sensor_range"] = 2 * self.position, 2 * self.velocity, self.acceleration
        settings["error_steps"] = np.ceil(self.error_time / packer.scenario.control_dt - 1e-9)


class Constraints(Option):
    """Bounds that the arm shall keep. A step whose end is beyond one of them costs 1.

    The bounds are those of the real links, also with elastic joints. A policy knows them.

    Args:
        low: smallest position of each joint; None: no bound.
        high: largest position of each joint; None: no bound.
        velocity: largest velocity of each joint, of either sign; None: no bound.
        violation: consequence beyond a bound: "cost" alone, or "end", which also ends the episode.
    """

    low: Pair | float | None = pair(None, unit="rad", kernel="constraint_low", none=-np.inf)
    high: Pair | float | None = pair(None, unit="rad", kernel="constraint_high", none=np.inf)
    velocity: Pair | float | None = pair(None, unit="rad/s", above=0, kernel="constraint_velocity", none=np.inf)
    violation: str = choice("cost", ("cost", "end"), kernel="violation_ends")

    def validate(self) -> None:
        """Refuse an empty range of positions."""
        low, high, _ = self.bounds
        if (low >= high).any():
            raise ValueError(f"low must be below high, got low={self.low} and high={self.high}")

    @property
    def bounds(self) -> tuple[Array, ...]:
        """Return lowest and highest position and largest velocity [2]; infinite: no bound."""
        bounds = (self.low, -np.inf), (self.high, np.inf), (self.velocity, np.inf)
        return tuple(np.full(2, none if given is None else given) for given, none in bounds)

    def violated(self, position: Array, velocity: Array) -> NDArray[np.bool_]:
        """Return True where a bound is violated [...], from position and velocity [... x 2]."""
        low, high, fastest = self.bounds
        kept = (low <= position) & (position <= high) & (np.abs(velocity) <= fastest)
        return np.asarray(~kept.all(axis=-1))
