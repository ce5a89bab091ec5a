"""Families of the classes of robots: each pushes one property of a class further.

A family has severities 1 to 3, whose numbers are in the TOML file of the class.
"""

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fbl_gym.model.arm import ArmParameters, stretched_inertia
from fbl_gym.options import MinimumJerk
from fbl_gym.records.record import merged
from fbl_gym.scenarios.classes import CLASSES, RobotClass
from fbl_gym.scenarios.families import Family

BOX = (-math.pi, -2.2), (0.0, 2.2)
"""The box of the boards' motion [rad]."""

LEAST = 9.8
"""Least ratio of an arm's scale of torque to its inertia [rad/s^2]."""


class Scale:
    """The scales of an arm in a class, and the share of a family's size.

    Attributes:
        task: fields of `Scenario` so far, which families before the last have changed.
        weight: largest torque of gravity on each joint [2] N m, or that of an acceleration of
            `LEAST` of the stretched links and rotors, where it is larger.
        inertia: of the stretched links about each joint [2] kg m^2.
        reach: inertia that a motion of both joints meets, with the rotors [2] kg m^2.
    """

    def __init__(self, robot: RobotClass, arm: ArmParameters, size: float = 1.0) -> None:
        _, p2, p3, p4, p5 = arm.lumped
        self.robot, self.arm, self.size, self.task = robot, arm, size, copy.deepcopy({**robot.scenario})
        self.inertia = stretched_inertia(arm)
        rotor = np.array(arm.rotor)
        self.rotor = np.where(rotor > 0, rotor, 0.3 * self.inertia)
        self.weight = np.maximum([abs(p4) + abs(p5), abs(p5)], LEAST * (self.inertia + rotor))
        self.reach = np.array([self.inertia[0], p2 + p3]) + rotor

    def springs(self, rates: tuple[float, float], gap: float = 0.0) -> dict[str, Any]:
        """Return joints of which each alone vibrates between two rates [Hz], with its motor held.

        Both together have a slower mode. A gap is in mrad.
        """
        low, high = rates
        stiffness = self.inertia * (2 * math.pi) ** 2
        middle = stiffness * low * high
        joint = {
            "stiffness": [log_uniform((low * low, high * high), k) for k in stiffness],
            "damping": tuple(0.04 * np.sqrt(middle * self.inertia)),  # 2 % of the critical one
            "rotor_inertia": tuple(self.rotor),
            "backlash": 1e-3 * gap,
            "encoder": self.robot.encoder,
        }
        return {"joint": joint}

    def payload(self, share: float, **times: Any) -> dict[str, Any]:
        """Return a payload of a size, with up to a share of the second link's mass."""
        size = {"offset": 0.1 * self.arm.L2, "radius": 0.1 * self.arm.L2}
        return {"parameter_error": {"payload": {"mass": uniform(0.0, share * self.arm.m2), **size, **times}}}


def uniform(low: float, high: float) -> dict[str, Any]:
    """Return a uniform distribution as plain data."""
    return {"uniform": (low, high)}


def log_uniform(ends: tuple[float, float], scale: float = 1.0) -> dict[str, Any]:
    """Return a log-uniform distribution as plain data, its ends times a scale."""
    return {"log_uniform": (scale * ends[0], scale * ends[1])}


def _times(value: Any, factor: Any) -> Any:
    """Return plain data whose numbers are multiplied; two factors are for two joints."""
    if isinstance(value, dict):
        return {name: _times(each, factor) for name, each in value.items()}
    if isinstance(value, list):
        return tuple(_times(each, x) for each, x in zip(value, np.broadcast_to(factor, len(value)), strict=True))
    return value * factor


def _bodies(scale: Scale, r: float) -> dict[str, Any]:
    r = scale.size * r
    return {"parameter_error": {"radius": r, "centre": uniform(1 - r / 2, 1 + r / 2), "inertia": uniform(1 - r, 1 + r)}}


