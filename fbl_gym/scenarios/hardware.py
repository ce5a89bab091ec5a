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

from fbl_gym.arm import TABLE_1, ArmParameters
from fbl_gym.events import DriveChange, Event, FrictionChange, Knock, PickUp
from fbl_gym.real_arms import CICESE, DFKI_C1, PELICAN
from fbl_gym.records import Distribution
from fbl_gym.references import FourierReference, MinimumJerk
from fbl_gym.scenarios.ideal import Member
from fbl_gym.scenarios.scenario import Scenario

_BOX = (-math.pi, -2.2), (0.0, 2.2)

ARM = dataclasses.replace(TABLE_1, rotor=(9.0, 1.1))
"""Table 1's links with the rotors of geared drives, 30 % of each link's inertia."""

MOVES = MinimumJerk(*_BOX, move_time=1.2, hold_time=0.3)
"""The board's motion: moves over the whole workspace, each with a rest at which stiction acts."""

PRACTICE_MOTION = FourierReference(amplitude=(1.5, 2.0), frequency=0.2, harmonics=4)

FAMILIES = {
    "model-error": "masses and lengths off, each by its own factor from [1/(1+r), 1+r]; r = 0.2, 0.35, 0.5",
    "payload": "up to a quarter, half or all of the second link's mass, picked up and dropped during the motion",
    "delay": "a further delay of up to 10, 20 or 30 ms",
    "lag": "a lag of the drives of 10-20, 15-40 or 30-60 ms",
    "noise": "position noise of 0.3, 1 or 3 mrad, and encoders of 16384, 8192 or 4096 counts",
    "friction": "twice, four or eight times the friction",
    "disturbance": "a torque within 10, 30 or 60 % of the arm's weight, a new level every 0.5 s",
    "elastic": "springs in the joints, with natural frequencies about 12, 7 or 4 Hz; encoders on the links",
    "backlash": "a gap of 1, 5 or 20 mrad in the joints; encoders on the links",
    "saturation": "faster moves, which need more than the torque limits in about 5, 9 or 12 % of the samples",
    "torque-constant": "torques off by a factor from 0.9-1.1, 0.8-1.2 or 0.6-1.4",
    "everything": "all but backlash and saturation at once, at half their size",
}

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

_RADIUS = (0.1, 0.2, 0.35, 0.5)


def _uniform(low: float, high: float) -> Distribution:
    return Distribution(uniform=(low, high))


def _times(scale: np.ndarray, low: float, high: float) -> tuple[Distribution, Distribution]:
    """Return a uniform distribution for each joint, between multiples of its scale [2]."""
    return _uniform(low * scale[0], high * scale[0]), _uniform(low * scale[1], high * scale[1])


def _friction(weight: np.ndarray, factor: float) -> dict[str, Any]:
    dry = _times(weight, 0.01 * factor, 0.03 * factor)
    return {"viscous": _times(weight, 0.005 * factor, 0.015 * factor), "coulomb": dry, "stiction": dry}


def _spring(inertia: np.ndarray, rotor: np.ndarray, frequency: float, backlash: float = 0.0) -> dict[str, Any]:
    """Return joints whose links vibrate at a natural frequency [Hz] while the motors are held."""
    stiffness = inertia * (2 * math.pi * frequency) ** 2
    return {
        "stiffness": _times(stiffness, 0.7, 1.3),
        "damping": tuple(0.04 * np.sqrt(stiffness * inertia)),  # 2 % of the critical one
        "rotor_inertia": None if rotor.min() > 0 else tuple(0.3 * inertia),
        "backlash": backlash,
        "encoder": "link",
    }


