"""The scenario: a nominal arm, its uncertainties, a reference and the rates."""

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

from fbl_gym.interface import class_of
from fbl_gym.model.arm import ARMS, TABLE_1, ArmParameters, Links
from fbl_gym.model.real_arms import REAL_ARMS
from fbl_gym.model.urdf import FILE, RobotFile, read_robot
from fbl_gym.options import Actuator, Datasheet, ElasticJoint, FlexibleLink, Friction, MuJoCo, ParameterError
from fbl_gym.options.disturbance import DISTURBANCES, Disturbance
from fbl_gym.options.events import Event, FrictionChange, events
from fbl_gym.options.limits import Constraints, Limits
from fbl_gym.options.link import fastest_rate
from fbl_gym.options.parameter_error import times
from fbl_gym.options.plants import PLANTS
from fbl_gym.options.references import REFERENCES, MinimumJerk, Reference
from fbl_gym.options.sensors import SENSORS, Encoder, Noise
from fbl_gym.records.checks import Pair, check_choice, unknown
from fbl_gym.records.record import Numbers, Option, build, choice, choices, declared, ends, number, one_of, pair, record


def as_arm(name: str, value: Any) -> ArmParameters:
    """Return an arm from itself, its name or file, or its fields or those of `Links`."""
    if isinstance(value, RobotFile):
        return value.arm
    if isinstance(value, str):
        known = ARMS | REAL_ARMS
        value = known[check_choice(name, value, known)]
    if isinstance(value, Mapping) and value.keys() & {"mass", "length"}:
        return build(name, value, Links).arm
    return build(name, value, ArmParameters)


def _actuator(name: str, value: Any) -> Actuator:
    return build(name, value, Actuator, scalar="torque_limit")  # None is that of the torque limit


#: Largest physics step, times the fastest rate of joints and links. A vibration of that rate then
#: loses 0.01 % of its amplitude per step to the integration, slower ones far less.
LARGEST_STEP = 0.5

#: The same with the rate of decay by viscous friction; Runge-Kutta is stable up to 2.78.
LARGEST_DECAY = 1.0

#: Largest number of physics steps in a control step, also of MuJoCo.
MAX_SUBSTEPS = 10_000


