"""Options for the differences between the real arm and the nominal model.

The nominal model stays fixed and the real arm varies around it, as in the paper's Table 1. Every
parameter error is a ratio real / nominal. A field of two numbers, one per joint, also takes a
single number for both. An option that is None is off. Most numbers may vary: each episode draws
them from a `Distribution`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from fbl_gym.checks import Pair, check_choice, check_number
from fbl_gym.records import (
    Number,
    Numbers,
    Record,
    choice,
    choices,
    declared,
    ends,
    kind,
    number,
    pair,
    record,
    scaled,
    table,
    whole,
)

PARAMETERS = ("m1", "m2", "L1", "L2")
SENSORS = ("position", "velocity", "acceleration")

MAX_SAMPLES = 10_000
"""Oldest reading that an encoder may need, in control samples."""

Ratios = tuple[float, float, float, float]


@dataclass(frozen=True)
class Payload(Record):
    """A point mass at the tip that the nominal model does not include.

    Args:
        mass: mass of the payload.
        pick_up: time at which the arm grasps it, to the nearest physics step. The grasp is
            inelastic, as that of `events.PickUp`.
        drop: time at which the arm releases it, later than `pick_up`; None: never.
    """

    mass: Number = number(unit="kg", varies=True, low=0)
    pick_up: Number = number(0.0, unit="s", varies=True, low=0)
    drop: Number | None = number(None, unit="s", varies=True)

    def validate(self) -> None:
        """Refuse a drop that does not come after the pick-up."""
        if self.drop is not None:
            check_number("drop", ends(self.drop)[0], above=ends(self.pick_up)[1])


def _ratios(name: str, value: object) -> Ratios:
    """Return the ratios of m1, m2, L1 and L2, from one number, four numbers or a dict."""
    if isinstance(value, Mapping):
        for parameter in value:
            check_choice(f"parameter of {name}", parameter, PARAMETERS)
        value = [value.get(parameter, 1.0) for parameter in PARAMETERS]
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        return (check_number(name, value, above=0),) * 4
    if len(value) != 4:
        raise ValueError(f"{name} must be one number, four (m1, m2, L1, L2) or a dict of them, got {value!r}")
    m1, m2, L1, L2 = (check_number(f"{name} of {p}", x, above=0) for p, x in zip(PARAMETERS, value, strict=True))
    return m1, m2, L1, L2


@dataclass(frozen=True)
class ParameterError(Record):
    """Real parameters that differ from the nominal ones.

    Args:
        ratio: real / nominal. A dict such as {"m2": 2.0} leaves the other parameters at 1; four
            numbers are in the order m1, m2, L1, L2.
        radius: r; each episode multiplies the ratio by a factor drawn log-uniformly from
            [1/(1+r), 1+r]. The paper's "100 %" is r = 1: from half to double.
        parameters: the parameters that the radius varies.
        sampling: "each" draws one factor per parameter, "together" one for all.
        payload: a mass carried at the tip.
    """

    ratio: float | Ratios | Mapping[str, float] = declared(
        1.0, _ratios, "a number greater than 0, four of them or a dict by parameter"
    )
    radius: float = number(0.0, low=0)
    parameters: tuple[str, ...] = choices(PARAMETERS, PARAMETERS)
    sampling: Literal["each", "together"] = choice("each", ("each", "together"))
    payload: Payload | Mapping[str, Any] | float | None = record(Payload, None, scalar="mass")

    @property
    def ratios(self) -> Ratios:
        """Return the fixed ratios of m1, m2, L1 and L2."""
        return self.ratio  # type: ignore[return-value]


@dataclass(frozen=True)
class SensorError(Record):
    """The error of one sensor: a bias, then white noise, then rounding, in the sensor's unit.

    Args:
        sigma: standard deviation of each sample's noise.
        density: one-sided spectral density of the noise in the sensor's unit / sqrt(Hz), in place
            of `sigma`: sigma = density / sqrt(2 control_dt), so that a faster rate is no better
            sensor.
        bias: constant offset.
        quantization: step to whose multiples the reading is rounded; 0: no rounding.
        snr_db: signal-to-noise ratio, against a signal of unit power, in place of `sigma`, as in
            §3.2 of the paper: sigma = 10^(-snr_db / 20).
    """

    sigma: Numbers = pair(0.0, varies=True, low=0)
    density: Numbers = pair(0.0, varies=True, low=0)
    bias: Numbers = pair(0.0, varies=True)
    quantization: Pair | float = pair(0.0, low=0)
    snr_db: float | None = number(None, unit="dB")

    def validate(self) -> None:
        """Refuse two sizes of the noise."""
        if self.snr_db is not None and self.sigma != (0.0, 0.0):
            raise ValueError(f"give sigma or snr_db, not both; got sigma={self.sigma} and snr_db={self.snr_db}")
        if self.density != (0.0, 0.0) and (self.snr_db is not None or self.sigma != (0.0, 0.0)):
            raise ValueError(f"give density or another size, not both; got density={self.density}")

    @property
    def std(self) -> Numbers:
        """Return the standard deviation of each joint's noise, from `sigma` or `snr_db`."""
        if self.snr_db is None:
            return self.sigma
        return (10.0 ** (-self.snr_db / 20.0),) * 2

    def std_at(self, control_dt: float) -> Any:
        """Return the standard deviation of each joint's noise, also from a `density`."""
        if self.density == (0.0, 0.0):
            return self.std
        return tuple(scaled(each, 1 / math.sqrt(2 * control_dt)) for each in self.density)  # type: ignore[union-attr]


