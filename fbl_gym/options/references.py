"""Reference motions: one record per kind.

An arm starts an episode at the position and velocity of its reference at t = 0; with steps, at
their first level. Levels, way-points and phases that are drawn come from a random stream of the
episode, so that every policy follows the same motion.
"""

import math
from typing import Any, ClassVar, TypeAlias

import numpy as np

from fbl_gym.records.record import Number, Numbers, Option, Pair, ends, number, pair, table, whole

# Joint angles that the default references stay within, one radian about hanging. The moves of
# `MinimumJerk` then need at most 1,683 and 749 N m of any arm whose masses and lengths lie between
# half and double Table 1's, with or without 15 kg more at the tip. This is within the default
# torque limits of 2,000 and 800 N m (`tests/fbl_gym/test_references.py`).
LOW: Pair = (-math.pi / 2 - 1.0, -1.0)
HIGH: Pair = (-math.pi / 2 + 1.0, 1.0)


class _Reference(Option):
    """Base of the references."""

    derived: ClassVar = {
        "reference_kind": int, "reference_points": int, "reference_table": int, "waypoints": int,
        "point_time": float, "reference_phases_drawn": bool,
    }  # fmt: skip

    #: Positions [n x 2] rad, among them the lowest and the highest one of each joint.
    extremes: ClassVar[Any]

    def check(self, scenario: Any) -> None:
        """Refuse a reference beyond the sensors' range, or points far from the first one."""
        far, points = scenario.limits.position, vars(self).get("points", vars(self).get("position"))
        low, high = (tuple(end(self.extremes, axis=0).tolist()) for end in (np.min, np.max))
        if np.abs([low, high]).max() > 2 * far:
            right = f"the sensors' range, 2 limits.position = {2 * far:g} rad"
        elif points and np.abs(np.subtract([low, high], points[0])).max() > far:
            right = f"limits.position={far:g} rad of its start {points[0]}"
        else:
            return
        raise ValueError(f"reference must stay within {right}, got positions from {low} to {high} rad")

    def pack(self, packer: Any) -> None:
        """Write the kind."""
        packer.settings["reference_kind"] = REFERENCES.index(type(self))


class _Points(_Reference):
    """Base of the references through points that are drawn or given.

    Args:
        low: lower corner of the box from which each episode draws its points.
        high: upper corner of the box.
        points: fixed points in place of drawn ones; the arm starts on the first, and the last holds
            on.
    """

    low: Pair | float = pair(LOW, unit="rad", kernel="reference_low")
    high: Pair | float = pair(HIGH, unit="rad", kernel="reference_high")
    points: tuple[Pair, ...] | None = table(None, unit="rad")

    #: Pairs of rows that a block holds for each point.
    pairs: ClassVar[int] = 1
    #: Fields whose sum is the time from one point to the next.
    times: ClassVar[tuple[str, ...]] = ("period",)

    @property
    def extremes(self) -> Any:
        """Return the corners of the box, or the points."""
        return (self.low, self.high) if self.points is None else self.points

    def validate(self) -> None:
        """Refuse an empty box."""
        if any(low > high for low, high in zip(self.low, self.high, strict=True)):  # type: ignore[arg-type]
            raise ValueError(f"low must not exceed high, got low={self.low} and high={self.high}")

    @property
    def interval(self) -> float:
        """Return the time from one point to the next [s]."""
        return float(sum(getattr(self, name) for name in self.times))

    def check(self, scenario: Any) -> None:
        """Refuse an interval shorter than a control step, too."""
        super().check(scenario)
        if self.interval < scenario.control_dt:
            raise ValueError(
                f"reference.{' + '.join(self.times)} must be at least control_dt={scenario.control_dt:g} s, "
                f"got {self.interval:g} s"
            )

    def pack(self, packer: Any) -> None:
        """Write number and interval of the points, and the points unless they are drawn (-1)."""
        super().pack(packer)
        settings, n = packer.settings, len(self.points or ())
        if self.points is None:  # one more than is reached, for a jump at the very end
            n = int(packer.scenario.duration / self.interval + 1e-9) + 2
        settings["reference_table"] = -1 if self.points is None else packer.table(np.ravel(self.points))
        settings["point_time"] = self.interval
        settings["reference_points"], settings["waypoints"] = n, self.pairs * n


class MinimumJerk(_Points, kind="minimum-jerk"):
    """Straight moves in joint space between way-points with minimum jerk (Flash and Hogan 1985).

    Args:
        move_time: duration of a move.
        hold_time: rest after each move.
    """

    move_time: float = number(1.5, unit="s", above=0, kernel="move_time")
    hold_time: float = number(0.5, unit="s", low=0)

    times: ClassVar[tuple[str, ...]] = ("move_time", "hold_time")


class Steps(_Points, kind="steps"):
    """Levels that jump at regular times, first at t = 0. Velocity and acceleration are zero.

    Args:
        period: time between two jumps.
    """

    period: float = number(2.0, unit="s", above=0)


