"""Classes of robots, which ask for different laws: `servo`, `direct` and `geared`.

A class has an arm of its size, its rate, drives, sensors and friction. Each episode draws their
numbers. A family pushes one of them further, at severities 1 to 3. The families take turns in three
variants of the arm, since a law that suits one arm may fail on the next. Beside the scenarios of
its board, a class has `practice` for tuning and training, with other variants and another motion,
and `surprise`, on which nothing is tuned or trained: the arm changes during the episode, bends, or
is another one.

Torques are multiples of the arm's own weight and inertia, so that `conditions` makes the same task
of any arm. `docs/reference/classes.md` has the source of each range.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from fbl_gym.model.arm import TABLE_1, ArmParameters, Array
from fbl_gym.model.real_arms import CICESE, DFKI_A0, DFKI_C1, PELICAN
from fbl_gym.options import (
    DriveChange,
    Event,
    FlexibleLink,
    FourierReference,
    FrictionChange,
    Knock,
    MinimumJerk,
    PickUp,
)
from fbl_gym.records.record import Distribution, merged
from fbl_gym.scenarios.families import Family, Member, combined
from fbl_gym.scenarios.scenario import Scenario

_BOX = (-math.pi, -2.2), (0.0, 2.2)

LEAST = 9.8
"""Least ratio of an arm's scale of torque to its inertia [rad/s^2]."""


class RobotClass(NamedTuple):
    """A class of robots.

    Attributes:
        text: one line.
        arm: the nominal model.
        times: control_dt, physics_dt and duration [s].
        move_time: of the board's motion, moves over the whole workspace [s].
        delay: shortest and longest delay of the drives beyond a sample of computation [s].
        lag: smallest and largest time constant of the drives [s].
        encoder: side of the joint on which the encoders are.
        counts: of the encoders, per turn of the joint.
        friction: viscous friction, Coulomb friction and stiction, each from - to for both joints in
            multiples of the arm's weight; then the Coulomb friction per torque of the drive.
        gain: range of real / nominal torque.
        options: further fields of `Scenario`, from the arm's scales.
    """

    text: str
    arm: ArmParameters
    times: tuple[float, float, float]
    move_time: float
    delay: tuple[float, float]
    lag: tuple[float, float]
    encoder: str
    counts: float
    friction: Mapping[str, Any]
    gain: tuple[float, float]
    options: Callable[["_Scale"], dict[str, Any]] = lambda _: {}


def _uniform(low: float, high: float) -> Distribution:
    return Distribution(uniform=(low, high))


def _log(ends: tuple[float, float], scale: float = 1.0) -> Distribution:
    return Distribution(log_uniform=(scale * ends[0], scale * ends[1]))


def stretched_inertia(arm: ArmParameters) -> Array:
    """Return the inertia of the stretched links about each joint [2] kg m^2, without rotors."""
    p1, p2, p3, _, _ = arm.lumped
    return np.array([p1 + p2 + 2 * p3, p2])


