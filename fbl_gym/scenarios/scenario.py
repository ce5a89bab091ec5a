"""The scenario: a nominal arm, its uncertainties, a reference and the rates."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fbl_gym.arm import ARMS, TABLE_1, ArmParameters
from fbl_gym.checks import Pair, check_choice, unknown
from fbl_gym.events import Event, FrictionChange, events
from fbl_gym.interface import Constraints, Limits
from fbl_gym.joints import LARGEST_STEP, ElasticJoint, fastest_rate
from fbl_gym.plants import PLANTS, MuJoCo
from fbl_gym.real_arms import REAL_ARMS
from fbl_gym.records import Numbers, Record, build, choice, choices, declared, ends, number, one_of, pair, record
from fbl_gym.references import REFERENCES, ArrayReference, FilteredSteps, MinimumJerk, Reference, Steps
from fbl_gym.uncertainty import (
    DISTURBANCES,
    SENSORS,
    Actuator,
    Disturbance,
    Encoder,
    Friction,
    Noise,
    ParameterError,
    SensorError,
    SineDisturbance,
)
from fbl_gym.urdf import load_urdf


def _arm(name: str, value: Any) -> ArmParameters:
    if isinstance(value, str) and value.endswith(".urdf"):
        return load_urdf(value)
    if isinstance(value, str):
        known = ARMS | REAL_ARMS
        value = known[check_choice(name, value, known)]
    return build(name, value, ArmParameters)


def _actuator(name: str, value: Any) -> Actuator:
    if value is None:
        return Actuator(torque_limit=None)
    return build(name, value, Actuator, scalar="torque_limit")


MAX_SUBSTEPS = 10_000
"""Largest number of physics steps in a control step, also of MuJoCo."""

MAX_STEPS = 2**53
"""Largest number of steps in any duration: beyond it, a float64 does not hold each whole number."""


@dataclass(frozen=True)
class Scenario(Record):
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
        _arm,
        "an ArmParameters, a dict of its fields, the path of a .urdf file, "
        + ", ".join(f'"{name}"' for name in ARMS | REAL_ARMS),
        classes=(ArmParameters,),
    )
    parameter_error: ParameterError | None = record(ParameterError, None, scalar="ratio")
    noise: Noise | None = record(Noise, None)
    encoder: Encoder | None = record(Encoder, None, scalar="counts")
    friction: Friction | None = record(Friction, None)
    disturbance: Disturbance | None = one_of(DISTURBANCES, None)
    actuator: Actuator = declared(
        Actuator(), _actuator, "an Actuator, a dict of its fields, its torque_limit or None", classes=(Actuator,)
    )
    joint: ElasticJoint | None = record(ElasticJoint, None, scalar="stiffness")
    events: tuple[Event, ...] = events()
    sensors: tuple[str, ...] = choices(SENSORS, SENSORS)
    reference: Reference = one_of(REFERENCES, MinimumJerk())
    control_dt: float = number(0.01, unit="s", above=0)
    physics_dt: float = number(0.001, unit="s", above=0)
    duration: float = number(10.0, unit="s", above=0)
    initial_error: Numbers = pair(0.0, unit="rad", varies=True)
    initial_velocity: Numbers = pair(0.0, unit="rad/s", varies=True)
    limits: Limits = record(Limits, Limits())
    constraints: Constraints | None = record(Constraints, None)
    plant: MuJoCo | None = one_of(PLANTS, None)
    drawn_per: Literal["episode", "seed"] = choice("episode", ("episode", "seed"))

    def validate(self) -> None:
        """Refuse noise on a sensor that is left out, times that do not divide, too many steps."""
        for name in ("name", "description"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"{name} must be text, got {getattr(self, name)!r}")
        if "position" not in self.sensors:
            raise ValueError(f"sensors must include 'position', got {self.sensors}")
        for sensor in SENSORS:
            if getattr(self.noise, sensor, None) is not None and sensor not in self.sensors:
                raise ValueError(f"noise.{sensor} is given, but sensors={self.sensors} has no {sensor} sensor")
        encoder = self.encoder
        if encoder is not None and encoder.difference is not None:
            if "velocity" not in self.sensors:
                raise ValueError(f"encoder.difference computes a velocity, but sensors={self.sensors} has none")
            if self.noise is not None and self.noise.velocity is not None:
                raise ValueError(
                    "noise.velocity is of a measured velocity, but encoder.difference computes it from the position"
                )
        position: SensorError | None = getattr(self.noise, "position", None)
        rounded = position is not None and position.quantization != (0.0, 0.0)
        if rounded and encoder is not None and encoder.counts is not None:
            raise ValueError(f"give encoder.counts or noise.position.quantization, not both; got {encoder.counts=}")
        if self.physics_dt > self.control_dt:
            raise ValueError(
                "physics_dt must divide control_dt, "
                f"got physics_dt={self.physics_dt:g} s and control_dt={self.control_dt:g} s"
            )
        self._check_multiple("control_dt", self.control_dt, "physics_dt")
        if self.substeps > MAX_SUBSTEPS:
            raise ValueError(
                f"physics_dt must be at least control_dt / {MAX_SUBSTEPS} = {self.control_dt / MAX_SUBSTEPS:g} s, "
                f"got {self.physics_dt:g} s"
            )
        if self.plant is not None and self.substeps * self.plant.substeps > MAX_SUBSTEPS:
            raise ValueError(
                f"plant.substeps must be at most {MAX_SUBSTEPS // self.substeps}, so that a control step has no more than "
                f"{MAX_SUBSTEPS} steps of MuJoCo, got {self.plant.substeps}"
            )
        self._check_multiple("duration", self.duration, "control_dt", least=1)
        if isinstance(self.actuator.delay, float):
            self._check_multiple("actuator.delay", self.actuator.delay, "physics_dt")
        if self.friction is None and any(isinstance(event, FrictionChange) for event in self.events):
            raise ValueError("events change friction, but friction is None: give the friction that they change")
        self._check_joint()
        self._check_reference()
        self._check_disturbance()

    def _check_joint(self) -> None:
        """Refuse elastic joints without rotors, or too stiff for the physics step."""
        joint, arm, error = self.joint, self.arm, self.parameter_error
        if joint is None:
            return
        if min(self.rotor) <= 0.0:
            raise ValueError(f"elastic joints need rotors: give joint.rotor_inertia or arm.rotor, got {self.rotor}")
        # The lightest links are the fastest. Lengths may act either way.
        m1, m2, L1, L2 = (1.0,) * 4 if error is None else error.ratios
        spread = 1.0 if error is None else 1.0 + error.radius
        rate = max(
            fastest_rate(
                dataclasses.replace(
                    arm, m1=arm.m1 * m1 / spread, m2=arm.m2 * m2 / spread, L1=arm.L1 * L1 * x1, L2=arm.L2 * L2 * x2
                ),
                self.rotor,
                joint,
                self.most_viscous,
            )
            for x1 in {1.0 / spread, spread}
            for x2 in {1.0 / spread, spread}
        )
        if self.physics_dt * rate > LARGEST_STEP:
            longest = self.control_dt / math.ceil(self.control_dt * rate / LARGEST_STEP)
            raise ValueError(
                f"physics_dt={self.physics_dt:g} s is too long for these joints, whose fastest rate is {rate:.4g} 1/s; "
                f"physics_dt={longest:.4g} s would do"
            )

    def _check_reference(self) -> None:
        """Refuse a reference beyond the limits, and moves and levels shorter than a step."""
        reference, limit = self.reference, self.limits.position
        low, high = reference.range
        if np.abs([low, high]).max() > 2 * limit:
            raise ValueError(
                f"reference must stay within the sensors' range, 2 limits.position = {2 * limit:g} rad, "
                f"got positions from {low} to {high} rad"
            )
        points = reference.position if isinstance(reference, ArrayReference) else getattr(reference, "points", None)
        if points is not None and np.abs(np.array(points) - points[0]).max() > limit:
            raise ValueError(
                f"reference must stay within limits.position={limit:g} rad of its start {points[0]}, "
                f"got positions from {low} to {high} rad"
            )
        if isinstance(reference, MinimumJerk):
            name, duration = "move_time + hold_time", reference.move_time + reference.hold_time
        elif isinstance(reference, Steps | FilteredSteps):
            name, duration = "period", reference.period
        else:
            return
        if duration < self.control_dt:
            raise ValueError(f"reference.{name} must be at least control_dt={self.control_dt:g} s, got {duration:g} s")

    def _check_disturbance(self) -> None:
        """Refuse times that are no multiples of a physics step."""
        disturbance = self.disturbance
        if isinstance(disturbance, SineDisturbance):
            fastest, limit = ends(disturbance.frequency)[1], 0.25 / self.physics_dt
            if fastest > limit * (1 + 1e-9):
                raise ValueError(
                    f"disturbance.frequency must be at most {limit:g} Hz, a quarter of 1 / physics_dt, got {fastest:g} Hz"
                )
        for name, least in (("period", 1), ("width", 1), ("start", 0), ("dt", 1)):
            if hasattr(disturbance, name):
                self._check_multiple(f"disturbance.{name}", getattr(disturbance, name), "physics_dt", least)

    def _check_multiple(self, name: str, duration: float, dt_name: str, least: int = 0) -> None:
        """Refuse a duration that is no multiple of a time step, or less than `least` steps."""
        dt = getattr(self, dt_name)
        if duration / dt > MAX_STEPS:
            raise ValueError(f"{name} must be at most {MAX_STEPS:.2g} times {dt_name}={dt:g} s, got {duration:g} s")
        steps = round(duration / dt)
        if not math.isclose(steps * dt, duration, rel_tol=1e-9, abs_tol=1e-12):
            raise ValueError(f"{name} must be a multiple of {dt_name}={dt:g} s, got {name}={duration:g} s")
        if steps < least:
            raise ValueError(f"{name} must be at least {dt_name}={dt:g} s, got {duration:g} s")

    @property
    def rotor(self) -> Pair:
        """Return the real rotor inertias, reflected to the joints [kg m^2]."""
        given = self.joint.rotor_inertia if self.joint is not None else None
        return self.arm.rotor if given is None else given  # type: ignore[return-value]

    @property
    def most_viscous(self) -> Pair:
        """Return the largest viscous friction of each joint, over draws and events [N m s/rad]."""
        viscous = [0.0, 0.0]
        for joint in range(2) if self.friction is not None else ():
            viscous[joint] = ends(self.friction.viscous[joint])[1]  # type: ignore[index, union-attr]
            for event in self.events:
                if isinstance(event, FrictionChange):
                    viscous[joint] *= max(1.0, ends(event.factor[joint])[1])  # type: ignore[index]
        return viscous[0], viscous[1]

    @property
    def substeps(self) -> int:
        """Return the number of physics steps in a control interval."""
        return round(self.control_dt / self.physics_dt)

    @property
    def steps(self) -> int:
        """Return the number of control intervals in an episode."""
        return round(self.duration / self.control_dt)

    def replace(self, **changes: Any) -> Scenario:
        """Return a scenario with some fields changed.

        Args:
            **changes: fields, as records or as plain data.
        """
        names = [field.name for field in dataclasses.fields(self)]
        for name in changes:
            if name not in names:
                raise unknown("option", name, names)
        return dataclasses.replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as plain data, which survives JSON. `from_dict` reads it."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Scenario:
        """Return the scenario that `to_dict` described.

        Args:
            data: its fields; missing ones take their defaults.
        """
        return build("scenario", data, Scenario)
