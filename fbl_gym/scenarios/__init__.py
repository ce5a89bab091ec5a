"""Scenarios by name: the paper's figures, laboratories' arms and the tiers of the leaderboards.

`get(name)` returns a scenario of the paper (`paper-3a` to `paper-10`), of a laboratory's arm
(`dfki-c1`, `dfki-a0`, `cicese`) or of a tier (`nominal`, `everything-3`, `servo-delay-2`,
`direct-surprise-knock`, `geared-practice-friction-1`). `Scenario` describes any other task, which
may stand in a TOML file (`files.py`): `get("my_arm.toml")`.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from fbl_gym.options import WORLDS
from fbl_gym.records.checks import check_choice, unknown
from fbl_gym.records.record import build
from fbl_gym.scenarios import classes, files, ideal
from fbl_gym.scenarios.classes import conditions, held_out_reason
from fbl_gym.scenarios.families import Member
from fbl_gym.scenarios.ideal import SEVERITIES, families
from fbl_gym.scenarios.paper import FIGURES
from fbl_gym.scenarios.real import REAL
from fbl_gym.scenarios.scenario import Scenario
from fbl_gym.scenarios.worlds import in_world

__all__ = [
    "SEVERITIES", "TIERS", "WORLDS", "Member", "Scenario", "as_scenario", "conditions", "families", "get",
    "held_out_reason", "in_tier", "in_world", "member", "names",
]  # fmt: skip

TIERS = {
    "ideal": "the paper's assumptions: no delay, no lag, exact sensors; one kind of uncertainty in each family",
    **{robot: kind.text for robot, kind in classes.CLASSES.items()},
    **{
        f"{robot}-surprise": f"{robot}: the arm changes during the episode, or is another one"
        for robot in classes.CLASSES
    },
    **{f"{robot}-practice": f"{robot}: for tuning and training, with another motion" for robot in classes.CLASSES},
}
"""The tiers of the leaderboards' scenarios, each with one line."""

_MEMBERS = ideal.MEMBERS | classes.MEMBERS


def names() -> tuple[str, ...]:
    """Return every name that `get` knows: the paper's figures, laboratories' arms, tiers."""
    return (*FIGURES, *REAL, *_MEMBERS)


def in_tier(tier: str, severities: Collection[int] = SEVERITIES[1:]) -> tuple[str, ...]:
    """Return the names of the scenarios of one of `TIERS`.

    Of the families, it has those of the given severities.
    """
    check_choice("tier", tier, TIERS)
    return tuple(
        name
        for name, member in _MEMBERS.items()
        if member.tier == tier and (member.severity in severities or (member.severity == 0 and name[-2:] != "-0"))
    )


def member(name: str) -> Member | None:
    """Return family, severity and tier of a scenario; None if it belongs to no tier.

    The name may end in a world: "noise-2@mujoco".
    """
    return _MEMBERS.get(name.partition("@")[0])


def get(name: str) -> Scenario:
    """Return the scenario of a name or a file.

    Args:
        name: one of `names()`; the TOML file of a scenario; or "FILE:NAME", a scenario of a suite's
            file. Each may end in "@" and one of `WORLDS`: "everything-2@mujoco-lab".
    """
    path, entry, world = files.split(name)
    if path:
        scenario = files.load(Path(path), entry, get)
        return in_world(scenario, world) if world else scenario
    name, _, world = name.partition("@")
    if world:
        return in_world(get(name), world)
    if name in FIGURES or name in REAL:
        return (FIGURES | REAL)[name]
    if name in classes.MEMBERS:
        return classes.get(name)
    if name in ideal.MEMBERS:
        return ideal.get(name)
    raise unknown("scenario", name, names())


def as_scenario(value: Any) -> Scenario:
    """Return a scenario from itself, its name, its file or its plain data; None: the nominal one.

    Plain data may have a `base`, as `files.from_table` describes.
    """
    if value is None:
        return Scenario()
    if isinstance(value, str | Path):
        return get(str(value))
    if isinstance(value, Mapping) and "base" in value:
        return files.from_table(value, get)
    return build("scenario", value, Scenario)
