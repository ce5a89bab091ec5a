"""A scenario: the nominal arm, what differs from it, the motion asked for and the rates. And those that have names.

`get(name)` knows the scenarios of the paper's figures (`paper-3a` ... `paper-10`) and the families of the leaderboard
(`nominal`, `mass-error-0` ... `everything-3`). The paper omits many values; those that the project chose are said in each
scenario's description.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from fbl_gym.arm import SECTION_2_2, TABLE_1, ArmParameters
from fbl_gym.checks import Pair, check_choice, check_number, check_pair, unknown
from fbl_gym.interface import Limits
from fbl_gym.records import build, set_fields
from fbl_gym.references import (
    FilteredSteps,
    MinimumJerk,
    Reference,
    Steps,
    as_reference,
)
from fbl_gym.uncertainty import (
    PARAMETERS,
    SENSORS,
    Actuator,
    ArrayDisturbance,
    Disturbance,
    Friction,
    Noise,
    ParameterError,
    Payload,
    PiecewiseConstantDisturbance,
    PulseDisturbance,
    SensorError,
    as_disturbance,
    steps_of,
)

_HALF = ArmParameters(m1=0.35, m2=0.25, L1=10.0, L2=7.5)  # the estimates of figure 3b, half of §2.2's real arm
_ARMS = {"table-1": TABLE_1, "section-2-2": SECTION_2_2}


@dataclass(frozen=True)
class Scenario:
    """One task. Every field takes its record or the plain data that makes one.

    None switches off what can be absent: parameter_error, noise, friction, disturbance and the limits of the actuator.

    Args:
        arm: the nominal model: ArmParameters, a dict of them, "table-1" or "section-2-2".
        parameter_error: how the real parameters differ; a number is a fixed ratio real / nominal.
        noise: what the sensors add.
        friction: in the joints; the nominal model has none.
        disturbance: torque tau_d of equation (1).
        actuator: torque limits, delay and lag; None: an ideal drive without limits.
        sensors: which of position, velocity and acceleration are measured; position always is.
        reference: the motion asked for.
        control_dt: time between two decisions [s]; the torque command is held in between.
        physics_dt: integration step [s]; divides control_dt.
        duration: length of an episode [s], a multiple of control_dt.
        initial_error: added to the reference's first position [rad] for the arm's start.
        limits: where an episode counts as diverged.
        name, description: for people.
    """

    name: str = "nominal"
    description: str = "the nominal arm: nothing varies but the way-points"
    arm: ArmParameters = TABLE_1
    parameter_error: ParameterError | None = None
    noise: Noise | None = None
    friction: Friction | None = None
    disturbance: Disturbance | None = None
    actuator: Actuator = field(default_factory=Actuator)
    sensors: tuple[str, ...] = SENSORS
    reference: Reference = field(default_factory=MinimumJerk)
    control_dt: float = 0.01
    physics_dt: float = 0.001
    duration: float = 10.0
    initial_error: Pair | float = (0.0, 0.0)
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        arm = self.arm
        if isinstance(arm, str):
            if arm not in _ARMS:
                raise unknown("arm", arm, _ARMS)
            arm = _ARMS[arm]
        set_fields(
            self,
            arm=build("arm", arm, ArmParameters),
            parameter_error=_optional("parameter_error", self.parameter_error, ParameterError, "ratio"),
            noise=_optional("noise", self.noise, Noise),
            friction=_optional("friction", self.friction, Friction),
            disturbance=None if self.disturbance is None else as_disturbance("disturbance", self.disturbance),
            actuator=Actuator(torque_limit=None)
            if self.actuator is None
            else build("actuator", self.actuator, Actuator, scalar="torque_limit"),
            sensors=_sensors(self.sensors),
            reference=as_reference("reference", self.reference),
            control_dt=check_number("control_dt", self.control_dt, above=0),
            physics_dt=check_number("physics_dt", self.physics_dt, above=0),
            duration=check_number("duration", self.duration, above=0),
            initial_error=check_pair("initial_error", self.initial_error),
            limits=build("limits", self.limits, Limits),
        )
        if self.noise is not None:
            for sensor in SENSORS:
                if getattr(self.noise, sensor) is not None and sensor not in self.sensors:
                    raise ValueError(f"noise.{sensor} is given, but sensors={self.sensors} has no {sensor} sensor")
        self._check_rates()

    def _check_rates(self) -> None:
        if self.physics_dt > self.control_dt:
            raise ValueError(
                f"physics_dt must divide control_dt, got physics_dt={self.physics_dt:g} s and control_dt={self.control_dt:g} s"
            )
        steps_of("control_dt", self.control_dt, self.physics_dt, "physics_dt")
        if steps_of("duration", self.duration, self.control_dt, "control_dt") < 1:
            raise ValueError(f"duration must be at least control_dt={self.control_dt:g} s, got {self.duration:g} s")
        steps_of("actuator.delay", self.actuator.delay, self.physics_dt, "physics_dt")
        r = self.reference
        if isinstance(r, MinimumJerk | Steps | FilteredSteps):
            name, value = (
                ("move_time + hold_time", r.move_time + r.hold_time)
                if isinstance(r, MinimumJerk)
                else ("period", r.period)
            )
            if value < self.control_dt:
                raise ValueError(f"reference.{name} must be at least control_dt={self.control_dt:g} s, got {value:g} s")
        d = self.disturbance
        times: dict[str, float] = {}
        if isinstance(d, PiecewiseConstantDisturbance):
            times = {"period": d.period}
        elif isinstance(d, PulseDisturbance):
            times = {"period": d.period, "width": d.width, "start": d.start}
        elif isinstance(d, ArrayDisturbance):
            times = {"dt": d.dt}
        for name, value in times.items():
            if steps_of(f"disturbance.{name}", value, self.physics_dt, "physics_dt") < 1 and name != "start":
                raise ValueError(
                    f"disturbance.{name} must be at least physics_dt={self.physics_dt:g} s, got {value:g} s"
                )

    @property
    def substeps(self) -> int:
        """Physics steps in a control interval."""
        return round(self.control_dt / self.physics_dt)

    @property
    def steps(self) -> int:
        """Control intervals in an episode."""
        return round(self.duration / self.control_dt)

    def replace(self, **changes: Any) -> Scenario:
        """A scenario with some fields changed.  **changes: fields, as records or as plain data."""
        names = [f.name for f in dataclasses.fields(self)]
        for name in changes:
            if name not in names:
                raise unknown("option", name, names)
        return dataclasses.replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """Plain data that `from_dict` turns back into this scenario; survives JSON."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Scenario:
        """The scenario that `to_dict` described.  data: its fields; those that are missing take their defaults."""
        return build("scenario", data, Scenario)


