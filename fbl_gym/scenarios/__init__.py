"""Scenarios by name: the paper's figures and the families of the leaderboard.

`get(name)` returns a scenario of the paper (`paper-3a` to `paper-10`), of a laboratory's arm
(`dfki-c1`, `dfki-a0`, `cicese`) or of a family (`nominal`, `mass-error-0` to `everything-3`).
`Scenario` describes any other task.
"""

from __future__ import annotations

from typing import Any

from fbl_gym.checks import unknown
from fbl_gym.plants import WORLDS
from fbl_gym.records import build
from fbl_gym.scenarios.families import MEMBERS, SEVERITIES, Member, arms, families, family, member
from fbl_gym.scenarios.paper import FIGURES
from fbl_gym.scenarios.real import REAL
from fbl_gym.scenarios.scenario import Scenario
from fbl_gym.scenarios.worlds import in_world

__all__ = [
    "SEVERITIES",
    "WORLDS",
    "Member",
    "Scenario",
    "arms",
    "as_scenario",
    "families",
    "family",
    "get",
    "in_world",
    "member",
    "names",
]


def names() -> tuple[str, ...]:
    """Return every name that `get` knows: the paper's figures, laboratories' arms, families."""
    return (*FIGURES, *REAL, *MEMBERS)


def get(name: str) -> Scenario:
    """Return the scenario of a name.

    Args:
        name: one of `names()`, and optionally "@" and one of `WORLDS`: "everything-2@mujoco-bend".
    """
    name, _, world = name.partition("@")
    if world:
        return in_world(get(name), world)
    if name in FIGURES or name in REAL:
        return (FIGURES | REAL)[name]
    if name in MEMBERS:
        return family(*MEMBERS[name])
    severities = [f"{name}-{severity}" for severity in SEVERITIES]
    if severities[0] in MEMBERS:
        raise ValueError(f"scenario {name!r} needs a severity: {', '.join(severities[:-1])} or {severities[-1]}")
    raise unknown("scenario", name, names())


def as_scenario(value: Any) -> Scenario:
    """Return a scenario from itself, its name or its plain data; None: the nominal one.

    Args:
        value: the value given.
    """
    if value is None:
        return Scenario()
    if isinstance(value, str):
        return get(value)
    return build("scenario", value, Scenario)
