"""Families of the classes of robots: each pushes one property of a class further.

A family has severities 1 to 3. Its numbers are in the TOML file of the class, its text in
`common.toml`.
"""

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fbl_gym.model.arm import ArmParameters, stretched_inertia
from fbl_gym.options import MinimumJerk
from fbl_gym.records.checks import check_choice
from fbl_gym.records.record import either, merged
from fbl_gym.scenarios.classes import CLASSES, RobotClass

#: The box of the boards' motion [rad].
BOX = (-math.pi, -2.2), (0.0, 2.2)

#: Least ratio of an arm's scale of torque to its inertia [rad/s^2].
LEAST = 9.8


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


def _around_one(off: float) -> dict[str, Any]:
    return uniform(1 - off, 1 + off)


def _times(value: Any, factor: Any) -> Any:
    """Return plain data whose numbers are multiplied; two factors are for two joints."""
    if isinstance(value, dict):
        return {name: _times(each, factor) for name, each in value.items()}
    if isinstance(value, list):
        return tuple(_times(each, x) for each, x in zip(value, np.broadcast_to(factor, len(value)), strict=True))
    return value * factor


def middle_of(distribution: Mapping[str, Sequence[float]]) -> float:
    """Return the geometric mean of the ends of a range."""
    return math.sqrt(math.prod(*distribution.values()))


def _beyond(distribution: Mapping[str, Sequence[float]], factor: float) -> dict[str, Any]:
    ((low, high),) = distribution.values()
    return {"choice": (low / factor, high * factor)}


def _bodies(scale: Scale, r: float) -> dict[str, Any]:
    r = scale.size * r
    return {"parameter_error": {"radius": r, "centre": _around_one(r / 2), "inertia": _around_one(r)}}


def _payload(scale: Scale, share: float) -> dict[str, Any]:
    duration = scale.task["duration"]
    times = {"pick_up": uniform(duration * 0.1, duration * 0.3), "drop": uniform(duration * 0.6, duration * 0.8)}
    return scale.payload(scale.size * share, **times)


def _delay(scale: Scale, more: float) -> dict[str, Any]:
    low, high = scale.task["actuator"]["delay"]["uniform"]
    return {"actuator": {"delay": uniform(low, high + scale.size * 1e-3 * more)}}


def _saturation(scale: Scale, acceleration: float) -> dict[str, Any]:
    moves = MinimumJerk(*BOX, move_time=0.6 * scale.robot.move_time, hold_time=0.6)
    return {"reference": moves, "actuator": {"torque_limit": tuple(1.6 * scale.weight + acceleration * scale.reach)}}


def _datasheet(scale: Scale, samples: float, factor: float, percent: float) -> dict[str, Any]:
    """Return a truth on both sides beyond its ranges, of which policies are told the middle."""
    drive, h = scale.task["actuator"], scale.task["control_dt"]
    factor, off, more = 1 + scale.size * (factor - 1), 1 + scale.size * 0.01 * percent, scale.size * samples * h
    low, high = drive["delay"]["uniform"]
    early, late = max(low - more, 0.0), high + (2 if low == 0 else 1) * more
    usual = h + drive.get("jitter", 0.0) / 2  # a sample of computation, and the mean of the jitter
    told: dict[str, Any] = {"delay": (early + late) / 2 + usual, "lag": middle_of(drive["lag"])}
    changes: dict[str, Any] = {
        "actuator": {
            "delay": {"choice": (early, late)},
            "lag": _beyond(drive["lag"], factor),
            "gain": _beyond(drive["gain"], off),
        },
        "parameter_error": {"rotor": _beyond(scale.task["parameter_error"]["rotor"], off)},
        "datasheet": told,
    }
    if scale.robot.springs:
        stiffness, damping = scale.task["joint"]["stiffness"], scale.task["joint"]["damping"]
        told |= {"stiffness": tuple(map(middle_of, stiffness)), "damping": damping}
        changes["joint"] = {
            "stiffness": [_beyond(k, factor) for k in stiffness],
            "damping": [_beyond({"uniform": (c, c)}, factor**2) for c in damping],
        }
    return changes


