"""Suites as data: which policies on which scenarios with how many seeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import controllers
from benchmarks.policies.isolation import CallLimits
from benchmarks.policies.spec import PolicyLike, names, resolve
from benchmarks.run.cell import Cell
from benchmarks.run.expansion import distinguish, expand, members
from benchmarks.seeds import SPLITS
from controllers.name import PolicyName
from fbl_gym import Scenario, scenarios
from fbl_gym.records.checks import check_choice, check_whole
from fbl_gym.records.record import set_fields
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.files import from_table, read_toml
from fbl_gym.scenarios.files import split as split_file


@dataclass(frozen=True)
class Suite:
    """A set of cells: every policy on every scenario with the same seeds.

    Scenarios that share a name and differ in an option get distinct names, such as
    "nominal~3f9a20". A scenario or policy that is given twice counts once.

    Args:
        name: of the suite.
        policies: their specifications, or the texts that name them.
        scenarios: the tasks.
        seeds: how many of the test seeds, from 0 on.
        short: names of the scenarios of its short form.
    """

    name: str
    policies: tuple[PolicyLike, ...]
    scenarios: tuple[Scenario, ...]
    seeds: int = 32
    short: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        set_fields(
            self, policies=tuple(dict.fromkeys(self.policies)), scenarios=distinguish(self.scenarios),
            seeds=check_whole("seeds", self.seeds, low=1, high=len(SPLITS["test"])),
        )  # fmt: skip

    @cached_property
    def cells(self) -> list[Cell]:
        """The cells, scenario by scenario, each with every policy."""
        policies, seeds = [*map(resolve, self.policies)], tuple(SPLITS["test"][: self.seeds])
        return [Cell(policy, task, seeds) for task in self.scenarios for policy in policies]

    def build(
        self, policies: Sequence[PolicyLike] = (), tasks: Sequence[str | Mapping[str, Any] | Scenario] = (),
        seeds: int | None = None, *, short: bool = False, more: Sequence[PolicyLike] = (), limits: CallLimits | None = None,
    ) -> "Suite":  # fmt: skip
        """Return the suite of a board: with the `members` of its policies.

        Args:
            policies: instead of the suite's; empty: these.
            tasks: scenarios and families instead of the suite's; empty: these.
            seeds: of every scenario, instead of the suite's.
            short: a few of the suite's scenarios, with 8 seeds, and each agent's best seed.
            more: policies to add.
            limits: of loading an external policy.
        """
        chosen = expand(tasks or (self.short if short else ())) or self.scenarios
        seeds = SHORT_SEEDS if short and seeds is None else seeds
        specs = members((*(policies or self.policies), *more), limits, short=short)
        return replace(self, policies=specs, scenarios=chosen, seeds=self.seeds if seeds is None else seeds)


#: Seeds of a suite's short form.
SHORT_SEEDS = 8

#: Agents that were trained with an accelerometer, which the classes of robots lack.
NEEDS_ACCELERATION = ("crossq", "sac", "td3", "tqc")

#: Laws for repeated trials, and for another goal than the reference.
OTHER_TASKS = ("computed-torque-ilc", "swing-up")

#: The paper's controllers. They appear as printed, too, where they have tuned gains.
PAPER = ("pid-flm", "cascade-flm", "robust-flm", "adaptive-flm")

#: The built-in suites, each with one line on it.
SUITES = {
    robot: f"{kind.text}; every policy, tuned where it can be, severity 2 and surprise, 32 seeds"
    for robot, kind in CLASSES.items()
} | {"ideal": "every policy, tuned where it can be, on the paper's assumptions at severity 2, 32 seeds"}


def _built_in(name: str) -> Suite:
    """Return one of `SUITES`; that of a class of robots has the class's tuned gains."""
    of_class = name in CLASSES
    # oracle-planned only differs from oracle-elastic where drives reach their limits.
    without = (*OTHER_TASKS, "oracle-planned", *(NEEDS_ACCELERATION if of_class else ()))
    tuned = {PolicyName.parse(each).law for each in controllers.tuned(name if of_class else "servo")}
    policies = tuple(
        each for each in names()
        if (law := PolicyName.parse(each)).source not in without
        and (law.law in tuned if law.tuned else each in PAPER or each not in tuned)
    )  # fmt: skip
    tiers = (name, f"{name}-surprise") if of_class else (name,)
    tasks = tuple(task for tier in tiers for task in scenarios.in_tier(tier, (2,)))
    short = tuple(f"{name}-{family}" for family in ("nominal", "everything-2", "surprise-payload"))
    return Suite(name, policies, expand(tasks), short=short if of_class else ())


def load(name: str, trust: bool = False) -> Suite:
    """Return a suite by name, or from a TOML file.

    Args:
        trust: True allows the code of policies that the file names to run.
        name: one of `SUITES`, or the path of a file that ends in .toml. The file has `policies` and
            `scenarios` (names, families, files, or tables with the options of a scenario and
            perhaps a `base`), and may have `seeds` (64).
    """
    path = Path(name)
    if path.suffix != ".toml":
        return _built_in(check_choice("suite", name, SUITES))
    if not (data := read_toml(path)):
        raise ValueError(f"{path} must have policies, scenarios or both, but it is empty")
    for key in data:
        check_choice(f"entry of {path}", key, ("policies", "scenarios", "seeds"))
    policies, tasks = data.get("policies", [*names()]), data.get("scenarios", list(scenarios.in_tier("ideal")))
    if not policies or not isinstance(policies, list) or not all(isinstance(policy, str) for policy in policies):
        raise ValueError(f"policies of {path} must be a list of names, got {policies!r}; without it, all are meant")
    if not tasks or not isinstance(tasks, list) or not all(isinstance(task, str | dict) for task in tasks):
        raise ValueError(f"scenarios of {path} must be a list of names and tables, got {tasks!r}")
    given = tuple(PolicyName.parse(policy, str(path), trust) for policy in policies)
    built = tuple(
        from_table(task, path) if isinstance(task, dict) else str(path.parent / task) if split_file(task)[0] else task
        for task in tasks
    )
    return Suite(path.stem, given, expand(built), data.get("seeds", 64))
