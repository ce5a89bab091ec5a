"""The tiers `hardware`, `practice` and `surprise`: an arm as it stands in a laboratory.

Every scenario has an encoder with a velocity computed from it, no accelerometer, a sample of
computation delay, a lag of the drives, friction, a start beside the reference, wrong parameters and
a payload. Each episode draws their numbers. A family pushes one of them further, at severities 1 to
3. The rate is 100 Hz: at 200 Hz with half the delay and lag, computed torque with stiff gains is
within 10 % of an oracle that knows the arm.

The board is measured on `hardware`, after which `surprise` changes the arm during an episode or
brings another arm. Tuning and training use `practice`: other motions, and other draws of the same
families.

All torques are multiples of the arm's own weight and inertia, so that `conditions` makes the same
task of any arm.
"""

import dataclasses
import math
from typing import Any

import numpy as np

from fbl_gym.model.arm import TABLE_1, ArmParameters
from fbl_gym.model.real_arms import CICESE, DFKI_C1, PELICAN
from fbl_gym.options import DriveChange, Event, FourierReference, FrictionChange, Knock, MinimumJerk, PickUp
from fbl_gym.records import Distribution, merged
from fbl_gym.scenarios import classes
from fbl_gym.scenarios.families import Family, Member, combined
from fbl_gym.scenarios.scenario import Scenario

_BOX = (-math.pi, -2.2), (0.0, 2.2)

ARM = dataclasses.replace(TABLE_1, rotor=(9.0, 1.1))
"""Table 1's links with the rotors of geared drives, 30 % of each link's inertia."""

MOVES = MinimumJerk(*_BOX, move_time=1.2, hold_time=0.3)
"""The board's motion: moves over the whole workspace, each with a rest at which stiction acts."""

LEAST = 9.8
"""Least ratio of an arm's scale of torque to its inertia [rad/s^2]; the board's arm has 10.0."""

PRACTICE_MOTION = FourierReference(amplitude=(1.5, 2.0), frequency=0.2, harmonics=4)

_REAL = {
    "nominal": "an arm with drives, sensors and friction as in laboratories, nothing pushed further",
    "pelican": "the Pelican of Kelly, Santibáñez and Loría, with the tier's sensors and drives of twice the torque",
    "dfki-c1": "DFKI's double pendulum, design C.1, with its friction, torque limit and encoder",
}

_ARMS = {"pelican": PELICAN, "dfki-c1": DFKI_C1, "cicese": CICESE}

SURPRISES = {
    "payload": "half of the second link's mass is picked up without notice",
    "knock": "a blow, by which a stretched arm would gain 2 rad/s",
    "friction": "friction becomes five times as large",
    "drive": "a drive loses 40 % of its torque",
    "cicese": "the direct-drive arm of CICESE and BUAP, with the tier's drives and sensors",
}


def _uniform(low: float, high: float) -> Distribution:
    return Distribution(uniform=(low, high))


def _times(scale: np.ndarray, low: float, high: float) -> tuple[Distribution, Distribution]:
    """Return a uniform distribution for each joint, between multiples of its scale [2]."""
    return _uniform(low * scale[0], high * scale[0]), _uniform(low * scale[1], high * scale[1])


class _Scale:
    """The scales of an arm, and the share of a family's size.

    Attributes:
        weight: largest torque of gravity on each joint [2] N m, or that of an acceleration of
            `LEAST` of the stretched links, where it is larger.
        inertia: of the stretched links about each joint [2] kg m^2.
        reach: inertia that a motion of both joints meets, with the rotors [2] kg m^2.
    """

    def __init__(self, arm: ArmParameters, size: float = 1.0) -> None:
        p1, p2, p3, p4, p5 = arm.lumped
        self.m2, self.size, self.rotor = arm.m2, size, np.array(arm.rotor)
        self.inertia = np.array([p1 + p2 + 2 * p3, p2])
        self.weight = np.maximum([abs(p4) + abs(p5), abs(p5)], LEAST * self.inertia)
        self.reach = np.array([self.inertia[0], p2 + p3]) + self.rotor

    def friction(self, factor: float) -> dict[str, Any]:
        """Return friction, `factor` times the usual one."""
        dry = _times(self.weight, 0.01 * factor, 0.03 * factor)
        return {"viscous": _times(self.weight, 0.005 * factor, 0.015 * factor), "coulomb": dry, "stiction": dry}

    def springs(self, frequency: float, backlash: float = 0.0) -> dict[str, Any]:
        """Return joints of which each alone vibrates at a frequency [Hz], with its motor held.

        Both together have a slower mode.
        """
        stiffness = self.inertia * (2 * math.pi * frequency) ** 2
        joint = {
            "stiffness": _times(stiffness, 0.7, 1.3),
            "damping": tuple(0.04 * np.sqrt(stiffness * self.inertia)),  # 2 % of the critical one
            "rotor_inertia": None if self.rotor.min() > 0 else tuple(0.3 * self.inertia),
            "backlash": backlash,
            "encoder": "link",
        }
        return {"joint": joint, "physics_dt": 0.0005}

    def fast_moves(self, torque: float) -> dict[str, Any]:
        """Return moves that need more than their torque limits."""
        limit = tuple(1.1 * self.weight + torque * self.reach)
        moves = dataclasses.replace(MOVES, move_time=0.7, hold_time=0.6)
        return {"reference": moves, "actuator": {"torque_limit": limit}}