def _payload(scale: Scale, share: float) -> dict[str, Any]:
    duration = scale.robot.duration
    times = {"pick_up": uniform(duration * 0.1, duration * 0.3), "drop": uniform(duration * 0.6, duration * 0.8)}
    return scale.payload(scale.size * share, **times)


def _delay(scale: Scale, more: float) -> dict[str, Any]:
    low, high = scale.robot.scenario["actuator"]["delay"]["uniform"]
    return {"actuator": {"delay": uniform(low, high + scale.size * 1e-3 * more)}}


def _noise(scale: Scale, sigma: float, counts: float) -> dict[str, Any]:
    return {"noise": {"position": scale.size * 1e-3 * sigma}, "encoder": {"counts": counts}}


def _disturbance(scale: Scale, percent: float) -> dict[str, Any]:
    amplitude = tuple(scale.size * 0.01 * percent * scale.weight)
    return {"disturbance": {"kind": "piecewise-constant", "amplitude": amplitude}}


def _saturation(scale: Scale, acceleration: float) -> dict[str, Any]:
    moves = MinimumJerk(*BOX, move_time=0.6 * scale.robot.move_time, hold_time=0.6)
    return {"reference": moves, "actuator": {"torque_limit": tuple(1.6 * scale.weight + acceleration * scale.reach)}}


def _torque_constant(scale: Scale, percent: float) -> dict[str, Any]:
    off = scale.size * 0.01 * percent
    return {"actuator": {"gain": uniform(1 - off, 1 + off)}}


def _datasheet(scale: Scale, samples: float, factor: float, percent: float) -> dict[str, Any]:
    """Return a truth on both sides beyond its ranges, of which policies are told the middle."""
    size, task, h = scale.size, scale.task, scale.robot.control_dt
    factor, off = 1 + size * (factor - 1), 1 + size * 0.01 * percent
    low, high = task["actuator"]["delay"]["uniform"]
    early, late = max(low - size * samples * h, 0.0), high + (2 if low == 0 else 1) * size * samples * h
    usual = h + task["actuator"].get("jitter", 0.0) / 2  # a sample of computation, and the mean of the jitter
    told: dict[str, Any] = {"delay": (early + late) / 2 + usual, "lag": middle_of(task["actuator"]["lag"])}
    drive = {"delay": {"choice": (early, late)}, "lag": _beyond(task["actuator"]["lag"], factor)}
    drive["gain"] = _beyond(task["actuator"]["gain"], off)
    changes: dict[str, Any] = {
        "actuator": drive,
        "parameter_error": {"rotor": _beyond(task["parameter_error"]["rotor"], off)},
    }
    if scale.robot.springs:
        stiffness, damping = task["joint"]["stiffness"], task["joint"]["damping"]
        told |= {"stiffness": tuple(map(middle_of, stiffness)), "damping": damping}
        changes["joint"] = {
            "stiffness": [_beyond(k, factor) for k in stiffness],
            "damping": [_beyond({"uniform": (c, c)}, factor**2) for c in damping],
        }
    return {"datasheet": told, **changes}


def _ends(distribution: Mapping[str, Sequence[float]]) -> Sequence[float]:
    """Return the ends of a range."""
    return next(iter(distribution.values()))


def middle_of(distribution: Mapping[str, Sequence[float]]) -> float:
    """Return the geometric mean of the ends of a range."""
    return math.sqrt(math.prod(_ends(distribution)))


def _beyond(distribution: Mapping[str, Sequence[float]], factor: float) -> dict[str, Any]:
    low, high = _ends(distribution)
    return {"choice": (low / factor, high * factor)}