#: Functions that return fields of `Scenario`, from the scales of an arm and a family's numbers.
_FAMILIES: dict[str, Callable[..., dict[str, Any]]] = {
    "model-error": _bodies,
    "payload": _payload,
    "delay": _delay,
    "lag": lambda scale, ends: {"actuator": {"lag": log_uniform(ends, scale.size * 1e-3)}},
    "jitter": lambda scale, late: {"actuator": {"jitter": scale.size * 1e-3 * late}},
    "lost-readings": lambda scale, length: {
        "encoder": {"dropout": 0.01, "dropout_length": math.ceil(scale.size * length)}
    },
    "noise": lambda scale, sigma, counts: {
        "noise": {"position": scale.size * 1e-3 * sigma}, "encoder": {"counts": counts}
    },
    "friction": lambda scale, factor: {
        "friction": _times(scale.robot.weight["friction"], scale.size * factor * scale.weight)
    },
    "disturbance": lambda scale, percent: {
        "disturbance": {"kind": "piecewise-constant", "amplitude": tuple(scale.size * 0.01 * percent * scale.weight)}
    },
    "elastic": lambda scale, rates: scale.springs([rate / scale.size for rate in rates]),
    "backlash": lambda scale, gap, rates: scale.springs(rates, gap),
    "ripple": lambda scale, percent: {"actuator": {"ripple": tuple(scale.size * 0.01 * percent * scale.weight)}},
    "saturation": _saturation,
    "torque-constant": lambda scale, percent: {"actuator": {"gain": _around_one(scale.size * 0.01 * percent)}},
    "datasheet": _datasheet,  # the last one, since it goes beyond the ranges of the others
}  # fmt: skip


def _text(value: Any) -> str:
    return "-".join(f"{x:.3g}" if x < 1000 else f"{x:g}" for x in (value if isinstance(value, list) else [value]))


def families(robot: str) -> dict[str, str]:
    """Return the description of each family of one of `CLASSES`, by name."""
    kind = CLASSES[robot]
    numbers = {
        family: {name: either([*map(_text, values)]) for name, values in each.items()}
        for family, each in kind.families.items()
    }
    numbers["everything"] = {"apart": " and ".join(kind.apart)}
    # The order gives each family its turn among arms and motions; a new one goes to the end.
    order = sorted(numbers, key=[*kind.texts].index)
    return {family: kind.texts[family].format(**numbers[family]) for family in order}


def conditions(arm: ArmParameters, robot: str, family: str = "nominal", severity: int = 0) -> dict[str, Any]:
    """Return the options of a class's scenario for any arm, as fields of `Scenario`.

    Args:
        arm: the nominal model. Where joints have springs and it has no rotors, it gets rotors of
            0.3 times the inertia of the stretched links.
        robot: one of `CLASSES`.
        family: one of `families(robot)`, or "nominal": nothing is pushed further.
        severity: 0 to 3.
    """
    kind = CLASSES[robot]
    check_choice("family", family, ("nominal", *families(robot)))
    scale = Scale(kind, arm, 0.5 if family == "everything" else 1.0)
    usual = {
        "arm": arm,
        "reference": MinimumJerk(*BOX, move_time=kind.move_time, hold_time=0.3),
        "actuator": {"torque_limit": tuple(1.5 * scale.weight + 16.0 * scale.reach)},
    }
    springs = scale.springs(**kind.springs) if kind.springs else {}
    for change in (usual, scale.payload(0.1), _times(kind.weight, scale.weight), springs):
        scale.task = merged(scale.task, change)
    for name, push in _FAMILIES.items() if severity > 0 else ():
        if name == family or (family == "everything" and name in kind.families and name not in kind.apart):
            numbers = {key: values[severity - 1] for key, values in kind.families[name].items()}
            scale.task = merged(scale.task, push(scale, **numbers))
    if "joint" in scale.task and np.min(arm.rotor) <= 0:
        return conditions(dataclasses.replace(arm, rotor=tuple(scale.rotor)), robot, family, severity)
    return scale.task
