"""Classes of robots, which ask for different laws: `servo`, `direct` and `geared`.

A class has an arm of its size, its rate, drives, sensors and friction. Each episode draws their
numbers. A family pushes one of them further, at severities 1 to 3. The families take turns in three
variants of the arm, since a law that suits one arm may fail on the next. Beside the scenarios of
its board, a class has `practice` for tuning and training, with other variants and another motion,
and `surprise`, on which nothing is tuned or trained: the arm changes during the episode, bends, or
is another one.

The numbers of a class, and their sources, are in its TOML file beside `common.toml`. Torques are
multiples of the arm's own weight and inertia, so that `conditions` makes the same task of any arm.
"""

import copy
import dataclasses
import functools
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fbl_gym.model.arm import ArmParameters, stretched_inertia
from fbl_gym.options import (
    ArrayReference,
    DriveChange,
    FlexibleLink,
    FourierReference,
    FrictionChange,
    Knock,
    MinimumJerk,
    PickUp,
)
from fbl_gym.records.record import ends, merged
from fbl_gym.scenarios.families import Family, Tier
from fbl_gym.scenarios.scenario import Scenario, as_arm

_BOX = (-math.pi, -2.2), (0.0, 2.2)

LEAST = 9.8
"""Least ratio of an arm's scale of torque to its inertia [rad/s^2]."""


class RobotClass(NamedTuple):
    """A class of robots: its TOML file, merged with `common.toml`.

    Attributes:
        text: one line.
        arm: the nominal model.
        other_arm: that of the surprise `arm`.
        move_time: of the board's motion, moves over the whole workspace [s].
        encoder: side of the springs on which the encoders are.
        scenario: fields of `Scenario`.
        weight: fields of `Scenario` in multiples of the arm's weight, for each joint.
        families: the numbers of each family at severities 1 to 3.
        apart: families that are no part of `everything`.
        springs: arguments of `_Scale.springs`; empty: rigid joints.
        arms: further arms of the board, each with fields of `Scenario`.
    """

    text: str
    arm: ArmParameters
    other_arm: ArmParameters
    move_time: float
    encoder: str
    scenario: Mapping[str, Any]
    weight: Mapping[str, Any]
    families: Mapping[str, Mapping[str, Sequence[Any]]]
    apart: Sequence[str]
    springs: Mapping[str, Any] = {}
    arms: Mapping[str, Mapping[str, Any]] = {}

    @property
    def control_dt(self) -> float:
        """Return the time between two decisions [s]."""
        return self.scenario["control_dt"]

    @property
    def duration(self) -> float:
        """Return the length of an episode [s]."""
        return self.scenario["duration"]


def _load(robot: str) -> RobotClass:
    """Return the class of a TOML file."""
    files = (Path(__file__).with_name(f"{name}.toml") for name in ("common", robot))
    table = functools.reduce(merged, (tomllib.loads(file.read_text(encoding="utf-8")) for file in files))
    return RobotClass(**{**table, **{name: as_arm(name, table[name]) for name in ("arm", "other_arm")}})


CLASSES = {robot: _load(robot) for robot in ("servo", "direct", "geared")}
"""The classes of robots, by name."""


class _Scale:
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
            "stiffness": [_log((low * low, high * high), k) for k in stiffness],
            "damping": tuple(0.04 * np.sqrt(middle * self.inertia)),  # 2 % of the critical one
            "rotor_inertia": tuple(self.rotor),
            "backlash": 1e-3 * gap,
            "encoder": self.robot.encoder,
        }
        return {"joint": joint}

    def payload(self, share: float, **times: Any) -> dict[str, Any]:
        """Return a payload of a size, with up to a share of the second link's mass."""
        size = {"offset": 0.1 * self.arm.L2, "radius": 0.1 * self.arm.L2}
        return {"parameter_error": {"payload": {"mass": _uniform(0.0, share * self.arm.m2), **size, **times}}}


def _uniform(low: float, high: float) -> dict[str, Any]:
    return {"uniform": (low, high)}


def _log(ends: tuple[float, float], scale: float = 1.0) -> dict[str, Any]:
    return {"log_uniform": (scale * ends[0], scale * ends[1])}