_FAMILIES = {
    "model-error": Family("masses off by factors of up to 1 + r, inertias by r, centres by r / 2; r = {r}", _bodies),
    "payload": Family("up to {share} times the second link's mass, picked up and dropped during the motion", _payload),
    "delay": Family("a further delay of up to {more} ms", _delay),
    "lag": Family(
        "a lag of the drives of {ends} ms",
        lambda scale, ends: {"actuator": {"lag": log_uniform(ends, scale.size * 1e-3)}},
    ),
    "jitter": Family(
        "each command late by up to {late} ms", lambda scale, late: {"actuator": {"jitter": scale.size * 1e-3 * late}}
    ),
    "lost-readings": Family(
        "1 % of the samples begin a gap of {length} readings",
        lambda scale, length: {"encoder": {"dropout": 0.01, "dropout_length": math.ceil(scale.size * length)}},
    ),
    "noise": Family("position noise of {sigma} mrad, and encoders of {counts} counts", _noise),
    "friction": Family(
        "{factor} times the friction",
        lambda scale, factor: {"friction": _times(scale.robot.weight["friction"], scale.size * factor * scale.weight)},
    ),
    "disturbance": Family("a torque within {percent} % of the arm's weight, a new level every 0.5 s", _disturbance),
    "elastic": Family(
        "springs in the joints, each alone with a natural frequency of {rates} Hz",
        lambda scale, rates: scale.springs([rate / scale.size for rate in rates]),
    ),
    "backlash": Family(
        "a gap of {gap} mrad in joints with springs of {rates} Hz",
        lambda scale, gap, rates: scale.springs(rates, gap),
    ),
    "ripple": Family(
        "torque ripple of {percent} % of the weight",
        lambda scale, percent: {"actuator": {"ripple": tuple(scale.size * 0.01 * percent * scale.weight)}},
    ),
    "saturation": Family("faster moves, with torque for the weight and {acceleration} rad/s^2", _saturation),
    "torque-constant": Family("torques off by up to {percent} %", _torque_constant),
    "datasheet": Family(  # the last one, since it goes beyond the ranges of the others
        "a wrong data sheet: delay by {samples} samples, lag and stiffness by factors of {factor} beyond their ranges, "
        "damping by their squares, gains and rotors by {percent} %",
        _datasheet,
    ),
}
"""The families that a class may have; its TOML file has their numbers."""


def _families(robot: str) -> dict[str, Family]:
    numbers = CLASSES[robot].families
    return {name: family._replace(numbers=numbers[name]) for name, family in _FAMILIES.items() if name in numbers}


def families(robot: str) -> dict[str, str]:
    """Return the description of each family of one of `CLASSES`, by name."""
    known = {name: family.description for name, family in _families(robot).items()}
    last = {"datasheet": known.pop("datasheet")}  # a later family must not change the turns of others
    apart = " and ".join(CLASSES[robot].apart)
    return known | {"everything": f"all but {apart} at once, at half their size"} | last


def conditions(arm: ArmParameters, robot: str, family: str = "nominal", severity: int = 0) -> dict[str, Any]:
    """Return the options of a class's scenario for any arm, as fields of `Scenario`.

    Args:
        arm: the nominal model. Where joints have springs and it has no rotors, it gets rotors of
            0.3 times the inertia of the stretched links.
        robot: one of `CLASSES`.
        family: one of `families(robot)`, or "nominal": nothing is pushed further.
        severity: 0 to 3.
    """
    kind, known = CLASSES[robot], _families(robot)
    scale = Scale(kind, arm, 0.5 if family == "everything" else 1.0)
    pushed = [name for name in known if name not in kind.apart] if family == "everything" else [family]
    usual = {
        "arm": arm,
        "reference": MinimumJerk(*BOX, move_time=kind.move_time, hold_time=0.3),
        "actuator": {"torque_limit": tuple(1.5 * scale.weight + 16.0 * scale.reach)},
    }
    springs = scale.springs(**kind.springs) if kind.springs else {}
    for change in (usual, scale.payload(0.1), _times(kind.weight, scale.weight), springs):
        scale.task = merged(scale.task, change)
    for name in pushed if severity > 0 else ():
        scale.task = merged(scale.task, known[name].at(severity, scale)) if name in known else scale.task
    task = scale.task
    if "joint" in task and np.min(arm.rotor) <= 0:
        return conditions(dataclasses.replace(arm, rotor=tuple(scale.rotor)), robot, family, severity)
    return task
