"""Cells as data: which policy meets which scenario with which seeds; and the suites that have names."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.policies import resolve
from fbl_gym import Scenario, scenarios
from fbl_gym.checks import check_number, check_whole, unknown
from fbl_gym.records import set_fields
from fbl_gym.scenarios import as_scenario

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SPLITS: dict[str, range] = {
    "test": range(0, 10_000),
    "tuning": range(10_000, 20_000),
    "validation": range(20_000, 30_000),
    "training": range(1_000_000, 2**31),
}
"""Which seeds may be used for what. The board is measured on `test`, which nothing that tunes or trains may touch."""


@dataclass(frozen=True)
class Cell:
    """One policy on one scenario over a batch of seeds.

    Args:
        policy: a name, or what else `resolve.load` understands.
        scenario: a Scenario, its name, or the plain data that makes one.
        seeds: every policy meets the same, so that comparisons are paired.
    """

    policy: str
    scenario: Scenario
    seeds: tuple[int, ...]

    def __post_init__(self) -> None:
        set_fields(self, scenario=as_scenario(self.scenario), seeds=tuple(self.seeds))

    @property
    def id(self) -> str:
        """A readable name that leads to the settings, such as "cascade-flm/mass-error-2"."""
        return f"{self.policy}/{self.scenario.name}"


@dataclass(frozen=True)
class Suite:
    """A set of cells: every policy on every scenario with the same seeds.

    Args:
        name: of the suite.
        policies: what the cells' policies are.
        scenarios: likewise.
        seeds: how many of the test seeds, from 0 on.
    """

    name: str
    policies: tuple[str, ...]
    scenarios: tuple[Scenario, ...]
    seeds: int

    def __post_init__(self) -> None:
        set_fields(self, seeds=check_whole("seeds", self.seeds, low=1))
        if self.seeds > len(SPLITS["test"]):
            raise ValueError(f"seeds must be at most {len(SPLITS['test'])}, the test seeds there are, got {self.seeds}")

    @property
    def cells(self) -> list[Cell]:
        """Scenario by scenario, each with every policy."""
        seeds = tuple(SPLITS["test"][: self.seeds])
        return [Cell(policy, scenario, seeds) for scenario in self.scenarios for policy in self.policies]


def leaderboard_scenarios(arms: Sequence[str] = (), severities: Sequence[int] = scenarios.SEVERITIES[1:]) -> list[str]:
    """The names of the leaderboard's scenarios: for each arm the nominal one, then every family at the severities.

    Args:
        arms: out of `scenarios.arms()`; empty: all.
        severities: 0 to 3 each.
    """
    names = []
    for arm in arms or scenarios.arms():
        names.append(scenarios.family("nominal", 0, arm).name)
        for family in scenarios.families():
            if family != "nominal":
                names.extend(scenarios.family(family, severity, arm).name for severity in severities)
    return names


PAPER = ("pid-flm", "cascade-flm", "robust-flm", "adaptive-flm")
"""The paper's own controllers."""

SUITES: dict[str, str] = {
    "quick": "every policy, tuned where it can be, on every family at severity 2, Table 1's arm, 100 Hz, 32 seeds",
    "full": "every policy on every family and severity, both arms, 100 Hz, 256 seeds",
    "kilohertz": "every classical policy on every family at severity 2, Table 1's arm, 1 kHz, 64 seeds: what the rate buys",
}
"""The suites that have names, with a line each."""


def at_rate(scenario: Scenario, control_dt: float) -> Scenario:
    """The scenario at another rate, which its name then tells.  scenario: to change; control_dt: time between decisions [s]."""
    name = scenario.name if control_dt == scenario.control_dt else f"{scenario.name}@{1.0 / control_dt:g}Hz"
    return scenario.replace(control_dt=control_dt, physics_dt=min(scenario.physics_dt, control_dt), name=name)


def named(name: str) -> Suite:
    """The suite of that name.  name: one of `SUITES`."""
    if name not in SUITES:
        raise unknown("suite", name, SUITES)
    policies = resolve.names()
    if name == "full":
        return Suite(name, policies, tuple(map(scenarios.get, leaderboard_scenarios())), 256)
    members = [scenarios.get(s) for s in leaderboard_scenarios(["table-1"], [2])]
    if name == "quick":
        # A law with tuned gains appears with them; the paper's own appear as printed too.
        shown = tuple(p for p in policies if f"{p}@tuned" not in policies or p in PAPER)
        return Suite(name, shown, tuple(members), 32)
    classical = tuple(policy for policy in policies if not resolve.learned(policy))
    return Suite(name, classical, tuple(at_rate(scenario, 1e-3) for scenario in members), 64)


def load(name: str) -> Suite:
    """A suite by name, or from a TOML file.

    Args:
        name: one of `SUITES`, or the path of a file that ends in .toml. The file has `policies` and `scenarios` (names,
            families, or tables with the options of a scenario), and may have `seeds` (64) and `control_dt` [s] for all.
    """
    path = Path(name)
    if path.suffix != ".toml":
        return named(name)
    with path.open("rb") as file:
        try:
            data = tomllib.load(file)
        except tomllib.TOMLDecodeError as problem:
            raise ValueError(f"{path} is no TOML: {problem}") from None
    for key in data:
        if key not in ("policies", "scenarios", "seeds", "control_dt"):
            raise unknown(f"entry of {path}", key, ("policies", "scenarios", "seeds", "control_dt"))
    suite = Suite(path.stem, resolve.names(), (), data.get("seeds", 64))
    suite = narrow(suite, data.get("policies", ()), data.get("scenarios", leaderboard_scenarios()))
    if "control_dt" in data:
        dt = check_number("control_dt", data["control_dt"], above=0)
        suite = dataclasses.replace(suite, scenarios=tuple(at_rate(scenario, dt) for scenario in suite.scenarios))
    return suite


def narrow(
    suite: Suite,
    policies: Sequence[str] = (),
    scenario_names: Sequence[str | Mapping[str, Any]] = (),
    seeds: int | None = None,
) -> Suite:
    """The suite with other policies, scenarios or seeds.

    Args:
        suite: to start from.
        policies: what `resolve.load` understands; empty: the suite's.
        scenario_names: names of scenarios, or of families, which stand for all their severities on both arms, or tables of
            options; empty: the suite's.
        seeds: how many test seeds; None: the suite's.
    """
    for policy in policies:
        resolve.check(policy)
    chosen: list[Scenario] = []
    for name in scenario_names:
        members = [s for s in leaderboard_scenarios() if _family(s) == name]
        chosen.extend(scenarios.get(s) for s in members)
        if not members and isinstance(name, str) and name.partition("@")[0] not in scenarios.names():
            raise unknown("scenario or family", name, (*scenarios.families(), *scenarios.names()))
        chosen.extend([] if members else [as_scenario(name)])
    return dataclasses.replace(
        suite,
        policies=tuple(policies) or suite.policies,
        scenarios=tuple(chosen) or suite.scenarios,
        seeds=suite.seeds if seeds is None else seeds,
    )


def _family(scenario: str) -> str:
    own = scenario.rpartition("/")[2]
    return own.rpartition("-")[0]