def conditions(arm: ArmParameters, family: str = "nominal", severity: int = 0) -> dict[str, Any]:
    """Return the options of a hardware scenario for any arm, as fields of `Scenario`.

    Args:
        arm: the nominal model.
        family: one of `FAMILIES`, or "nominal": nothing is pushed further.
        severity: 0 to 3.
    """
    p1, p2, p3, p4, p5 = arm.lumped
    weight = np.array([abs(p4) + abs(p5), abs(p5)]) if p5 else 10.0 * np.array([p1 + p2 + 2 * p3, p2])
    inertia = np.array([p1 + p2 + 2 * p3, p2])  # of the links, stretched
    rotor = np.array(arm.rotor)
    reach = np.array([inertia[0], p2 + p3]) + rotor
    s, size = severity, 0.5 if family == "everything" else 1.0

    def pushed(name: str) -> bool:
        return severity > 0 and family in (name, "everything")

    payload: dict[str, Any] = {"mass": _uniform(0.0, 0.1 * arm.m2)}
    if pushed("payload"):
        payload = {
            "mass": _uniform(0.0, size * arm.m2 * 2.0 ** (s - 3)),
            "pick_up": _uniform(1.0, 3.0),
            "drop": _uniform(6.0, 8.0),
        }
    actuator: dict[str, Any] = {
        "torque_limit": tuple(weight + 16.0 * reach),
        "delay_samples": 1,
        "lag": Distribution(log_uniform=(0.005, 0.015)),
    }
    if pushed("delay"):
        actuator["delay"] = _uniform(0.0, size * 0.01 * s)
    if pushed("lag"):
        low, high = ((0.01, 0.02), (0.015, 0.04), (0.03, 0.06))[s - 1]
        actuator["lag"] = Distribution(log_uniform=(size * low, size * high))
    if pushed("torque-constant"):
        spread = size * (0.1, 0.2, 0.4)[s - 1]
        actuator["gain"] = (_uniform(1 - spread, 1 + spread),) * 2
    options: dict[str, Any] = {
        "arm": arm,
        "encoder": {"counts": 65536.0, "difference": 1},
        "friction": _friction(weight, size * 2.0**s if pushed("friction") else 1.0),
        "initial_error": _uniform(-0.05, 0.05),
        "parameter_error": {"radius": _RADIUS[s] * size if pushed("model-error") else _RADIUS[0], "payload": payload},
        "sensors": ("position", "velocity"),
        "reference": MOVES,
        "limits": {"error": 0.5},
    }
    if pushed("noise"):
        options["noise"] = {"position": size * (3e-4, 1e-3, 3e-3)[s - 1]}
        options["encoder"]["counts"] = 65536.0 / 2 ** (s + 1)
    if pushed("disturbance"):
        options["disturbance"] = {
            "kind": "piecewise-constant",
            "amplitude": tuple(size * (0.1, 0.3, 0.6)[s - 1] * weight),
        }
    if pushed("elastic"):
        options["joint"] = _spring(inertia, rotor, (12.0, 7.0, 4.0)[s - 1] / size)
    elif family == "backlash" and severity > 0:
        options["joint"] = _spring(inertia, rotor, 12.0, backlash=(1e-3, 5e-3, 20e-3)[s - 1])
    if family == "saturation" and severity > 0:
        options["reference"] = dataclasses.replace(MOVES, move_time=0.7, hold_time=0.6)
        actuator["torque_limit"] = tuple(1.1 * weight + (8.0, 5.0, 3.0)[s - 1] * reach)
    if "joint" in options:
        options["physics_dt"] = 0.0005
    return {**options, "actuator": actuator}


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
    p1, p2, p3, _, _ = arm.lumped
    changes: dict[str, Event] = {
        "payload": PickUp(time=_uniform(3.0, 5.0), mass=0.5 * arm.m2),
        "knock": Knock(time=_uniform(3.0, 5.0), impulse=(2.0 * (p1 + p2 + 2 * p3), 2.0 * (p2 + p3))),
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


def judged(scenario: Scenario) -> str:
    """Return the reason why tuning and training may not use a scenario; empty if they may.

    The board is judged on motions, events, arms and engines that no law has been tuned for. A
    scenario is recognised by its content, whatever its name.
    """
    reference = scenario.reference
    if isinstance(reference, MinimumJerk) and reference.points is None and (reference.low, reference.high) == _BOX:
        return f"its motion is the board's: minimum-jerk moves between {reference.low} and {reference.high} rad"
    if scenario.arm not in (ARM, *_ARMS.values()):
        return ""
    if scenario.events:
        return "it has events, as the tier `surprise`"
    if scenario.plant is not None:
        return f"its plant is {scenario.plant.kind}, on which the board's order is checked"
    return ""