def _optional(name: str, value: Any, cls: type, scalar: str | None = None) -> Any:
    return None if value is None else build(name, value, cls, scalar=scalar)


def _sensors(value: Any) -> tuple[str, ...]:
    if not isinstance(value, str | list | tuple | set | frozenset):
        raise ValueError(f"sensors must be names out of {SENSORS}, got {value!r}")
    names = (value,) if isinstance(value, str) else tuple(value)
    for name in names:
        check_choice("sensor", name, SENSORS)
    if "position" not in names:
        raise ValueError(f"sensors must include 'position', got {names}")
    return tuple(sensor for sensor in SENSORS if sensor in names)


# The families of the leaderboard: one kind of uncertainty each, at severities 0 (none) to 3, for either arm.

SEVERITIES = (0, 1, 2, 3)

_RADII = (0.0, 0.25, 0.5, 1.0)
_NOISE = (
    None,
    Noise(position=1e-4, velocity=1e-3, acceleration=1e-2),
    Noise(position=1e-3, velocity=1e-2, acceleration=1e-1),
    Noise(position=5e-3, velocity=5e-2, acceleration=5e-1),
)
_LOAD = (0.0, 1 / 3, 2 / 3, 1.0)  # of m2
_STICTION = (0.0, 10.0, 30.0, 60.0)
_PUSH = (0.0, 30.0, 100.0, 200.0)
# What each arm needs for the default motion with every parameter between half and double and the heaviest payload
# is 1,683 and 749, and 62,300 and 19,700 N m. Friction and disturbance come on top: at its worst corner, everything-3 can ask
# for some 836 N m of the second joint's 800.
_TORQUE_LIMITS = {"table-1": (2000.0, 800.0), "section-2-2": (70000.0, 22000.0)}


def _error(arm: ArmParameters, severity: int, *parameters: str, load: bool = False) -> ParameterError | None:
    if severity == 0:
        return None
    payload = Payload(mass=_LOAD[severity] * arm.m2, pick_up=3.0, drop=7.0) if load else None
    if not parameters:
        return ParameterError(payload=payload)
    return ParameterError(radius=_RADII[severity], parameters=parameters, payload=payload)


def _one_sided(severity: int, larger: bool) -> ParameterError | None:
    """Each parameter's factor from [1, 1 + r], or from [1/(1+r), 1]: a fixed ratio in the middle, and a radius about it."""
    if severity == 0:
        return None
    middle = math.sqrt(1.0 + _RADII[severity])
    return ParameterError(ratio=middle if larger else 1.0 / middle, radius=middle - 1.0)


def _stiction(severity: int) -> Friction | None:
    level = _STICTION[severity]
    return Friction(coulomb=(level, level / 3), stiction=(level, level / 3), v_s=1e-3) if level else None


