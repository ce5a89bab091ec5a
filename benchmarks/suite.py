"""Cells as data: which policy meets which scenario with which seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import controllers
from fbl_gym import scenarios
from fbl_gym.records import unknown


@dataclass(frozen=True)
class Cell:
    """One policy on one scenario over a batch of seeds.

    Args:
        policy: its name.
        scenario: its name.
        seeds: every policy meets the same, so that comparisons are paired.
    """

    policy: str
    scenario: str
    seeds: tuple[int, ...]

    @property
    def id(self) -> str:
        """A readable name that leads to the settings, such as "cascade-flm/mass-error-2"."""
        return f"{self.policy}/{self.scenario}"


def leaderboard_scenarios(arms: Sequence[str] = ()) -> list[str]:
    """The names of the leaderboard's scenarios: for each arm the nominal one, then every family at severities 1 to 3."""
    names = []
    for arm in arms or scenarios.arms():
        names.append(scenarios.family("nominal", 0, arm).name)
        for family in scenarios.families():
            if family != "nominal":
                names.extend(scenarios.family(family, severity, arm).name for severity in scenarios.SEVERITIES[1:])
    return names


def leaderboard(
    policies: Sequence[str] = (), scenario_names: Sequence[str] = (), seeds: Sequence[int] = tuple(range(32))
) -> list[Cell]:
    """The cells of the leaderboard, or of a part of it.

    Args:
        policies: names; empty: all.
        scenario_names: names of scenarios, or of families, which stand for all their severities on both arms; empty: all.
        seeds: of every cell.
    """
    known = controllers.names()
    for policy in policies:
        if policy not in known:
            raise unknown("policy", policy, known)
    wanted: list[str] = []
    for name in scenario_names:
        members = [s for s in leaderboard_scenarios() if s.rpartition("/")[2].rpartition("-")[0] == name]
        wanted.extend(members or [scenarios.get(name).name])
    chosen = wanted or leaderboard_scenarios()
    return [Cell(policy, scenario, tuple(seeds)) for scenario in chosen for policy in policies or known]
