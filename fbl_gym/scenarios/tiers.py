"""The tiers of the leaderboards' scenarios, all in one place."""

from collections.abc import Collection

from fbl_gym.model.arm import ArmParameters
from fbl_gym.records.checks import check_choice
from fbl_gym.scenarios import class_tiers, ideal
from fbl_gym.scenarios.families import Member
from fbl_gym.scenarios.scenario import Scenario

_TIERS = {"ideal": ideal.TIER, **class_tiers.TIERS}

TIERS = {name: tier.text for name, tier in _TIERS.items()}
"""The tiers, each with one line."""

SEVERITIES = ideal.TIER.severities

MEMBERS = {name: member for tier in _TIERS for name, member in _TIERS[tier].members(tier).items()}
"""Family, severity and tier of each scenario of a tier, by name."""


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


def tier_scenario(name: str, arm: ArmParameters | None = None) -> Scenario:
    """Return the scenario of a name of `MEMBERS`.

    Args:
        name: its name.
        arm: another nominal arm, whose weight and inertia all torques of a class of robots follow.
    """
    family, severity, tier = MEMBERS[name]
    return Scenario(name=name, **_TIERS[tier].options(family, severity, arm))