def _times(value: Any, factor: Any) -> Any:
    """Return plain data whose numbers are multiplied; two factors are for two joints."""
    if isinstance(value, dict):
        return {name: _times(each, factor) for name, each in value.items()}
    if isinstance(value, list):
        return tuple(_times(each, x) for each, x in zip(value, np.broadcast_to(factor, len(value)), strict=True))
    return value * factor


def _bodies(scale: _Scale, r: float) -> dict[str, Any]:
    r = scale.size * r
    return {
        "parameter_error": {"radius": r, "centre": _uniform(1 - r / 2, 1 + r / 2), "inertia": _uniform(1 - r, 1 + r)}
    }


def _payload(scale: _Scale, share: float) -> dict[str, Any]:
    duration = scale.robot.duration
    times = {"pick_up": _uniform(duration * 0.1, duration * 0.3), "drop": _uniform(duration * 0.6, duration * 0.8)}
    return scale.payload(scale.size * share, **times)


def _delay(scale: _Scale, more: float) -> dict[str, Any]:
    low, high = scale.robot.scenario["actuator"]["delay"]["uniform"]
    return {"actuator": {"delay": _uniform(low, high + scale.size * 1e-3 * more)}}


def _noise(scale: _Scale, sigma: float, counts: float) -> dict[str, Any]:
    return {"noise": {"position": scale.size * 1e-3 * sigma}, "encoder": {"counts": counts}}


def _disturbance(scale: _Scale, percent: float) -> dict[str, Any]:
    amplitude = tuple(scale.size * 0.01 * percent * scale.weight)
    return {"disturbance": {"kind": "piecewise-constant", "amplitude": amplitude}}


def _saturation(scale: _Scale, acceleration: float) -> dict[str, Any]:
    moves = MinimumJerk(*_BOX, move_time=0.6 * scale.robot.move_time, hold_time=0.6)
    return {"reference": moves, "actuator": {"torque_limit": tuple(1.6 * scale.weight + acceleration * scale.reach)}}


def _torque_constant(scale: _Scale, percent: float) -> dict[str, Any]:
    off = scale.size * 0.01 * percent
    return {"actuator": {"gain": _uniform(1 - off, 1 + off)}}


def _datasheet(scale: _Scale, samples: float, factor: float, percent: float) -> dict[str, Any]:
    """Return a truth on both sides beyond its ranges, of which policies are told the middle."""
    size, task, h = scale.size, scale.task, scale.robot.control_dt
    factor, off = 1 + size * (factor - 1), 1 + size * 0.01 * percent
    low, high = task["actuator"]["delay"]["uniform"]
    early, late = max(low - size * samples * h, 0.0), high + (2 if low == 0 else 1) * size * samples * h
    usual = h + task["actuator"].get("jitter", 0.0) / 2  # a sample of computation, and the mean of the jitter
    told: dict[str, Any] = {"delay": (early + late) / 2 + usual, "lag": _middle(task["actuator"]["lag"])}
    drive = {"delay": {"choice": (early, late)}, "lag": _beyond(task["actuator"]["lag"], factor)}
    drive["gain"] = _beyond(task["actuator"]["gain"], off)
    changes: dict[str, Any] = {
        "actuator": drive,
        "parameter_error": {"rotor": _beyond(task["parameter_error"]["rotor"], off)},
    }
    if scale.robot.springs:
        stiffness, damping = task["joint"]["stiffness"], task["joint"]["damping"]
        told |= {"stiffness": tuple(map(_middle, stiffness)), "damping": damping}
        changes["joint"] = {
            "stiffness": [_beyond(k, factor) for k in stiffness],
            "damping": [_beyond({"uniform": (c, c)}, factor**2) for c in damping],
        }
    return {"datasheet": told, **changes}


def _ends(distribution: Mapping[str, Sequence[float]]) -> Sequence[float]:
    """Return the ends of a range."""
    return next(iter(distribution.values()))


def _middle(distribution: Mapping[str, Sequence[float]]) -> float:
    return math.sqrt(math.prod(_ends(distribution)))


def _beyond(distribution: Mapping[str, Sequence[float]], factor: float) -> dict[str, Any]:
    low, high = _ends(distribution)
    return {"choice": (low / factor, high * factor)}