@dataclass(frozen=True)
class Noise(Record):
    """The errors of the sensors. A sensor without an error is perfect.

    Args:
        position: error of the joint angles [rad].
        velocity: error of the joint velocities [rad/s].
        acceleration: error of the joint accelerations [rad/s^2].
    """

    position: SensorError | Mapping[str, Any] | Pair | float | None = record(SensorError, None, scalar="sigma")
    velocity: SensorError | Mapping[str, Any] | Pair | float | None = record(SensorError, None, scalar="sigma")
    acceleration: SensorError | Mapping[str, Any] | Pair | float | None = record(SensorError, None, scalar="sigma")


@dataclass(frozen=True)
class Encoder(Record):
    """The encoders of both joints, and the velocity that a drive computes from them.

    The velocity is the difference of two position readings, divided by the time between them, then
    filtered: y += (1 - exp(-2 pi low_pass control_dt)) (x - y).

    Args:
        counts: position readings per turn of the joint; None: no rounding.
        difference: control samples between the two readings; None: the velocity is measured.
        low_pass: cut-off frequency of the filter; None: no filter.
        latency: age of the readings of position and velocity, in control samples.
    """

    counts: Pair | float | None = pair(None, above=0)
    difference: int | None = whole(None, low=1)
    low_pass: float | None = number(None, unit="Hz", above=0)
    latency: int = whole(0)

    def validate(self) -> None:
        """Refuse a filter of a measured velocity, and readings too old to be stored."""
        if self.low_pass is not None and self.difference is None:
            raise ValueError(f"low_pass filters a computed velocity: give difference too, got low_pass={self.low_pass}")
        for name in ("difference", "latency"):
            value = getattr(self, name)
            if value is not None and value > MAX_SAMPLES:
                raise ValueError(f"{name} must be a whole number not above {MAX_SAMPLES}, got {value}")


@dataclass(frozen=True)
class Friction(Record):
    """Joint friction, equation (43): f_i1 v + (f_i2 + f_s exp(-v^2 / v_s)) sign(v).

    Viscous friction that is too large for a Runge-Kutta step is integrated implicitly, by four
    Euler steps: stable at any size, and of first order.

    Args:
        viscous: coefficient of viscous friction, f_i1.
        coulomb: Coulomb friction, f_i2.
        stiction: friction f_s that fades as the joint moves.
        v_s: scale of the squared velocity at which stiction fades.
        stribeck_velocity: in place of `v_s`, w in `f_s exp(-(v / w)^2)`, the usual form
            (Armstrong-Hélouvry, Dupont and Canudas de Wit, Automatica 30, 1994).
        law: "exact" holds a joint at rest under any load up to f_i2 + f_s. "literal" is the formula
            as printed, with sign(0) = 0: no joint ever sticks, and one at rest creeps under a load,
            the slower the shorter the physics step.
    """

    viscous: Numbers = pair(0.0, unit="N m s/rad", varies=True, low=0)
    coulomb: Numbers = pair(0.0, unit="N m", varies=True, low=0)
    stiction: Numbers = pair(0.0, unit="N m", varies=True, low=0)
    v_s: Numbers = pair(1e-3, unit="(rad/s)^2", varies=True, above=0)
    law: Literal["exact", "literal"] = choice("exact", ("exact", "literal"))
    stribeck_velocity: Numbers | None = pair(None, unit="rad/s", varies=True, above=0)

    def validate(self) -> None:
        """Refuse two widths of the peak."""
        if self.stribeck_velocity is not None and self.v_s != (1e-3, 1e-3):
            raise ValueError(
                f"give v_s or stribeck_velocity, not both; got v_s={self.v_s} and {self.stribeck_velocity=}"
            )


