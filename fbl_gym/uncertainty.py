"""What may differ between the real arm and the nominal model: one frozen record per kind, off when absent.

The nominal model stays fixed and the plant varies around it, as the paper's Table 1 does, so every error is a
ratio real / nominal. Per-joint values take one number for both joints or a pair.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from fbl_gym.checks import Pair, check_choice, check_number, check_pair, check_table
from fbl_gym.records import build, build_kind, set_fields

PARAMETERS = ("m1", "m2", "L1", "L2")
SENSORS = ("position", "velocity", "acceleration")


@dataclass(frozen=True)
class Payload:
    """A point mass at the tip that the nominal model does not know.

    Args:
        mass: [kg], zero or more.
        pick_up: when it is grasped [s] (to the nearest physics step); joint velocities do not jump.
        drop: when it is released [s], likewise, later than `pick_up`; None: never.
    """

    mass: float
    pick_up: float = 0.0
    drop: float | None = None

    def __post_init__(self) -> None:
        set_fields(
            self, mass=check_number("mass", self.mass, low=0), pick_up=check_number("pick_up", self.pick_up, low=0)
        )
        if self.drop is not None:
            set_fields(self, drop=check_number("drop", self.drop, above=self.pick_up))


@dataclass(frozen=True)
class ParameterError:
    """How the real arm's parameters differ from the nominal ones.

    Args:
        ratio: real / nominal: one number for all four parameters, a dict such as {"m2": 2.0} (the rest are 1),
            or four numbers in the order m1, m2, L1, L2. Positive.
        radius: r >= 0. Each episode multiplies the ratio by a factor drawn log-uniformly from [1/(1+r), 1+r], so that
            r = 1 is the paper's "100 %": from half to double.
        parameters: which parameters the radius touches.
        sampling: "each" draws one factor per parameter, "together" one for all.
        payload: a Payload, the dict that makes one, or its mass [kg]; None: none.
    """

    ratio: float | tuple[float, float, float, float] | Mapping[str, float] = 1.0
    radius: float = 0.0
    parameters: tuple[str, ...] = PARAMETERS
    sampling: Literal["each", "together"] = "each"
    payload: Payload | Mapping[str, Any] | float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.parameters, str | list | tuple):
            raise ValueError(f"parameters must be names out of {PARAMETERS}, got {self.parameters!r}")
        names = (self.parameters,) if isinstance(self.parameters, str) else tuple(self.parameters)
        set_fields(
            self,
            ratio=_ratios(self.ratio),
            radius=check_number("radius", self.radius, low=0),
            parameters=tuple(check_choice("parameter", name, PARAMETERS) for name in names),
            sampling=check_choice("sampling", self.sampling, ("each", "together")),
        )
        if self.payload is not None:
            set_fields(self, payload=build("payload", self.payload, Payload, scalar="mass"))

    @property
    def ratios(self) -> tuple[float, float, float, float]:
        """The fixed ratios of m1, m2, L1, L2."""
        return self.ratio  # type: ignore[return-value]


def _ratios(value: object) -> tuple[float, ...]:
    if isinstance(value, Mapping):
        for name in value:
            check_choice("parameter of ratio", name, PARAMETERS)
        value = [value.get(name, 1.0) for name in PARAMETERS]
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        if len(value) != 4:
            raise ValueError(f"ratio must be one number, four (m1, m2, L1, L2) or a dict of them, got {value!r}")
        return tuple(check_number(f"ratio of {p}", x, above=0) for p, x in zip(PARAMETERS, value, strict=True))
    return (check_number("ratio", value, above=0),) * 4


@dataclass(frozen=True)
class SensorError:
    """What one sensor adds to the truth: bias, then white noise, then rounding. Units of the sensor, per joint.

    Args:
        sigma: standard deviation of the noise of each sample (not a spectral density).
        bias: constant offset.
        quantization: step to whose multiples the reading is rounded; 0: none.
        snr_db: the noise by its signal-to-noise ratio instead, in dB against a signal of unit power, as the paper gives it
            (§3.2): sigma = 10^(-snr_db / 20). Excludes `sigma`.
    """

    sigma: Pair | float = 0.0
    bias: Pair | float = 0.0
    quantization: Pair | float = 0.0
    snr_db: float | None = None

    def __post_init__(self) -> None:
        set_fields(
            self,
            sigma=check_pair("sigma", self.sigma, low=0),
            bias=check_pair("bias", self.bias),
            quantization=check_pair("quantization", self.quantization, low=0),
        )
        if self.snr_db is not None:
            set_fields(self, snr_db=check_number("snr_db", self.snr_db))
            if self.sigma != (0.0, 0.0):
                raise ValueError(f"give sigma or snr_db, not both; got sigma={self.sigma} and snr_db={self.snr_db}")

    @property
    def std(self) -> Pair:
        """Standard deviation of each joint's noise, from `sigma` or `snr_db`."""
        if self.snr_db is None:
            return self.sigma  # type: ignore[return-value]
        return (10.0 ** (-self.snr_db / 20.0),) * 2


@dataclass(frozen=True)
class Noise:
    """The errors of the sensors.

    Args:
        position, velocity, acceleration: of the sensor in [rad], [rad/s], [rad/s^2]: a SensorError, the dict that makes one,
            or its sigma; None: a perfect sensor.
    """

    position: SensorError | Mapping[str, Any] | Pair | float | None = None
    velocity: SensorError | Mapping[str, Any] | Pair | float | None = None
    acceleration: SensorError | Mapping[str, Any] | Pair | float | None = None

    def __post_init__(self) -> None:
        for name in SENSORS:
            value = getattr(self, name)
            if value is not None:
                set_fields(self, **{name: build(name, value, SensorError, scalar="sigma")})


