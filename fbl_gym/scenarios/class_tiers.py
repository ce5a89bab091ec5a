"""Tiers of the classes of robots: the scenarios of their boards, surprises and practices.

The families take turns in three variants of the arm, since a law that suits one arm may fail on the
next. Beside the scenarios of its board, a class has `practice` for tuning and training, with other
variants and another motion, and `surprise`, on which nothing is tuned or trained: the arm changes
during the episode, bends, or is another one.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fbl_gym.model.arm import ArmParameters, stretched_inertia
from fbl_gym.options import ArrayReference, MinimumJerk
from fbl_gym.records.record import ends, merged
from fbl_gym.scenarios.class_families import BOX, Scale, conditions, families, log_uniform, middle_of, uniform
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.scenario import Scenario, as_arm


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


def board(robot: str, family: str, severity: int, arm: ArmParameters | None) -> dict[str, Any]:
    """Return a scenario of the board, which may be of one of its further arms."""
    if family not in CLASSES[robot].arms:
        return _turn(robot, family, severity, arm, _BOARD_ARMS)
    real = CLASSES[robot].arms[family]
    task = merged(conditions(as_arm("arm", real["arm"]), robot), real) if arm is None else conditions(arm, robot)
    return task | {"description": f"{robot}: {real['description']}"}


def practice(robot: str, family: str, severity: int, arm: ArmParameters | None) -> dict[str, Any]:
    """Return a scenario for tuning and training: with other arms and motions than on the board."""
    frequency = (1.5 if family == "saturation" else 1.0) * 0.24 / CLASSES[robot].move_time
    motion = {"kind": "fourier", "amplitude": (1.5, 2.0), "frequency": frequency, "harmonics": 4}
    return _turn(robot, family, severity, arm, _PRACTICE_ARMS) | {"reference": motion, "duration": 4.8}


def surprise(robot: str, family: str, _: int, arm: ArmParameters | None) -> dict[str, Any]:
    """Return a scenario of surprise: the arm changes, bends, or is another one."""
    kind = CLASSES[robot]
    arm = arm or (kind.other_arm if family == "arm" else kind.arm)
    duration, (_, p2, p3, _, _) = kind.scenario["duration"], arm.lumped
    time, task = uniform(0.3 * duration, 0.5 * duration), conditions(arm, robot)
    option, field = ("joint", "stiffness") if kind.springs else ("actuator", "lag")
    ranges = task[option][field]
    told = tuple(map(middle_of, ranges)) if kind.springs else middle_of(ranges)
    truth = [{"choice": (k / 2, 2 * k)} for k in np.ravel(told)]

    def event(kind: str, **numbers: Any) -> dict[str, Any]:
        return {"events": [{"kind": kind, "time": time, **numbers}]}

    changes: dict[str, Any] = {
        "payload": event("pick-up", mass=0.5 * arm.m2),
        "knock": event("knock", impulse=(2.0 * stretched_inertia(arm)[0], 2.0 * (p2 + p3))),
        "friction": event("friction", factor=3.0),
        "drive": event("drive", factor=(0.75, 1.0)),
        "bend": {"link": {"frequency": log_uniform((12.0, 25.0)), "damping": 0.05}},
        "arm": {},
        "datasheet": {option: {field: truth if kind.springs else truth[0]}, "datasheet": {field: told}},
    }
    return merged({"description": f"{robot}: {kind.surprises[family]}", **task}, changes[family])


def _own_arms() -> set[ArmParameters]:
    """Return the arms for which `held_out_reason` refuses more than the board's motion."""
    arms = set()
    for kind in CLASSES.values():
        arms |= {kind.other_arm, *(as_arm(name, name) for name in kind.arms)}
        for variant in (*_BOARD_ARMS, *_PRACTICE_ARMS):
            arm = variant.of(kind.arm)
            arms |= {arm, dataclasses.replace(arm, rotor=tuple(Scale(kind, arm).rotor))}  # as it is behind springs
    return arms


_OWN_ARMS = _own_arms()


def held_out_reason(scenario: Scenario) -> str:
    """Return the reason why tuning and training may not use a scenario; empty if they may.

    A board is judged on kinds of motion, events, arms and engines that no law has been tuned for. A
    scenario is recognised by its content, whatever its name. Behind a drive with a delay or a lag,
    an arm of a class may have no minimum-jerk moves, which are the boards' motion, and no "array",
    which is the sealed test's, whatever their numbers.
    """
    reference, drive = scenario.reference, scenario.actuator
    if isinstance(reference, MinimumJerk) and reference.points is None and (reference.low, reference.high) == BOX:
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