class _Scale:
    """The scales of an arm in a class, and the share of a family's size.

    Attributes:
        weight: largest torque of gravity on each joint [2] N m, or that of an acceleration of
            `LEAST` of the stretched links and rotors, where it is larger.
        inertia: of the stretched links about each joint [2] kg m^2.
        reach: inertia that a motion of both joints meets, with the rotors [2] kg m^2.
    """

    def __init__(self, robot: RobotClass, arm: ArmParameters, size: float = 1.0) -> None:
        _, p2, p3, p4, p5 = arm.lumped
        self.robot, self.arm, self.size = robot, arm, size
        self.inertia = stretched_inertia(arm)
        rotor = np.array(arm.rotor)
        self.rotor = np.where(rotor > 0, rotor, 0.3 * self.inertia)
        self.weight = np.maximum([abs(p4) + abs(p5), abs(p5)], LEAST * (self.inertia + np.array(arm.rotor)))
        self.reach = np.array([self.inertia[0], p2 + p3]) + rotor

    def friction(self, factor: float = 1.0) -> dict[str, Any]:
        """Return the friction of the class; all but its part by load, `factor` times."""
        given = dict(self.robot.friction)
        friction = {"load": _uniform(*given.pop("load")), "v_s": 0.04}
        for name, joints in given.items():
            ends = [(factor * w * low, factor * w * high) for w, (low, high) in zip(self.weight, joints, strict=True)]
            friction[name] = tuple(_uniform(*each) for each in ends)
        return friction

    def springs(self, low: float, high: float, gap: float = 0.0) -> dict[str, Any]:
        """Return joints of which each alone vibrates between two rates [Hz], with its motor held.

        Both together have a slower mode. A gap is in mrad.
        """
        stiffness = self.inertia * (2 * math.pi) ** 2
        middle = stiffness * low * high
        joint = {
            "stiffness": tuple(_log((low * low, high * high), k) for k in stiffness),
            "damping": tuple(0.04 * np.sqrt(middle * self.inertia)),  # 2 % of the critical one
            "rotor_inertia": tuple(self.rotor),
            "backlash": 1e-3 * gap,
            "encoder": self.robot.encoder,
        }
        return {"joint": joint}


CLASSES = {
    "servo": RobotClass(
        "bus servos: 100 Hz, a sample of computation, a slow drive, 12 bits at the joint, friction under load",
        ArmParameters.from_links((0.6, 0.4), (0.22, 0.2), (0.12, 0.1), (3e-3, 1.5e-3), (0.0246, 0.011)),
        times=(0.01, 0.0005, 10.0), move_time=1.2, delay=(0.0, 0.0), lag=(0.005, 0.015), encoder="link", counts=4096.0,
        friction={"viscous": ((0.01, 0.04),) * 2, "coulomb": ((0.01, 0.05), (0.03, 0.1)),
                  "stiction": ((0.01, 0.05), (0.03, 0.1)), "load": (0.05, 0.23)},
        gain=(0.9, 1.1),
    ),
    "direct": RobotClass(
        "quasi-direct and direct drives: 500 Hz over a bus with jitter, rigid, some 16,000 counts at the joint",
        DFKI_C1,
        times=(0.002, 0.0005, 6.0), move_time=1.0, delay=(0.0015, 0.006), lag=(0.001, 0.002), encoder="motor",
        counts=65535 / 25 * 2 * math.pi,
        friction={"viscous": ((0.0, 0.02),) * 2, "coulomb": ((0.03, 0.07), (0.06, 0.13)), "stiction": ((0.0, 0.02),) * 2,
                  "load": (0.0, 0.05)},
        gain=(0.83, 1.01),
        options=lambda _: {"actuator": {"jitter": 0.0015}, "parameter_error": {"rotor": _uniform(0.8, 2.2)}},
    ),
    "geared": RobotClass(
        "harmonic drives: 1 kHz, a fast drive, encoders on the motors, springs of 10 to 15 Hz, ripple, much friction",
        ArmParameters.from_links((4.0, 3.0), (0.35, 0.3), (0.16, 0.135), (0.04, 0.025), (0.947, 0.334)),
        times=(0.001, 0.0005, 5.0), move_time=1.5, delay=(0.0, 0.0), lag=(0.001, 0.002), encoder="motor", counts=409600.0,
        friction={"viscous": ((0.05, 0.2),) * 2, "coulomb": ((0.05, 0.15),) * 2, "stiction": ((0.05, 0.15),) * 2,
                  "load": (0.06, 0.17)},
        gain=(0.9, 1.1),
        options=lambda scale: {
            **scale.springs(10.0, 15.0, 0.2),
            "actuator": {"ripple": tuple(0.01 * scale.weight), "ripple_order": (200.0, 100.0)},
        },
    ),
}  # fmt: skip
"""The classes of robots, by name."""