@dataclass(frozen=True)
class Friction:
    """Joint friction, equation (43): f_i1 v + (f_i2 + f_s exp(-v^2 / v_s)) sign(v).

    Args:
        viscous: f_i1 [N m s/rad].
        coulomb: f_i2 [N m].
        stiction: f_s [N m], the part that fades once the joint moves.
        v_s: its velocity scale [(rad/s)^2], positive.
        law: "exact" holds a joint at rest under any load up to f_i2 + f_s; "literal" is the formula as printed, with
            sign(0) = 0, under which nothing ever sticks.
    """

    viscous: Pair | float = 0.0
    coulomb: Pair | float = 0.0
    stiction: Pair | float = 0.0
    v_s: Pair | float = 1e-3
    law: Literal["exact", "literal"] = "exact"

    def __post_init__(self) -> None:
        set_fields(
            self,
            viscous=check_pair("viscous", self.viscous, low=0),
            coulomb=check_pair("coulomb", self.coulomb, low=0),
            stiction=check_pair("stiction", self.stiction, low=0),
            v_s=check_pair("v_s", self.v_s, above=0),
            law=check_choice("law", self.law, ("exact", "literal")),
        )


@dataclass(frozen=True)
class PiecewiseConstantDisturbance:
    """Torque that jumps to a new level every `period`, drawn uniformly from [-amplitude, amplitude] (§3.2 of the paper).

    Args:
        amplitude: [N m], per joint.
        period: [s], a multiple of physics_dt.
        kind: "piecewise-constant"; tells this record from the others in plain data.
    """

    amplitude: Pair | float
    period: float = 0.5
    kind: str = "piecewise-constant"

    def __post_init__(self) -> None:
        set_fields(
            self,
            amplitude=check_pair("amplitude", self.amplitude, low=0),
            period=check_number("period", self.period, above=0),
            kind=check_choice("kind", self.kind, (type(self).kind,)),
        )


@dataclass(frozen=True)
class SineDisturbance:
    """Torque amplitude * sin(2 pi frequency t + phase).

    Args:
        amplitude: [N m], per joint.
        frequency: [Hz], per joint.
        phase: [rad], per joint; None: drawn per episode.
        kind: "sine"; tells this record from the others in plain data.
    """

    amplitude: Pair | float
    frequency: Pair | float = 1.0
    phase: Pair | float | None = None
    kind: str = "sine"

    def __post_init__(self) -> None:
        set_fields(
            self,
            amplitude=check_pair("amplitude", self.amplitude, low=0),
            frequency=check_pair("frequency", self.frequency, low=0),
            phase=None if self.phase is None else check_pair("phase", self.phase),
            kind=check_choice("kind", self.kind, (type(self).kind,)),
        )


@dataclass(frozen=True)
class PulseDisturbance:
    """Torque `amplitude` from `start`, for `width` out of every `period`; zero otherwise.

    Args:
        amplitude: [N m], per joint, of either sign.
        period, width, start: [s], multiples of physics_dt, with width <= period.
        kind: "pulses"; tells this record from the others in plain data.
    """

    amplitude: Pair | float
    period: float = 2.0
    width: float = 0.1
    start: float = 0.0
    kind: str = "pulses"

    def __post_init__(self) -> None:
        period = check_number("period", self.period, above=0)
        set_fields(
            self,
            amplitude=check_pair("amplitude", self.amplitude),
            period=period,
            width=check_number("width", self.width, above=0, high=period),
            start=check_number("start", self.start, low=0),
            kind=check_choice("kind", self.kind, (type(self).kind,)),
        )


@dataclass(frozen=True)
class ArrayDisturbance:
    """The user's own torque, held between samples; its last row holds on.

    Args:
        torque: [n x 2] N m.
        dt: sample time [s], a multiple of physics_dt.
        kind: "array"; tells this record from the others in plain data.
    """

    torque: tuple[Pair, ...]
    dt: float = 0.01
    kind: str = "array"

    def __post_init__(self) -> None:
        set_fields(
            self,
            torque=check_table("torque", self.torque),
            dt=check_number("dt", self.dt, above=0),
            kind=check_choice("kind", self.kind, (type(self).kind,)),
        )


Disturbance: TypeAlias = PiecewiseConstantDisturbance | SineDisturbance | PulseDisturbance | ArrayDisturbance


def as_disturbance(name: str, value: object) -> Disturbance:
    """A disturbance from its record or from a dict with its `kind`."""
    return build_kind(name, value, (PiecewiseConstantDisturbance, SineDisturbance, PulseDisturbance, ArrayDisturbance))


@dataclass(frozen=True)
class Actuator:
    """The joint drives.

    Args:
        torque_limit: the largest torque [N m], per joint; None: no limit.
        delay: time [s] from command to torque, a multiple of physics_dt.
        lag: time constant [s] of a first-order lag behind it; 0: none.
    """

    torque_limit: Pair | float | None = (2000.0, 800.0)
    delay: float = 0.0
    lag: float = 0.0

    def __post_init__(self) -> None:
        limit = self.torque_limit
        set_fields(
            self,
            torque_limit=None if limit is None else check_pair("torque_limit", limit, above=0),
            delay=check_number("delay", self.delay, low=0),
            lag=check_number("lag", self.lag, low=0),
        )


def steps_of(name: str, duration: float, dt: float, dt_name: str) -> int:
    """How many times `dt` goes into `duration`; an error that names both where it does not divide."""
    n = round(duration / dt)
    if not math.isclose(n * dt, duration, rel_tol=1e-9, abs_tol=1e-12):
        raise ValueError(f"{name} must be a multiple of {dt_name}={dt:g} s, got {name}={duration:g} s")
    return n