_FAMILIES = {
    "model-error": Family(
        "masses and lengths off, each by its own factor from [1/(1+r), 1+r]; r = {}",
        ((0.2, 0.35, 0.5),),
        lambda arm, r: {"parameter_error": {"radius": r * arm.size}},
    ),
    "payload": Family(
        "up to {} times the second link's mass, picked up and dropped during the motion",
        ((0.25, 0.5, 1.0),),
        lambda arm, share: {"parameter_error": {"payload": {
            "mass": _uniform(0.0, arm.size * arm.m2 * share), "pick_up": _uniform(1.0, 3.0), "drop": _uniform(6.0, 8.0),
        }}},
    ),
    "delay": Family(
        "a further delay of up to {} ms",
        ((10, 20, 30),),
        lambda arm, delay: {"actuator": {"delay": _uniform(0.0, arm.size * 1e-3 * delay)}},
    ),
    "lag": Family(
        "a lag of the drives of {} ms",
        (((10, 20), (15, 40), (30, 60)),),
        lambda arm, lag: {"actuator": {"lag": {"log_uniform": [arm.size * 1e-3 * end for end in lag]}}},
    ),
    "noise": Family(
        "position noise of {} mrad, and encoders of {} counts",
        ((0.3, 1, 3), (16384, 8192, 4096)),
        lambda arm, sigma, counts: {"noise": {"position": arm.size * 1e-3 * sigma}, "encoder": {"counts": counts}},
    ),
    "friction": Family("{} times the friction", ((2, 4, 8),), lambda arm, n: {"friction": arm.friction(arm.size * n)}),
    "disturbance": Family(
        "a torque within {} % of the arm's weight, a new level every 0.5 s",
        ((10, 30, 60),),
        lambda arm, percent: {
            "disturbance": {"kind": "piecewise-constant", "amplitude": tuple(arm.size * 0.01 * percent * arm.weight)}
        },
    ),
    "elastic": Family(
        "springs in the joints, each alone with a natural frequency about {} Hz; encoders on the links",
        ((12, 7, 4),),
        lambda arm, frequency: arm.springs(frequency / arm.size),
    ),
    "backlash": Family(
        "a gap of {} mrad in the joints; encoders on the links",
        ((1, 5, 20),),
        lambda arm, gap: arm.springs(12.0, 1e-3 * gap),
    ),
    "saturation": Family(
        "faster moves, with torque for the weight and {} rad/s^2; they need more in about {} % of the samples",
        ((8, 5, 3), (5, 9, 12)),
        lambda arm, torque, _: arm.fast_moves(torque),
    ),
    "torque-constant": Family(
        "torques off by up to {} %",
        ((10, 20, 40),),
        lambda arm, percent: {"actuator": {"gain": _uniform(1 - arm.size * 0.01 * percent, 1 + arm.size * 0.01 * percent)}},
    ),
    "everything": Family("all but backlash and saturation at once, at half their size", (), lambda _: {}),
}  # fmt: skip
FAMILIES = {name: family.description for name, family in _FAMILIES.items()}
"""The description of each family, by name."""

_EVERYTHING = tuple(name for name in FAMILIES if name not in ("backlash", "saturation", "everything"))


def conditions(arm: ArmParameters, family: str = "nominal", severity: int = 0) -> dict[str, Any]:
    """Return the options of a hardware scenario for any arm, as fields of `Scenario`.

    Args:
        arm: the nominal model.
        family: one of `FAMILIES`, or "nominal": nothing is pushed further.
        severity: 0 to 3.
    """
    scale = _Scale(arm, 0.5 if family == "everything" else 1.0)
    usual: dict[str, Any] = {
        "arm": arm,
        "encoder": {"counts": 65536.0, "difference": 1},
        "friction": scale.friction(1.0),
        "initial_error": _uniform(-0.05, 0.05),
        "parameter_error": {"radius": 0.1, "payload": {"mass": _uniform(0.0, 0.1 * arm.m2)}},
        "sensors": ("position", "velocity"),
        "reference": MOVES,
        "limits": {"error": 0.5},
        "actuator": {
            "torque_limit": tuple(scale.weight + 16.0 * scale.reach),
            "delay_samples": 1,
            "lag": Distribution(log_uniform=(0.005, 0.015)),
        },
    }
    if severity == 0 or family not in FAMILIES:
        return usual
    pushed = combined(_FAMILIES, _EVERYTHING if family == "everything" else (family,), severity, scale)
    return {**merged(usual, pushed)}