class _Family(NamedTuple):
    """A family of several classes: its text, its options, and its numbers in each class."""

    text: str
    options: Callable[..., dict[str, Any]]
    columns: Mapping[str, tuple[Any, ...]]


def _payload(scale: _Scale, share: float) -> dict[str, Any]:
    size = {"offset": 0.1 * scale.arm.L2, "radius": 0.1 * scale.arm.L2}
    times = {"pick_up": _uniform(0.1, 0.3), "drop": _uniform(0.6, 0.8)}  # shares of the episode
    times = {name: _uniform(*(scale.robot.times[2] * x for x in time.values)) for name, time in times.items()}
    return {"parameter_error": {"payload": {"mass": _uniform(0.0, scale.size * scale.arm.m2 * share), **size, **times}}}


def _bodies(scale: _Scale, r: float) -> dict[str, Any]:
    r = scale.size * r
    return {
        "parameter_error": {"radius": r, "centre": _uniform(1 - r / 2, 1 + r / 2), "inertia": _uniform(1 - r, 1 + r)}
    }


def _saturation(scale: _Scale, torque: float) -> dict[str, Any]:
    moves = MinimumJerk(*_BOX, move_time=0.6 * scale.robot.move_time, hold_time=0.6)
    limit = tuple(1.6 * scale.weight + torque * scale.reach)
    return {"reference": moves, "actuator": {"torque_limit": limit}}


_ALL = tuple(CLASSES)
_FAMILIES = {
    "model-error": _Family(
        "masses off by factors of up to 1 + r, inertias by r, centres by r / 2; r = {}", _bodies,
        dict.fromkeys(_ALL, ((0.2, 0.35, 0.5),)),
    ),
    "payload": _Family(
        "up to {} times the second link's mass, picked up and dropped during the motion", _payload,
        dict.fromkeys(_ALL, ((0.25, 0.5, 1.0),)),
    ),
    "delay": _Family(
        "a further delay of up to {} ms",
        lambda scale, more: {
            "actuator": {"delay": _uniform(scale.robot.delay[0], scale.robot.delay[1] + scale.size * 1e-3 * more)}
        },
        {"servo": ((10, 20, 30),), "direct": ((2, 5, 10),), "geared": ((1, 2, 4),)},
    ),
    "lag": _Family(
        "a lag of the drives of {} ms",
        lambda scale, lag: {"actuator": {"lag": _log(lag, scale.size * 1e-3)}},
        {"servo": (((10, 20), (15, 40), (30, 60)),), "direct": (((4, 8), (6, 15), (10, 25)),),
         "geared": (((2, 4), (3, 8), (6, 15)),)},
    ),
    "jitter": _Family(
        "each command late by up to {} ms", lambda scale, late: {"actuator": {"jitter": scale.size * 1e-3 * late}},
        {"direct": ((2, 4, 8),)},
    ),
    "lost-readings": _Family(
        "1 % of the samples begin a gap of {} readings",
        lambda scale, length: {"encoder": {"dropout": 0.01, "dropout_length": math.ceil(scale.size * length)}},
        {"servo": ((2, 4, 8),)},
    ),
    "noise": _Family(
        "position noise of {} mrad, and encoders of {} counts",
        lambda scale, sigma, counts: {"noise": {"position": scale.size * 1e-3 * sigma}, "encoder": {"counts": counts}},
        {"servo": ((0.3, 1, 3), (4096, 2048, 1024)), "direct": ((0.1, 0.3, 1), (16384, 8192, 4096)),
         "geared": ((0.01, 0.03, 0.1), (204800, 102400, 51200))},
    ),
    "friction": _Family(
        "{} times the friction", lambda scale, n: {"friction": scale.friction(scale.size * n)},
        {"servo": ((2, 3, 5),), "direct": ((2, 3, 5),), "geared": ((1.5, 2, 3),)},
    ),
    "disturbance": _Family(
        "a torque within {} % of the arm's weight, a new level every 0.5 s",
        lambda scale, percent: {
            "disturbance": {"kind": "piecewise-constant", "amplitude": tuple(scale.size * 0.01 * percent * scale.weight)}
        },
        dict.fromkeys(_ALL, ((10, 30, 60),)),
    ),
    "elastic": _Family(
        "springs in the joints, each alone with a natural frequency of {} Hz",
        lambda scale, rates: scale.springs(*(rate / scale.size for rate in rates)),
        {"servo": (((14, 20), (11, 15), (8, 11)),), "geared": (((7, 10), (5, 7), (3.5, 5)),)},
    ),
    "backlash": _Family(
        "a gap of {} mrad in joints with springs of {} Hz",
        lambda scale, gap, rates: scale.springs(*rates, gap),
        {"servo": ((1, 5, 20), ((10, 14),) * 3), "geared": ((0.5, 1, 3), ((10, 15),) * 3)},
    ),
    "ripple": _Family(
        "torque ripple of {} % of the weight",
        lambda scale, percent: {"actuator": {"ripple": tuple(scale.size * 0.01 * percent * scale.weight)}},
        {"geared": ((2, 5, 10),)},
    ),
    "saturation": _Family(
        "faster moves, with torque for the weight and {} rad/s^2", _saturation, dict.fromkeys(_ALL, ((8, 5, 3),)),
    ),
    "torque-constant": _Family(
        "torques off by up to {} %",
        lambda scale, percent: {
            "actuator": {"gain": _uniform(1 - scale.size * 0.01 * percent, 1 + scale.size * 0.01 * percent)}
        },
        dict.fromkeys(_ALL, ((15, 25, 40),)),
    ),
}  # fmt: skip

