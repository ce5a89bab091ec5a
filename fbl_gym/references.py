"""The motion that a policy is asked to follow: one frozen record per kind.

An arm starts an episode on its reference: at its position and velocity at t = 0 (steps start from their first level).
Where levels, way-points or phases are drawn, they come from the episode's own stream, so that every policy meets the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from fbl_gym.checks import Pair, check_choice, check_number, check_pair, check_table, check_whole
from fbl_gym.records import build_kind, set_fields

# Joint angles that the default references stay within: one radian about hanging, so that the moves of `MinimumJerk` ask
# at most 1,683 and 749 N m of any arm whose masses and lengths lie between half and double Table 1's, with or without
# 15 kg more at the tip: within the default torque limits of 2,000 and 800 N m (`tests/fbl_gym/test_references.py`).
LOW: Pair = (-math.pi / 2 - 1.0, -1.0)
HIGH: Pair = (-math.pi / 2 + 1.0, 1.0)


def _check_kind(record: object) -> None:
    set_fields(record, kind=check_choice("kind", record.kind, (type(record).kind,)))  # type: ignore[attr-defined]


def _check_levels(record: MinimumJerk | Steps | FilteredSteps) -> None:
    low, high = check_pair("low", record.low), check_pair("high", record.high)
    for joint in (0, 1):
        if low[joint] > high[joint]:
            raise ValueError(f"low must not exceed high, got low={low} and high={high}")
    set_fields(
        record, low=low, high=high, points=None if record.points is None else check_table("points", record.points)
    )
    _check_kind(record)


@dataclass(frozen=True)
class MinimumJerk:
    """Straight moves in joint space between way-points, with minimum jerk (Flash and Hogan 1985), and a rest at each.

    Args:
        low, high: box [rad] from which way-points are drawn, per episode.
        points: the way-points themselves instead, [n x 2] rad; the arm starts on the first and stays on the last.
        move_time: duration of a move [s].
        hold_time: rest after each move [s].
        kind: "minimum-jerk"; tells this record from the others in plain data.
    """

    low: Pair | float = LOW
    high: Pair | float = HIGH
    points: tuple[Pair, ...] | None = None
    move_time: float = 1.5
    hold_time: float = 0.5
    kind: str = "minimum-jerk"

    def __post_init__(self) -> None:
        _check_levels(self)
        set_fields(
            self,
            move_time=check_number("move_time", self.move_time, above=0),
            hold_time=check_number("hold_time", self.hold_time, low=0),
        )


@dataclass(frozen=True)
class Steps:
    """Levels that jump every `period`, from t = 0 on. Velocity and acceleration of a literal step are given as zero.

    Args:
        low, high: box [rad] from which levels are drawn, per episode.
        points: the levels themselves instead, [n x 2] rad; the arm starts on the first, and the first jump is at t = 0.
        period: [s].
        kind: "steps"; tells this record from the others in plain data.
    """

    low: Pair | float = LOW
    high: Pair | float = HIGH
    points: tuple[Pair, ...] | None = None
    period: float = 2.0
    kind: str = "steps"

    def __post_init__(self) -> None:
        _check_levels(self)
        set_fields(self, period=check_number("period", self.period, above=0))


@dataclass(frozen=True)
class FilteredSteps:
    """Steps behind a critically damped second-order filter: r'' = w^2 (s - r) - 2 w r'.

    Args:
        low, high, points, period: as in `Steps`.
        bandwidth: w [rad/s].
        kind: "filtered-steps"; tells this record from the others in plain data.
    """

    low: Pair | float = LOW
    high: Pair | float = HIGH
    points: tuple[Pair, ...] | None = None
    period: float = 2.0
    bandwidth: float = 5.0
    kind: str = "filtered-steps"

    def __post_init__(self) -> None:
        _check_levels(self)
        set_fields(
            self,
            period=check_number("period", self.period, above=0),
            bandwidth=check_number("bandwidth", self.bandwidth, above=0),
        )


@dataclass(frozen=True)
class SineReference:
    """centre + amplitude sin(2 pi frequency t + phase).

    Args:
        centre, amplitude: [rad], per joint.
        frequency: [Hz], the same for both joints.
        phase: [rad], per joint; None: drawn per episode.
        kind: "sine"; tells this record from the others in plain data.
    """

    centre: Pair | float = (-math.pi / 2, 0.0)
    amplitude: Pair | float = 0.5
    frequency: float = 0.25
    phase: Pair | float | None = 0.0
    kind: str = "sine"

    def __post_init__(self) -> None:
        set_fields(
            self,
            centre=check_pair("centre", self.centre),
            amplitude=check_pair("amplitude", self.amplitude, low=0),
            frequency=check_number("frequency", self.frequency, above=0),
            phase=None if self.phase is None else check_pair("phase", self.phase),
        )
        _check_kind(self)


@dataclass(frozen=True)
class FourierReference:
    """An exciting motion: harmonics 1 to n of a base frequency with amplitudes in proportion to 1/h and drawn phases.

    Args:
        centre: [rad], per joint.
        amplitude: bound of |q - centre| [rad], per joint: the sum of the harmonics' amplitudes.
        frequency: of the first harmonic [Hz].
        harmonics: how many.
        kind: "fourier"; tells this record from the others in plain data.
    """

    centre: Pair | float = (-math.pi / 2, 0.0)
    amplitude: Pair | float = 1.0
    frequency: float = 0.1
    harmonics: int = 5
    kind: str = "fourier"

    def __post_init__(self) -> None:
        set_fields(
            self,
            centre=check_pair("centre", self.centre),
            amplitude=check_pair("amplitude", self.amplitude, low=0),
            frequency=check_number("frequency", self.frequency, above=0),
            harmonics=check_whole("harmonics", self.harmonics, low=1),
        )
        _check_kind(self)


@dataclass(frozen=True)
class ArrayReference:
    """The user's own motion, sampled every `dt`; its last position holds on.

    Args:
        position: [n x 2] rad.
        dt: sample time [s].
        velocity, acceleration: [n x 2]; None: from a cubic spline through the positions.
        kind: "array"; tells this record from the others in plain data.
    """

    position: tuple[Pair, ...]
    dt: float = 0.01
    velocity: tuple[Pair, ...] | None = None
    acceleration: tuple[Pair, ...] | None = None
    kind: str = "array"

    def __post_init__(self) -> None:
        set_fields(self, position=check_table("position", self.position), dt=check_number("dt", self.dt, above=0))
        for name in ("velocity", "acceleration"):
            value = getattr(self, name)
            if value is not None:
                value = check_table(name, value)
                if len(value) != len(self.position):
                    raise ValueError(f"{name} must have the {len(self.position)} rows of position, got {len(value)}")
                set_fields(self, **{name: value})
        _check_kind(self)

    def samples(self, times: np.ndarray) -> np.ndarray:
        """Position, velocity and acceleration, [n x 6], at rest beyond the last sample.  times: [n] s."""
        position = np.array(self.position)
        last = (len(position) - 1) * self.dt
        at = np.minimum(times, last)
        knots = self.dt * np.arange(len(position))
        if len(position) == 1:
            return np.hstack([np.repeat(position, len(times), axis=0), np.zeros((len(times), 4))])
        spline = CubicSpline(knots, position)
        columns = [spline(at)]
        for order, given in ((1, self.velocity), (2, self.acceleration)):
            values = spline(at, order) if given is None else CubicSpline(knots, np.array(given))(at)
            columns.append(np.where((times <= last + 1e-12)[:, None], values, 0.0))
        return np.hstack(columns)


Reference: TypeAlias = MinimumJerk | Steps | FilteredSteps | SineReference | FourierReference | ArrayReference


def as_reference(name: str, value: object) -> Reference:
    """A reference from its record, from a dict with its `kind`, or from the kind alone."""
    return build_kind(name, value, (MinimumJerk, Steps, FilteredSteps, SineReference, FourierReference, ArrayReference))