@dataclass(frozen=True)
class PiecewiseConstantDisturbance(Record):
    """A torque that jumps to a new level at regular times (§3.2 of the paper).

    Args:
        amplitude: bound of the levels, drawn uniformly from [-amplitude, amplitude].
        period: time between two jumps, a multiple of physics_dt.
    """

    amplitude: Numbers = pair(unit="N m", varies=True, low=0)
    period: float = number(0.5, unit="s", above=0)
    kind: str = kind("piecewise-constant")


@dataclass(frozen=True)
class SineDisturbance(Record):
    """A torque amplitude * sin(2 pi frequency t + phase).

    Args:
        amplitude: amplitude of the torque.
        frequency: frequency of the torque, at most a quarter of 1 / physics_dt.
        phase: phase of the torque; None: drawn per episode.
    """

    amplitude: Numbers = pair(unit="N m", varies=True, low=0)
    frequency: Numbers = pair(1.0, unit="Hz", varies=True, low=0)
    phase: Pair | float | None = pair(None, unit="rad")
    kind: str = kind("sine")


@dataclass(frozen=True)
class PulseDisturbance(Record):
    """A torque in pulses. Times are multiples of physics_dt.

    Args:
        amplitude: torque during a pulse, of either sign.
        period: time from one pulse to the next.
        width: duration of a pulse, at most `period`.
        start: time of the first pulse.
    """

    amplitude: Numbers = pair(unit="N m", varies=True)
    period: float = number(2.0, unit="s", above=0)
    width: float = number(0.1, unit="s", above=0)
    start: float = number(0.0, unit="s", low=0)
    kind: str = kind("pulses")

    def validate(self) -> None:
        """Refuse a pulse longer than the period."""
        check_number("width", self.width, above=0, high=self.period)


@dataclass(frozen=True)
class ArrayDisturbance(Record):
    """A torque given by samples, each held until the next; the last one holds on.

    Args:
        torque: samples of the torque.
        dt: time between two samples, a multiple of physics_dt.
    """

    torque: tuple[Pair, ...] = table(unit="N m")
    dt: float = number(0.01, unit="s", above=0)
    kind: str = kind("array")


Disturbance: TypeAlias = PiecewiseConstantDisturbance | SineDisturbance | PulseDisturbance | ArrayDisturbance
DISTURBANCES = (PiecewiseConstantDisturbance, SineDisturbance, PulseDisturbance, ArrayDisturbance)


@dataclass(frozen=True)
class Actuator(Record):
    """The joint drives: the torque command passes limit, delay, rate limit, lag and gain in turn.

    Args:
        torque_limit: largest torque; None: no limit.
        delay: time from command to torque, a multiple of physics_dt; a draw is rounded to one.
        lag: time constant of a first-order lag after the delay; 0: no lag.
        gain: real / nominal torque, the error of the torque constant.
        delay_samples: control samples from reading to command, which adds to `delay`; a draw is
            rounded to a whole number.
        rate_limit: largest change of the torque per time, before the lag; None: no limit.
    """

    torque_limit: Pair | float | None = pair((2000.0, 800.0), unit="N m", above=0, optional=True)
    delay: Number = number(0.0, unit="s", varies=True, low=0)
    lag: Number = number(0.0, unit="s", varies=True, low=0)
    gain: Numbers = pair(1.0, varies=True, low=0)
    delay_samples: Number = whole(0, varies=True)
    rate_limit: Numbers | None = pair(None, unit="N m/s", varies=True, above=0)