_APART = {
    "servo": ("lost-readings", "backlash", "saturation"),
    "direct": ("saturation",),
    "geared": ("backlash", "saturation"),
}
"""Families that are no part of `everything`."""

SURPRISES = {
    "payload": "half of the second link's mass is picked up without notice",
    "knock": "a blow, by which a stretched arm would gain 2 rad/s",
    "friction": "friction becomes three times as large",
    "drive": "the first drive loses 25 % of its torque",
    "bend": "links bend, with natural frequencies of 12 to 25 Hz that no encoder sees",
    "arm": "another arm, with the drives and sensors of the class",
}

_OTHER_ARMS = {"servo": PELICAN, "direct": CICESE, "geared": TABLE_1}
"""The arm of the surprise `arm`."""

_REAL_ARMS = {"dfki-a0": DFKI_A0}

_VARIANTS = {
    "": ((1.0, 1.0, 1.0), (0.4, 1.3, 1.0), (2.5, 1.1, 0.3)),
    "practice": ((1.0, 1.0, 1.0), (0.4, 0.7, 1.0), (3.0, 1.3, 0.0)),
}
"""Of board and practice: mass and length of the second link, and both rotors, as multiples of the
class's arm."""


def _variant(tier: str, robot: str, family: str, severity: int) -> tuple[float, float, float]:
    """Return the variant whose turn it is; in practice, both severities of a family have others."""
    turns = ("nominal", *families(robot))
    turn = turns.index(family) + (severity // 2 if tier == "practice" else 0) if family in turns else 0
    return _VARIANTS[tier][turn % len(_VARIANTS[tier])]


def _varied(arm: ArmParameters, mass: float, length: float, rotors: float) -> ArmParameters:
    first, second = arm.rotor  # type: ignore[misc]
    rotor = (rotors * first, rotors * mass * length**2 * second)  # a drive suits its link
    return dataclasses.replace(arm, m2=mass * arm.m2, L2=length * arm.L2, rotor=rotor)


_TEXTS = {
    "nominal": "nothing is pushed further",
    "dfki-a0": "DFKI's double pendulum, design A.0, with its friction and torque limit",
}


def families(robot: str) -> dict[str, Family]:
    """Return the families of one of `CLASSES`, by name."""
    known = {
        name: Family(family.text, family.columns[robot], family.options)
        for name, family in _FAMILIES.items()
        if robot in family.columns
    }
    apart = [name for name in known if name in _APART[robot]]
    known["everything"] = Family(f"all but {' and '.join(apart)} at once, at half their size", (), lambda _: {})
    return known


def conditions(arm: ArmParameters, robot: str, family: str = "nominal", severity: int = 0) -> dict[str, Any]:
    """Return the options of a class's scenario for any arm, as fields of `Scenario`.

    Args:
        arm: the nominal model. Where joints have springs and it has no rotors, it gets rotors of
            0.3 times the inertia of the stretched links.
        robot: one of `CLASSES`.
        family: one of `families(robot)`, or "nominal": nothing is pushed further.
        severity: 0 to 3.
    """
    kind, known = CLASSES[robot], families(robot)
    scale = _Scale(kind, arm, 0.5 if family == "everything" else 1.0)
    control_dt, physics_dt, duration = kind.times
    usual: dict[str, Any] = {
        "arm": arm,
        "control_dt": control_dt,
        "physics_dt": physics_dt,
        "duration": duration,
        "encoder": {"counts": kind.counts, "difference": 1},
        "friction": scale.friction(),
        "initial_error": _uniform(-0.05, 0.05),
        "parameter_error": {
            "radius": 0.1, "parameters": ["m1", "m2"], "centre": _uniform(0.9, 1.1), "inertia": _uniform(0.7, 1.3),
            "rotor": _uniform(0.8, 1.2),
            "payload": {"mass": _uniform(0.0, 0.1 * arm.m2), "offset": 0.1 * arm.L2, "radius": 0.1 * arm.L2},
        },
        "sensors": ("position", "velocity"),
        "reference": MinimumJerk(*_BOX, move_time=kind.move_time, hold_time=0.3),
        "limits": {"error": 0.5},
        "actuator": {
            "torque_limit": tuple(1.5 * scale.weight + 16.0 * scale.reach), "delay_samples": 1,
            "delay": _uniform(*kind.delay), "lag": _log(kind.lag), "gain": _uniform(*kind.gain),
        },
    }  # fmt: skip
    task = {**merged(usual, kind.options(scale))}
    if severity > 0 and family in known:
        together = [name for name in known if name not in (*_APART[robot], "everything")]
        names = together if family == "everything" else [family]
        task = {**merged(task, combined(known, tuple(names), severity, scale))}
    if "joint" in task and np.min(arm.rotor) <= 0:
        return conditions(dataclasses.replace(arm, rotor=tuple(scale.rotor)), robot, family, severity)
    return task


def _board(
    robot: str, family: str, severity: int, arm: ArmParameters | None, tier: str = "", **options: Any
) -> Scenario:
    """Return a scenario of a class's board, with some options replaced."""
    text = _TEXTS.get(family) or families(robot)[family].description
    variant = _variant(tier, robot, family, severity)
    if arm is None and family not in _REAL_ARMS and variant != _VARIANTS[tier][0]:
        text += "; second link of {:g} times the mass and {:g} times the length, {:g} times the rotors".format(*variant)
    own = _REAL_ARMS.get(family) or _varied(CLASSES[robot].arm, *variant)
    task = conditions(arm or own, robot, family, severity)
    if family == "dfki-a0" and arm is None:  # friction and torque limit as in `real.py`
        task["friction"] = {"viscous": 0.001, "coulomb": (0.093 * math.pi / 2, 0.078 * math.pi / 2)}
        task["actuator"]["torque_limit"] = 10.0
    name = _name(robot, tier, family, severity)
    return Scenario(name=name, description=f"{robot}: {text}", **{**task, **options})


def _practice(robot: str, family: str, severity: int, arm: ArmParameters | None) -> Scenario:
    """Return a scenario for tuning and training: with other arms and motions than on the board."""
    speed = 1.5 if family == "saturation" else 1.0
    frequency = speed * 0.24 / CLASSES[robot].move_time
    motion = FourierReference(amplitude=(1.5, 2.0), frequency=frequency, harmonics=4)
    return _board(robot, family, severity, arm, "practice", reference=motion, duration=4.8)


def _surprise(robot: str, family: str, severity: int, arm: ArmParameters | None) -> Scenario:
    """Return one of `SURPRISES`."""
    kind = CLASSES[robot]
    arm = arm or (_OTHER_ARMS[robot] if family == "arm" else kind.arm)
    scale, (_, p2, p3, _, _) = _Scale(kind, arm), arm.lumped
    time = _uniform(0.3 * kind.times[2], 0.5 * kind.times[2])
    changes: dict[str, Event] = {
        "payload": PickUp(time=time, mass=0.5 * arm.m2),
        "knock": Knock(time=time, impulse=(2.0 * scale.inertia[0], 2.0 * (p2 + p3))),
        "friction": FrictionChange(time=time, factor=3.0),
        "drive": DriveChange(time=time, factor=(0.75, 1.0)),
    }
    events = (changes[family],) if family in changes else ()
    link = FlexibleLink((_log((12.0, 25.0)),) * 2, damping=0.05) if family == "bend" else None
    text, name = f"{robot}: {SURPRISES[family]}", _name(robot, "surprise", family, severity)
    return Scenario(name=name, description=text, events=events, link=link, **conditions(arm, robot))


def _name(robot: str, tier: str, family: str, severity: int) -> str:
    return "-".join(filter(None, (robot, tier, family, str(severity or ""))))


def _members() -> dict[str, tuple[Callable[..., Scenario], str, Member]]:
    members = {}
    for robot in CLASSES:
        names = [*families(robot)]
        for make, tier, known, severities in (
            (_board, "", ["nominal", *(["dfki-a0"] if robot == "direct" else [])], (0,)),
            (_board, "", names, (1, 2, 3)),
            (_practice, "practice", ["nominal"], (0,)),
            (_practice, "practice", names, (1, 3)),
            (_surprise, "surprise", [*SURPRISES], (0,)),
        ):
            for family in known:
                for severity in severities:
                    member = Member(family, severity, "-".join(filter(None, (robot, tier))))
                    members[_name(robot, tier, family, severity)] = make, robot, member
    return members


_OWN_ARMS = {
    *_OTHER_ARMS.values(), *_REAL_ARMS.values(),
    *(_varied(kind.arm, *variant) for kind in CLASSES.values() for variant in _VARIANTS[""]),
}  # fmt: skip
"""The arms on which tuning and training may have no events, links that bend or other plant."""

_ENTRIES = _members()
MEMBERS = {name: member for name, (_, _, member) in _ENTRIES.items()}
"""Family, severity and tier of each named scenario."""


def get(name: str, arm: ArmParameters | None = None) -> Scenario:
    """Return the scenario of a name of `MEMBERS`; loads and torque limits follow from `arm`."""
    make, robot, member = _ENTRIES[name]
    return make(robot, member.family, member.severity, arm)


def held_out_reason(scenario: Scenario) -> str:
    """Return the reason why tuning and training may not use a scenario; empty if they may.

    A board is judged on motions, events, arms and engines that no law has been tuned for. A
    scenario is recognised by its content, whatever its name.
    """
    reference = scenario.reference
    if isinstance(reference, MinimumJerk) and reference.points is None and (reference.low, reference.high) == _BOX:
        return f"its motion is the board's: minimum-jerk moves between {reference.low} and {reference.high} rad"
    if scenario.arm not in _OWN_ARMS:
        return ""
    if scenario.events:
        return "it has events, as the tiers of surprise"
    if scenario.link is not None:
        return "its links bend, as in the tiers of surprise"
    if scenario.plant is not None:
        return f"its plant is {scenario.plant.kind}, on which the board's order is checked"
    return ""