class FilteredSteps(_Points, kind="filtered-steps"):
    """Steps s through a critically damped second-order filter: r'' = w^2 (s - r) - 2 w r'.

    Args:
        period: time between two jumps.
        bandwidth: bandwidth w of the filter.
    """

    period: float = number(2.0, unit="s", above=0)
    bandwidth: Number = number(5.0, unit="rad/s", above=0, varies=True, kernel="bandwidth")

    pairs: ClassVar[int] = 3  # also the filter's state at the start of each segment


class _Oscillation(_Reference):
    """Base of the references that are sums of sines about a centre.

    Args:
        centre: centre of the motion.
        amplitude: bound of `|q - centre|`, the sum of the sines' amplitudes.
    """

    centre: Numbers = pair((-math.pi / 2, 0.0), unit="rad", varies=True, kernel="reference_middle")
    amplitude: Numbers = pair(1.0, unit="rad", low=0, varies=True, kernel="reference_amplitude")

    @property
    def extremes(self) -> Any:
        """Return the lowest and the highest position for any phase."""
        joints: Any = zip(self.centre, self.amplitude, strict=True)  # type: ignore[arg-type]
        centres, sizes = np.transpose([(ends(centre), ends(size)) for centre, size in joints], (1, 2, 0))
        return centres + np.outer([-1, 1], sizes[1])

    def pack(self, packer: Any) -> None:
        """Write the sines; those of `FourierReference` have drawn phases."""
        super().pack(packer)
        settings, fields = packer.settings, vars(self)
        n, phase = fields.get("harmonics", 1), fields.get("phase")
        weights = 1.0 / np.arange(1, n + 1)
        settings["reference_points"] = settings["waypoints"] = n
        settings["reference_phases_drawn"] = phase is None
        settings["reference_table"] = packer.table([*(weights / weights.sum()), *(phase or (0.0, 0.0))])


class SineReference(_Oscillation, kind="sine"):
    """The motion centre + amplitude sin(2 pi frequency t + phase).

    Args:
        frequency: frequency of the motion, the same for both joints.
        phase: phase of the motion; None: drawn per episode.
    """

    amplitude: Numbers = 0.5
    frequency: Number = number(0.25, unit="Hz", above=0, high=1e6, varies=True, kernel="base_rate", scale=2 * np.pi)
    phase: Pair | float | None = pair(0.0, unit="rad", optional=True, low=-1e6, high=1e6)


class FourierReference(_Oscillation, kind="fourier"):
    """An exciting motion: harmonics h of one frequency, amplitudes as 1/h, drawn phases.

    Args:
        frequency: frequency of the first harmonic.
        harmonics: number of harmonics.
    """

    frequency: Number = number(0.1, unit="Hz", above=0, high=1e6, varies=True, kernel="base_rate", scale=2 * np.pi)
    harmonics: int = whole(5, low=1, high=10_000)


class ArrayReference(_Reference, kind="array"):
    """A motion given by samples; the last position holds on.

    Args:
        position: samples of the position.
        dt: time between two samples.
        velocity: samples of the velocity; None: from a cubic spline through the positions.
        acceleration: samples of the acceleration; None: from the same spline.
    """

    position: tuple[Pair, ...] = table(unit="rad")
    dt: float = number(0.01, unit="s", above=0)
    velocity: tuple[Pair, ...] | None = table(None, unit="rad/s")
    acceleration: tuple[Pair, ...] | None = table(None, unit="rad/s^2")

    @property
    def extremes(self) -> Any:
        """Return the samples."""
        return self.position

    def validate(self) -> None:
        """Refuse a velocity or an acceleration of another length."""
        for name, rows in (("velocity", self.velocity), ("acceleration", self.acceleration)):
            if rows is not None and len(rows) != len(self.position):
                raise ValueError(f"{name} must have the {len(self.position)} rows of position, got {len(rows)}")

    def pack(self, packer: Any) -> None:
        """Write a sample for each control step, and one more, held for previews beyond it."""
        super().pack(packer)
        scenario, count = packer.scenario, packer.scenario.steps + 2
        samples = self.samples(scenario.control_dt * np.arange(count))
        samples[-1, 2:] = 0.0
        packer.settings["reference_points"] = count
        packer.settings["reference_table"] = packer.table(samples.ravel())

    def samples(self, times: np.ndarray) -> np.ndarray:
        """Return position, velocity and acceleration at times [n] s, [n x 6]; then at rest."""
        from scipy.interpolate import CubicSpline  # takes as long as all other imports of this package

        if len(self.position) == 1:
            return np.tile([*self.position[0], 0.0, 0.0, 0.0, 0.0], (len(times), 1))
        last, knots = (len(self.position) - 1) * self.dt, self.dt * np.arange(len(self.position))
        clipped, spline = np.minimum(times, last), CubicSpline(knots, self.position)
        columns = [spline(clipped)]
        for order, rows in ((1, self.velocity), (2, self.acceleration)):
            values = spline(clipped, order) if rows is None else CubicSpline(knots, rows)(clipped)
            columns.append(np.where((times <= last + 1e-12)[:, None], values, 0.0))
        return np.hstack(columns)


Reference: TypeAlias = MinimumJerk | Steps | FilteredSteps | SineReference | FourierReference | ArrayReference
#: The kinds of references, in the order of their numbers in the kernel.
REFERENCES = (MinimumJerk, Steps, FilteredSteps, SineReference, FourierReference, ArrayReference)