class Scenario(Option):
    """One task. Each field takes its record or the plain data that makes one.

    None switches off parameter_error, noise, encoder, friction, disturbance and the limits of the
    actuator.

    Args:
        name: for people.
        description: for people.
        arm: the nominal model.
        parameter_error: real parameters that differ from the nominal ones; a number is a fixed
            ratio real / nominal.
        noise: errors of the sensors.
        encoder: rounding and latency of the readings, and the velocity computed from them; a number
            is its counts.
        friction: joint friction; the nominal model has none.
        disturbance: torque tau_d of equation (1).
        actuator: torque limits, delay and lag; None: an ideal drive without limits.
        joint: springs between motors and links; None: rigid joints.
        link: links that bend; None: rigid ones.
        datasheet: what policies are told of drive, sensors and joint; None: the truth.
        events: changes of the real arm at a time.
        sensors: the measured signals; they include "position".
        reference: motion that the arm follows.
        control_dt: time between two decisions; the torque command is held in between.
        physics_dt: integration step; divides control_dt.
        duration: length of an episode, a multiple of control_dt.
        initial_error: difference between the arm's first position and the reference's.
        initial_velocity: likewise for the velocity.
        limits: bounds beyond which the arm has diverged, and ranges of the observation.
        constraints: bounds that the arm shall keep.
        plant: engine that moves the real arm; None: the package's own.
        drawn_per: "seed": every episode of a seed has the arm, the drawn numbers and the reference
            of its first one. Noise, and the course of a disturbance, are new in each episode.
    """

    name: str = "nominal"
    description: str = "the nominal arm: nothing varies but the way-points"
    arm: ArmParameters = declared(
        TABLE_1,
        as_arm,
        "an ArmParameters, a dict of its fields, or of mass, length, centre and inertia in kg, m and kg m^2 (`Links`), "
        "the path of a .urdf file or MuJoCo's .xml (or FILE.urdf:TIP), "
        + ", ".join(f'"{name}"' for name in ARMS | REAL_ARMS),
        classes=(ArmParameters,),
    )
    parameter_error: ParameterError | None = record(ParameterError, None, scalar="ratio", none=ParameterError())
    noise: Noise | None = record(Noise, None)
    encoder: Encoder | None = record(Encoder, None, scalar="counts")
    friction: Friction | None = record(Friction, None, none=Friction())
    disturbance: Disturbance | None = one_of(DISTURBANCES, None)
    actuator: Actuator = declared(
        Actuator(), _actuator, "an Actuator, a dict of its fields, its torque_limit or None", classes=(Actuator,)
    )
    joint: ElasticJoint | None = record(ElasticJoint, None, scalar="stiffness")
    link: FlexibleLink | None = record(FlexibleLink, None, scalar="frequency")
    datasheet: Datasheet | None = record(Datasheet, None)
    events: tuple[Event, ...] = events()
    sensors: tuple[str, ...] = choices(SENSORS, SENSORS)
    reference: Reference = one_of(REFERENCES, MinimumJerk())
    control_dt: float = number(0.01, unit="s", above=0, kernel="control_dt")
    physics_dt: float = number(0.001, unit="s", above=0, kernel="physics_dt")
    duration: float = number(10.0, unit="s", above=0, high=1e6)
    initial_error: Numbers = pair(0.0, unit="rad", varies=True, kernel="initial_error")
    initial_velocity: Numbers = pair(0.0, unit="rad/s", varies=True, kernel="initial_velocity")
    limits: Limits = record(Limits, Limits())
    constraints: Constraints | None = record(Constraints, None, none=Constraints())
    plant: MuJoCo | None = one_of(PLANTS, None)
    drawn_per: Literal["episode", "seed"] = choice("episode", ("episode", "seed"), kernel="drawn_per_seed")

    derived: ClassVar = {
        "substeps": int, "real_rotor": (float, 2), "external_physics": bool, "senses_acceleration": bool,
    }  # fmt: skip

    def __post_init__(self) -> None:
        if isinstance(self.arm, str) and FILE.match(self.arm):
            given = {name: value for name, value in vars(self).items() if value is not getattr(type(self), name)}
            vars(self).update(read_robot(self.arm).options(given, Scenario().to_dict()))
        super().__post_init__()

    def validate(self) -> None:
        """Refuse times that do not divide, too many steps, and options that do not fit together."""
        for name in ("name", "description"):
            if not isinstance(text := getattr(self, name), str):
                raise ValueError(f"{name} must be a text, got {text!r}")
        if "position" not in self.sensors:
            raise ValueError(f"sensors must include 'position', got {self.sensors}")
        self.check_multiple("control_dt", self.control_dt, "physics_dt", least=1)
        substeps = self.substeps * (1 if self.plant is None else self.plant.substeps)
        if substeps > MAX_SUBSTEPS:
            raise ValueError(
                f"control_dt must have at most {MAX_SUBSTEPS} physics steps (or steps of MuJoCo), got {substeps}: "
                "give a longer physics_dt, or less plant.substeps"
            )
        self.check_multiple("duration", self.duration, "control_dt", least=1)
        for option in self.options:
            option.check(self)
        self._check_rates()

    @property
    def options(self) -> list[Option]:
        """Return the records of the options that are on."""
        return [option for option in (*vars(self).values(), *self.events) if isinstance(option, Option)]

    def pack(self, packer: Any) -> None:
        """Write rates, rotors and the kind of physics."""
        settings = packer.settings
        settings["substeps"], settings["real_rotor"] = self.substeps, self.rotor
        settings["external_physics"] = self.plant is not None
        settings["senses_acceleration"] = "acceleration" in self.sensors

    def check_multiple(self, name: str, duration: float, dt_name: str, least: int = 0) -> None:
        """Refuse a duration that is no multiple of a time step, or less than `least` steps."""
        dt = getattr(self, dt_name)
        steps = round(duration / dt)
        if not math.isclose(steps * dt, duration, rel_tol=1e-9, abs_tol=1e-12):
            raise ValueError(f"{name} must be a multiple of {dt_name}={dt:g} s, got {name}={duration:g} s")
        if steps < least:
            raise ValueError(f"{name} must be at least {dt_name}={dt:g} s, got {duration:g} s")

    def _check_rates(self) -> None:
        """Refuse a physics step too long for links that bend, elastic joints or friction."""
        if self.link is not None:
            cause, most = "these links (link.frequency, link.damping)", LARGEST_STEP
        elif self.joint is not None:
            cause, most = "these joints (joint.stiffness, frequency, damping)", LARGEST_STEP
        elif self.friction is not None and self.plant is None:
            cause, most = "this friction", LARGEST_DECAY
        else:
            return
        error = self.parameter_error or ParameterError()
        options = self.arm, times(self.rotor, error.rotor, 0), self.most_viscous, self.joint, self.link
        # The lightest links are the fastest. Lengths may act either way.
        rate = max(fastest_rate(arm, *options) for arm in error.lightest(self.arm))
        most *= 1 if self.plant is None else self.plant.substeps
        if self.physics_dt * rate > most:
            # A part of the step given divides the times of other options, too.
            longest = self.physics_dt / math.ceil(self.physics_dt * rate / most)
            raise ValueError(
                f"physics_dt={self.physics_dt:g} s is too long for {cause}, whose fastest rate is {rate:.4g} 1/s; "
                f"physics_dt={longest:.10g} s would do"
            )

    @property
    def robot_class(self) -> str:
        """The class of robots that the arm is most like, see `interface.class_of`."""
        return class_of(self.control_dt, None if self.joint is None else self.joint.encoder)

    @property
    def rotor(self) -> Pair:
        """Return the rotor inertias of the drives, reflected to the joints [kg m^2].

        `parameter_error.rotor` multiplies them.
        """
        given = self.joint.rotor_inertia if self.joint is not None else None
        return self.arm.rotor if given is None else given  # type: ignore[return-value]

    @property
    def most_viscous(self) -> Pair:
        """Return the largest viscous friction of each joint, over draws and events [N m s/rad]."""
        first, second = (0.0, 0.0) if self.friction is None else (ends(x)[1] for x in self.friction.viscous)  # type: ignore[union-attr]
        for event in self.events:
            if isinstance(event, FrictionChange):
                factors = (max(1.0, ends(factor)[1]) for factor in event.factor)  # type: ignore[union-attr]
                first, second = (x * factor for x, factor in zip((first, second), factors, strict=True))
        return first, second

    @property
    def substeps(self) -> int:
        """Return the number of physics steps in a control interval."""
        return round(self.control_dt / self.physics_dt)

    @property
    def steps(self) -> int:
        """Return the number of control intervals in an episode."""
        return round(self.duration / self.control_dt)

    def replace(self, **changes: Any) -> Self:
        """Return a scenario with some fields changed.

        Args:
            **changes: fields, as records or as plain data.
        """
        names = [field.name for field in dataclasses.fields(self)]
        for name in changes:
            if name not in names:
                raise unknown("option", name, names)
        if isinstance(changes.get("arm"), str) and FILE.match(changes["arm"]):
            changes = read_robot(changes["arm"]).options(changes, self.to_dict())
        return dataclasses.replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as plain data, which survives JSON. `from_dict` reads it."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Scenario":
        """Return the scenario that `to_dict` described.

        Args:
            data: its fields; missing ones take their defaults.
        """
        return build("scenario", data, Scenario)
