"""The scenario: a nominal arm, its uncertainties, a reference and the rates."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fbl_gym.arm import ARMS, TABLE_1, ArmParameters
from fbl_gym.checks import Pair, check_choice, unknown
from fbl_gym.interface import Limits
from fbl_gym.plants import PLANTS, MuJoCo
from fbl_gym.records import Record, build, choices, declared, number, one_of, pair, record
from fbl_gym.references import REFERENCES, FilteredSteps, MinimumJerk, Reference, Steps
from fbl_gym.uncertainty import (
    DISTURBANCES,
    SENSORS,
    Actuator,
    ArrayDisturbance,
    Disturbance,
    Friction,
    Noise,
    ParameterError,
    PiecewiseConstantDisturbance,
    PulseDisturbance,
)


def _arm(name: str, value: Any) -> ArmParameters:
    if isinstance(value, str):
        value = ARMS[check_choice(name, value, ARMS)]
    return build(name, value, ArmParameters)


def _actuator(name: str, value: Any) -> Actuator:
    if value is None:
        return Actuator(torque_limit=None)
    return build(name, value, Actuator, scalar="torque_limit")


@dataclass(frozen=True)
class Scenario(Record):
    """One task. Each field takes its record or the plain data that makes one.

    None switches off parameter_error, noise, friction, disturbance and the limits of the actuator.

    Args:
        name: for people.
        description: for people.
        arm: the nominal model.
        parameter_error: real parameters that differ from the nominal ones; a number is a fixed
            ratio real / nominal.
        noise: errors of the sensors.
        friction: joint friction; the nominal model has none.
        disturbance: torque tau_d of equation (1).
        actuator: torque limits, delay and lag; None: an ideal drive without limits.
        sensors: the measured signals; they include "position".
        reference: motion that the arm follows.
        control_dt: time between two decisions; the torque command is held in between.
        physics_dt: integration step; divides control_dt.
        duration: length of an episode, a multiple of control_dt.
        initial_error: difference between the arm's first position and the reference's.
        limits: bounds beyond which the arm has diverged, and ranges of the observation.
        plant: engine that moves the real arm; None: the package's own.
    """

    name: str = "nominal"
    description: str = "the nominal arm: nothing varies but the way-points"
    arm: ArmParameters = declared(
        TABLE_1,
        _arm,
        "an ArmParameters, a dict of its fields, " + " or ".join(f'"{name}"' for name in ARMS),
        classes=(ArmParameters,),
    )
    parameter_error: ParameterError | None = record(ParameterError, None, scalar="ratio")
    noise: Noise | None = record(Noise, None)
    friction: Friction | None = record(Friction, None)
    disturbance: Disturbance | None = one_of(DISTURBANCES, None)
    actuator: Actuator = declared(
        Actuator(), _actuator, "an Actuator, a dict of its fields, its torque_limit or None", classes=(Actuator,)
    )
    sensors: tuple[str, ...] = choices(SENSORS, SENSORS)
    reference: Reference = one_of(REFERENCES, MinimumJerk())
    control_dt: float = number(0.01, unit="s", above=0)
    physics_dt: float = number(0.001, unit="s", above=0)
    duration: float = number(10.0, unit="s", above=0)
    initial_error: Pair | float = pair(0.0, unit="rad")
    limits: Limits = record(Limits, Limits())
    plant: MuJoCo | None = one_of(PLANTS, None)

    def validate(self) -> None:
        """Refuse noise on a sensor that is left out, and times that do not divide each other."""
        if "position" not in self.sensors:
            raise ValueError(f"sensors must include 'position', got {self.sensors}")
        for sensor in SENSORS:
            if getattr(self.noise, sensor, None) is not None and sensor not in self.sensors:
                raise ValueError(f"noise.{sensor} is given, but sensors={self.sensors} has no {sensor} sensor")
        if self.physics_dt > self.control_dt:
            raise ValueError(
                "physics_dt must divide control_dt, "
                f"got physics_dt={self.physics_dt:g} s and control_dt={self.control_dt:g} s"
            )
        self._check_multiple("control_dt", self.control_dt, "physics_dt")
        self._check_multiple("duration", self.duration, "control_dt", least=1)
        self._check_multiple("actuator.delay", self.actuator.delay, "physics_dt")
        self._check_reference()
        self._check_disturbance()

    def _check_reference(self) -> None:
        """Refuse moves and levels that are shorter than a step."""
        reference = self.reference
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
        names: tuple[str, ...] = ()
        if isinstance(disturbance, PiecewiseConstantDisturbance):
            names = ("period",)
        elif isinstance(disturbance, PulseDisturbance):
            names = ("period", "width", "start")
        elif isinstance(disturbance, ArrayDisturbance):
            names = ("dt",)
        for name in names:
            least = 0 if name == "start" else 1
            self._check_multiple(f"disturbance.{name}", getattr(disturbance, name), "physics_dt", least)

    def _check_multiple(self, name: str, duration: float, dt_name: str, least: int = 0) -> None:
        """Refuse a duration that is no multiple of a time step, or less than `least` steps."""
        dt = getattr(self, dt_name)
        steps = round(duration / dt)
        if not math.isclose(steps * dt, duration, rel_tol=1e-9, abs_tol=1e-12):
            raise ValueError(f"{name} must be a multiple of {dt_name}={dt:g} s, got {name}={duration:g} s")
        if steps < least:
            raise ValueError(f"{name} must be at least {dt_name}={dt:g} s, got {duration:g} s")

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