def _disturbance(severity: int) -> PiecewiseConstantDisturbance | None:
    level = _PUSH[severity]
    return PiecewiseConstantDisturbance(amplitude=(level, level / 3), period=0.5) if level else None


_FAMILIES: dict[str, tuple[str, Callable[[ArmParameters, int], dict[str, Any]]]] = {
    "mass-error": (
        "masses off by a factor drawn from [1/(1+r), 1+r], each its own; r = 0, 0.25, 0.5, 1",
        lambda arm, s: {"parameter_error": _error(arm, s, "m1", "m2")},
    ),
    "length-error": (
        "lengths off by a factor drawn from [1/(1+r), 1+r], each its own; r = 0, 0.25, 0.5, 1",
        lambda arm, s: {"parameter_error": _error(arm, s, "L1", "L2")},
    ),
    "mixed-error": (
        "masses and lengths off, each by its own factor from [1/(1+r), 1+r]; r = 0, 0.25, 0.5, 1",
        lambda arm, s: {"parameter_error": _error(arm, s, *PARAMETERS)},
    ),
    "uniform-error": (
        "masses and lengths off by one factor for all, drawn from [1/(1+r), 1+r]; r = 0, 0.25, 0.5, 1",
        lambda arm, s: {"parameter_error": ParameterError(radius=_RADII[s], sampling="together") if s else None},
    ),
    "larger-error": (
        "real masses and lengths larger than nominal, each by its own factor from [1, 1+r]; r = 0, 0.25, 0.5, 1",
        lambda arm, s: {"parameter_error": _one_sided(s, larger=True)},
    ),
    "smaller-error": (
        "real masses and lengths smaller than nominal, each by its own factor from [1/(1+r), 1]; r = 0, 0.25, 0.5, 1",
        lambda arm, s: {"parameter_error": _one_sided(s, larger=False)},
    ),
    "payload": (
        "0, 1/3, 2/3 or all of the second link's mass again, picked up at the tip at 3 s and dropped at 7 s",
        lambda arm, s: {"parameter_error": _error(arm, s, load=True)},
    ),
    "noise": (
        "white noise on position (0, 1e-4, 1e-3, 5e-3 rad), ten times that on velocity, a hundred times on acceleration",
        lambda arm, s: {"noise": _NOISE[s]},
    ),
    "stiction": (
        "Coulomb friction and as much stiction again (0, 10, 30, 60 N m; a third of it on joint 2), v_s = 1e-3 (rad/s)^2",
        lambda arm, s: {"friction": _stiction(s)},
    ),
    "disturbance": (
        "piecewise-constant torque within 0, 30, 100, 200 N m (a third of it on joint 2), a new level every 0.5 s",
        lambda arm, s: {"disturbance": _disturbance(s)},
    ),
    "everything": (
        "mixed error, payload, noise, stiction and disturbance at once",
        lambda arm, s: {
            "parameter_error": _error(arm, s, *PARAMETERS, load=True),
            "noise": _NOISE[s],
            "friction": _stiction(s),
            "disturbance": _disturbance(s),
        },
    ),
}


def families() -> dict[str, str]:
    """The names of the leaderboard's families, each with a line that says what it varies."""
    return {"nominal": "the nominal arm: nothing varies but the way-points"} | {k: v[0] for k, v in _FAMILIES.items()}


def arms() -> tuple[str, ...]:
    """The arms that families exist for: "table-1" and "section-2-2", both of the paper."""
    return tuple(_ARMS)


def family(name: str, severity: int = 0, arm: str = "table-1") -> Scenario:
    """The scenario of a family; its name is such as "mass-error-2", or "section-2-2/mass-error-2".

    Args:
        name: one of `families()`.
        severity: 0 (the nominal arm) to 3.
        arm: one of `arms()`.
    """
    if name not in families():
        raise unknown("family", name, families())
    if isinstance(severity, bool) or severity not in SEVERITIES:
        raise ValueError(f"severity must be one of {SEVERITIES}, got {severity!r}")
    if arm not in _ARMS:
        raise unknown("arm", arm, _ARMS)
    severity = int(severity)
    parameters = _ARMS[arm]
    text = families()[name]
    options = {} if name == "nominal" else _FAMILIES[name][1](parameters, severity)
    return Scenario(
        name=_family_name(name, severity, arm),
        description=text,
        arm=parameters,
        actuator=Actuator(torque_limit=_TORQUE_LIMITS[arm]),
        **options,
    )


def _family_name(name: str, severity: int, arm: str) -> str:
    own = name if name == "nominal" else f"{name}-{severity}"
    return own if arm == "table-1" else f"{arm}/{own}"


# The scenarios of the paper's figures.