_FAMILIES = {
    "model-error": Family("masses off by factors of up to 1 + r, inertias by r, centres by r / 2; r = {r}", _bodies),
    "payload": Family("up to {share} times the second link's mass, picked up and dropped during the motion", _payload),
    "delay": Family("a further delay of up to {more} ms", _delay),
    "lag": Family(
        "a lag of the drives of {ends} ms", lambda scale, ends: {"actuator": {"lag": _log(ends, scale.size * 1e-3)}}
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
    scale = _Scale(kind, arm, 0.5 if family == "everything" else 1.0)
    pushed = [name for name in known if name not in kind.apart] if family == "everything" else [family]
    usual = {
        "arm": arm,
        "reference": MinimumJerk(*_BOX, move_time=kind.move_time, hold_time=0.3),
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


class _Variant(NamedTuple):
    """A variant of an arm: multiples of mass and length of its second link, and of both rotors."""

    mass: float = 1.0
    length: float = 1.0
    rotors: float = 1.0

    def of(self, arm: ArmParameters) -> ArmParameters:
        """Return the variant of an arm."""
        first, second = arm.rotor  # type: ignore[misc]
        rotor = (self.rotors * first, self.rotors * self.mass * self.length**2 * second)  # a drive suits its link
        return dataclasses.replace(arm, m2=self.mass * arm.m2, L2=self.length * arm.L2, rotor=rotor)


_BOARD_ARMS = _Variant(), _Variant(0.4, 1.3), _Variant(2.5, 1.1, 0.3)
_PRACTICE_ARMS = _Variant(), _Variant(0.4, 0.7), _Variant(3.0, 1.3, 0.0)


def _turn(
    robot: str, family: str, severity: int, arm: ArmParameters | None, variants: Sequence[_Variant]
) -> dict[str, Any]:
    """Return a scenario of the board or of practice: families take turns in the variants."""
    known = {"nominal": "nothing is pushed further", **families(robot)}
    # Severities 1 and 3 of practice differ in their arms; those of the board have the same one.
    turn = [*known].index(family) + (severity // 2 if variants is _PRACTICE_ARMS else 0)
    variant = variants[turn % len(variants)]
    text = f"{robot}: {known[family]}"
    if arm is None and variant != _Variant():
        text += "; second link of {:g} times the mass and {:g} times the length, {:g} times the rotors".format(*variant)
    task = conditions(arm or variant.of(CLASSES[robot].arm), robot, family, severity)
    return {"description": text, **task}


def _board(robot: str, family: str, severity: int, arm: ArmParameters | None) -> dict[str, Any]:
    if family not in CLASSES[robot].arms:
        return _turn(robot, family, severity, arm, _BOARD_ARMS)
    real = CLASSES[robot].arms[family]
    task = merged(conditions(as_arm("arm", real["arm"]), robot), real) if arm is None else conditions(arm, robot)
    return task | {"description": f"{robot}: {real['description']}"}


def _practice(robot: str, family: str, severity: int, arm: ArmParameters | None) -> dict[str, Any]:
    """Return a scenario for tuning and training: with other arms and motions than on the board."""
    task = _turn(robot, family, severity, arm, _PRACTICE_ARMS)
    speed = 1.5 if family == "saturation" else 1.0
    frequency = speed * 0.24 / CLASSES[robot].move_time
    motion = FourierReference(amplitude=(1.5, 2.0), frequency=frequency, harmonics=4)
    return task | {"reference": motion, "duration": 4.8}


SURPRISES = {
    "payload": "half of the second link's mass is picked up without notice",
    "knock": "a blow, by which a stretched arm would gain 2 rad/s",
    "friction": "friction becomes three times as large",
    "drive": "the first drive loses 25 % of its torque",
    "bend": "links bend, with natural frequencies of 12 to 25 Hz that no encoder sees",
    "arm": "another arm, with the drives and sensors of the class",
    "datasheet": "the springs, or in their absence the drives' lags, have half or twice the number of the data sheet",
}


def _surprise(robot: str, family: str, _: int, arm: ArmParameters | None) -> dict[str, Any]:
    kind = CLASSES[robot]
    arm = arm or (kind.other_arm if family == "arm" else kind.arm)
    p2, p3 = arm.lumped[1:3]
    time, task = _uniform(0.3 * kind.duration, 0.5 * kind.duration), conditions(arm, robot)
    option, field = ("joint", "stiffness") if kind.springs else ("actuator", "lag")
    ranges = task[option][field]
    told = tuple(map(_middle, ranges)) if kind.springs else _middle(ranges)
    truth = [{"choice": (k / 2, 2 * k)} for k in np.ravel(told)]
    changes: dict[str, Any] = {
        "payload": {"events": (PickUp(time=time, mass=0.5 * arm.m2),)},
        "knock": {"events": (Knock(time=time, impulse=(2.0 * stretched_inertia(arm)[0], 2.0 * (p2 + p3))),)},
        "friction": {"events": (FrictionChange(time=time, factor=3.0),)},
        "drive": {"events": (DriveChange(time=time, factor=(0.75, 1.0)),)},
        "bend": {"link": FlexibleLink((_log((12.0, 25.0)),) * 2, damping=0.05)},
        "arm": {},
        "datasheet": {option: {field: truth if kind.springs else truth[0]}, "datasheet": {field: told}},
    }
    return merged({"description": f"{robot}: {SURPRISES[family]}", **task}, changes[family])


def _tiers() -> dict[str, Tier]:
    """Return the tiers of all classes: boards, surprises and practices."""
    boards, surprises, practices = {}, {}, {}
    for robot, kind in CLASSES.items():
        graded, partial = families(robot), functools.partial
        boards[robot] = Tier(kind.text, ("nominal", *kind.arms), graded, (1, 2, 3), partial(_board, robot))
        text = f"{robot}: the arm changes during the episode, or is another one"
        surprises[f"{robot}-surprise"] = Tier(text, SURPRISES, {}, (), partial(_surprise, robot))
        text = f"{robot}: for tuning and training, with another motion"
        practices[f"{robot}-practice"] = Tier(text, ("nominal",), graded, (1, 3), partial(_practice, robot))
    return boards | surprises | practices


TIERS = _tiers()
"""The tiers of the classes, by name."""


def _with_rotors(kind: RobotClass, arm: ArmParameters) -> tuple[ArmParameters, ArmParameters]:
    """Return an arm, and the same with the rotors that it has behind springs."""
    return arm, dataclasses.replace(arm, rotor=tuple(_Scale(kind, arm).rotor))


_OWN_ARMS = {
    *(kind.other_arm for kind in CLASSES.values()), *(as_arm(name, name) for kind in CLASSES.values() for name in kind.arms),
    *(
        arm for kind in CLASSES.values() for variant in {*_BOARD_ARMS, *_PRACTICE_ARMS}
        for arm in _with_rotors(kind, variant.of(kind.arm))
    ),
}  # fmt: skip
"""The arms on which tuning and training may have no events, links that bend or other plant."""


def held_out_reason(scenario: Scenario) -> str:
    """Return the reason why tuning and training may not use a scenario; empty if they may.

    A board is judged on kinds of motion, events, arms and engines that no law has been tuned for. A
    scenario is recognised by its content, whatever its name. Behind a drive with a delay or a lag,
    an arm of a class may have no minimum-jerk moves, which are the boards' motion, and no "array",
    which is the sealed test's, whatever their numbers.
    """
    reference, drive = scenario.reference, scenario.actuator
    if isinstance(reference, MinimumJerk) and reference.points is None and (reference.low, reference.high) == _BOX:
        return f"its motion is the board's: minimum-jerk moves between {reference.low} and {reference.high} rad"
    if scenario.arm not in _OWN_ARMS:
        return ""
    if isinstance(reference, MinimumJerk | ArrayReference) and any(
        ends(late)[1] > 0 for late in (drive.delay, drive.delay_samples, drive.lag)
    ):
        return f'its motion is of a kind that judges the robots of a class: "{reference.kind}"'
    if scenario.events:
        return "it has events, as the tiers of surprise"
    if scenario.link is not None:
        return "its links bend, as in the tiers of surprise"
    if scenario.plant is not None:
        return f"its plant is {scenario.plant.kind}, on which the board's order is checked"
    return ""
