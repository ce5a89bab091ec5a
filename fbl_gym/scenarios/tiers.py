"""The tiers of the leaderboards' scenarios, all in one place.

The tier `ideal`, of the paper's assumptions, is in `ideal.toml`. Each class of robots has three
more, see `class_tiers.py`.
"""

import functools
import tomllib
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple

from fbl_gym.model.arm import TABLE_1, ArmParameters
from fbl_gym.records.checks import check_choice
from fbl_gym.records.record import merged
from fbl_gym.scenarios import class_families, class_tiers
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.scenario import Scenario


class Member(NamedTuple):
    """The place of a scenario in the tiers.

    Attributes:
        family: its family.
        severity: 0 to 3.
        tier: one of `TIERS`.
    """

    family: str
    severity: int
    tier: str


class _Tier(NamedTuple):
    """A tier of scenarios.

    Attributes:
        text: one line.
        single: names of its families without severities.
        graded: of those with severities.
        severities: of the graded families.
        options: returns fields of `Scenario` for a family, a severity and an arm; None: the tier's.
    """

    text: str
    single: Collection[str]
    graded: Collection[str]
    severities: tuple[int, ...]
    options: Callable[[str, int, ArmParameters | None], dict[str, Any]]


_IDEAL = tomllib.loads(Path(__file__).with_name("ideal.toml").read_text(encoding="utf-8"))

SEVERITIES = (0, 1, 2, 3)


def families() -> dict[str, str]:
    """Return the description of each family of the tier `ideal`, by name."""
    return {name: family["text"] for name, family in _IDEAL.items()}


def _ideal(family: str, severity: int, arm: ArmParameters | None) -> dict[str, Any]:
    names = _IDEAL[family].get("combines", [family]) if severity > 0 else ()
    pushed = (_IDEAL[name]["severities"][severity - 1] for name in names)
    return functools.reduce(merged, pushed, {"arm": arm or TABLE_1, "description": _IDEAL[family]["text"]})


def _tiers() -> dict[str, _Tier]:
    """Return the tier `ideal`, and all boards, surprises and practices."""
    text = "the paper's assumptions: no delay, no lag, exact sensors; one kind of uncertainty in each family"
    graded = [family for family in _IDEAL if family != "nominal"]
    boards, surprises, practices = {"ideal": _Tier(text, ("nominal",), graded, SEVERITIES, _ideal)}, {}, {}
    for robot, kind in CLASSES.items():
        known, partial = class_families.families(robot), functools.partial
        boards[robot] = _Tier(kind.text, ("nominal", *kind.arms), known, (1, 2, 3), partial(class_tiers.board, robot))
        text = f"{robot}: the arm changes during the episode, or is another one"
        surprises[f"{robot}-surprise"] = _Tier(text, kind.surprises, (), (), partial(class_tiers.surprise, robot))
        text = f"{robot}: for tuning and training, with another motion"
        practices[f"{robot}-practice"] = _Tier(text, ("nominal",), known, (1, 3), partial(class_tiers.practice, robot))
    return boards | surprises | practices


_TIERS = _tiers()

#: The tiers, each with one line.
TIERS = {name: tier.text for name, tier in _TIERS.items()}

#: Family, severity and tier of each scenario of a tier, by name.
MEMBERS: dict[str, Member] = {}

for _name, _tier in _TIERS.items():
    _first = "" if _name == "ideal" else f"{_name}-"
    MEMBERS |= {_first + family: Member(family, 0, _name) for family in _tier.single}
    for _family in _tier.graded:
        MEMBERS |= {f"{_first}{_family}-{k}": Member(_family, k, _name) for k in _tier.severities}


def in_tier(tier: str, severities: Collection[int] = SEVERITIES[1:]) -> tuple[str, ...]:
    """Return the names of the scenarios of one of `TIERS`.

    Of the families with severities, it has those of the given ones.
    """
    single = _TIERS[check_choice("tier", tier, TIERS)].single
    members = ((name, member) for name, member in MEMBERS.items() if member.tier == tier)
    return tuple(name for name, member in members if member.family in single or member.severity in severities)


def member(name: str) -> Member | None:
    """Return family, severity and tier of a scenario; None if it belongs to no tier.

    The name may end in a world: "noise-2@mujoco".
    """
    return MEMBERS.get(name.partition("@")[0])


def tier_scenario(name: str, arm: ArmParameters | None = None, **options: Any) -> Scenario:
    """Return the scenario of a name of `MEMBERS`.

    Args:
        name: its name.
        arm: another nominal arm, whose weight and inertia all torques of a class of robots follow.
        **options: fields of `Scenario` that replace those of the tier.
    """
    family, severity, tier = MEMBERS[name]
    return Scenario(name=name, **_TIERS[tier].options(family, severity, arm) | options)
