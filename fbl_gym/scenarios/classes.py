"""Classes of robots, which ask for different laws: `servo`, `direct` and `geared`.

A class has an arm of its size, its rate, drives, sensors and friction. Each episode draws their
numbers. The numbers of a class, and their sources, are in its TOML file beside `common.toml`.
Torques are multiples of the arm's own weight and inertia, so that `class_families.conditions` makes
the same task of any arm.
"""

import functools
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fbl_gym.model.arm import ArmParameters
from fbl_gym.records.record import merged
from fbl_gym.scenarios.scenario import as_arm


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
        texts: the description of each family, with the name of each number in braces.
        surprises: the description of each surprise.
        springs: arguments of `Scale.springs` of `class_families.py`; empty: rigid joints.
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
    texts: Mapping[str, str]
    surprises: Mapping[str, str]
    springs: Mapping[str, Any] = {}
    arms: Mapping[str, Mapping[str, Any]] = {}

    @property
    def control_dt(self) -> float:
        """Return the time between two decisions [s]."""
        return self.scenario["control_dt"]


def _load(robot: str) -> RobotClass:
    """Return the class of a TOML file."""
    files = (Path(__file__).with_name(f"{name}.toml") for name in ("common", robot))
    table = functools.reduce(merged, (tomllib.loads(file.read_text(encoding="utf-8")) for file in files))
    return RobotClass(**{**table, **{name: as_arm(name, table[name]) for name in ("arm", "other_arm")}})


#: The classes of robots, by name.
CLASSES = {robot: _load(robot) for robot in ("servo", "direct", "geared")}