_LEVELS = ((0.0, 0.0), (1.0, 0.5), (0.2, 1.0), (0.8, -0.5), (0.0, 0.5), (1.0, 0.0))
_KILOHERTZ: dict[str, Any] = {"control_dt": 1e-3, "physics_dt": 1e-3}
_STEPS = FilteredSteps(points=_LEVELS, period=2.0, bandwidth=8.0)
_PAPER_NOISE = SensorError(sigma=0.01)


def _paper(name: str, description: str, **options: Any) -> Scenario:
    return Scenario(
        name=name, description=description, **({"actuator": Actuator(torque_limit=None)} | _KILOHERTZ | options)
    )


def _paper_scenarios() -> dict[str, Scenario]:
    noise = Noise(position=_PAPER_NOISE, velocity=_PAPER_NOISE, acceleration=_PAPER_NOISE)
    robust = {
        "arm": _HALF,
        "parameter_error": 2.0,
        "noise": noise,
        "disturbance": PiecewiseConstantDisturbance(amplitude=(50.0, 20.0), period=0.5),
        "reference": _STEPS,
    }
    robust_text = (
        "§3.2: estimates at half the real values, sensor noise, piecewise-constant disturbance. Project's choice: "
        "sigma = 0.01 per 1 ms sample on every sensor, 50 and 20 N m every 0.5 s, steps behind a filter of 8 rad/s"
    )
    exciting = as_reference("reference", {"kind": "fourier", "centre": (0.0, 0.0), "frequency": 0.2})
    estimation = "no friction, no noise. Project's choice: exciting Fourier reference of 1 rad, no torque limit"
    stiction = Friction(coulomb=(10.0, 5.0), stiction=(30.0, 15.0), v_s=1e-3)
    return {
        s.name: s
        for s in (
            _paper(
                "paper-3a",
                "figure 3a: §2.2's arm as printed, perfect model. Project's choice: literal steps of up to 1.5 rad every "
                "4 s, 1 kHz, no torque limit",
                arm=SECTION_2_2,
                reference=Steps(points=_LEVELS, period=4.0),
                duration=20.0,
            ),
            _paper(
                "paper-3b",
                "figure 3b: as 3a, with every estimate at half the real value",
                arm=_HALF,
                parameter_error=2.0,
                reference=Steps(points=_LEVELS, period=4.0),
                duration=20.0,
            ),
            _paper("paper-4a", "figure 4a, without the Kalman filter. " + robust_text, **robust),
            _paper("paper-4b", "figure 4b, with the Kalman filter. " + robust_text, **robust),
            _paper(
                "paper-6a",
                f"figure 6a: every parameter ten times its estimate, {estimation}",
                parameter_error=10.0,
                reference=exciting,
            ),
            _paper(
                "paper-6b",
                f"figure 6b: every parameter a tenth of its estimate, {estimation}, 10 kHz",
                parameter_error=0.1,
                reference=exciting,
                control_dt=1e-4,
                physics_dt=1e-4,
                actuator=Actuator(),
            ),
            _paper(
                "paper-8",
                "figure 8: stiction that the model misses. Project's choice: Coulomb 10 and 5, stiction 30 and 15 N m, "
                "v_s = 1e-3 (rad/s)^2",
                friction=stiction,
                reference=_STEPS,
            ),
            _paper(
                "paper-10",
                "figure 10: every parameter ten times its estimate, stiction as in figure 8 by the printed formula, and a "
                "piecewise-constant disturbance. Project's choice: 200 and 100 N m every 2 s, steps behind a filter of 8 rad/s",
                parameter_error=10.0,
                friction=dataclasses.replace(stiction, law="literal"),
                disturbance=PiecewiseConstantDisturbance(amplitude=(200.0, 100.0), period=2.0),
                reference=_STEPS,
            ),
        )
    }


_PAPER = _paper_scenarios()


def _members() -> dict[str, tuple[str, int, str]]:
    """Family, severity and arm of every member's name."""
    found = {}
    for arm in _ARMS:
        for name in families():
            for severity in SEVERITIES if name != "nominal" else (0,):
                found[_family_name(name, severity, arm)] = (name, severity, arm)
    return found


def names() -> tuple[str, ...]:
    """Every name that `get` knows: the figures of the paper, then the families with their severities, for both arms."""
    return (*_PAPER, *_members())


def get(name: str) -> Scenario:
    """The scenario of that name.  name: one of `names()`."""
    if name in _PAPER:
        return _PAPER[name]
    members = _members()
    if name not in members:
        raise unknown("scenario", name, names())
    return family(*members[name])


def as_scenario(value: Any) -> Scenario:
    """A scenario from itself, its name, or the plain data that makes one; None: the nominal one."""
    if value is None:
        return Scenario()
    if isinstance(value, str):
        return get(value)
    return build("scenario", value, Scenario)