def hardware(family: str = "nominal", severity: int = 0, arm: ArmParameters | None = None) -> Scenario:
    """Return a scenario of the board.

    Args:
        family: one of `FAMILIES`, "nominal", or a real arm: "pelican" or "dfki-c1".
        severity: 0 to 3; real arms have 0 only.
        arm: the nominal model; None: the tier's.
    """
    options = conditions(arm or _ARMS.get(family, ARM), family, severity)
    if family == "pelican" and arm is None:  # its fast second link needs more than the tier's rule gives
        options["actuator"]["torque_limit"] = tuple(2.0 * x for x in options["actuator"]["torque_limit"])
    if family == "dfki-c1" and arm is None:  # drives and encoders as in `real.py`
        options["actuator"]["torque_limit"] = 10.0
        options["encoder"]["counts"] = 65535.0 / 25.0 * 2 * math.pi
        options["friction"] = {"viscous": 0.001, "coulomb": (0.16 * math.pi / 2, 0.12 * math.pi / 2)}
    return Scenario(name=_name("hardware", family, severity), description=(_REAL | FAMILIES)[family], **options)


def practice(family: str = "nominal", severity: int = 0, arm: ArmParameters | None = None) -> Scenario:
    """Return `hardware` with another motion, for tuning and training.

    Severity 1 or 3 is named; the board of `make leaderboard` has 2.
    """
    motion = PRACTICE_MOTION
    if family == "saturation":
        motion = dataclasses.replace(motion, frequency=0.4)
    return hardware(family, severity, arm).replace(
        name=_name("practice", family, severity), reference=motion, duration=8.0
    )


def surprise(family: str, arm: ArmParameters | None = None) -> Scenario:
    """Return one of `SURPRISES`: a scenario that changes during the episode, or has another arm."""
    arm = arm or _ARMS.get(family, ARM)
    scale, (_, p2, p3, _, _) = _Scale(arm), arm.lumped
    changes: dict[str, Event] = {
        "payload": PickUp(time=_uniform(3.0, 5.0), mass=0.5 * arm.m2),
        "knock": Knock(time=_uniform(3.0, 5.0), impulse=(2.0 * scale.inertia[0], 2.0 * (p2 + p3))),
        "friction": FrictionChange(time=_uniform(3.0, 5.0), factor=5.0),
        "drive": DriveChange(time=_uniform(3.0, 5.0), factor=0.6),
    }
    events = (changes[family],) if family in changes else ()
    return Scenario(name=_name("surprise", family, 0), description=SURPRISES[family], events=events, **conditions(arm))


def _name(tier: str, family: str, severity: int) -> str:
    return f"{tier}-{family}" if severity == 0 else f"{tier}-{family}-{severity}"


_TIERS = {"hardware": hardware, "practice": practice, "surprise": lambda family, _, arm: surprise(family, arm)}

MEMBERS = {
    _name(tier, family, severity): Member(family, severity, family if family in _ARMS else "table-1", tier)
    for tier, families, severities in (
        ("hardware", ("nominal", "pelican", "dfki-c1"), (0,)),
        ("hardware", FAMILIES, (1, 2, 3)),
        ("practice", ("nominal",), (0,)),
        ("practice", FAMILIES, (1, 3)),
        ("surprise", SURPRISES, (0,)),
    )
    for family in families
    for severity in severities
}
"""Family, severity, arm and tier of each named scenario."""


def get(name: str, arm: ArmParameters | None = None) -> Scenario:
    """Return the scenario of a name of `MEMBERS`; loads and torque limits follow from `arm`."""
    member = MEMBERS[name]
    return _TIERS[member.tier](member.family, member.severity, arm)


def held_out_reason(scenario: Scenario) -> str:
    """Return the reason why tuning and training may not use a scenario; empty if they may.

    The board is judged on motions, events, arms and engines that no law has been tuned for. A
    scenario is recognised by its content, whatever its name.
    """
    reference = scenario.reference
    if isinstance(reference, MinimumJerk) and reference.points is None and (reference.low, reference.high) == _BOX:
        return f"its motion is the board's: minimum-jerk moves between {reference.low} and {reference.high} rad"
    if scenario.arm not in (ARM, *_ARMS.values(), *classes.OWN_ARMS):
        return ""
    if scenario.events:
        return "it has events, as the tier `surprise`"
    if scenario.plant is not None:
        return f"its plant is {scenario.plant.kind}, on which the board's order is checked"
    return ""
