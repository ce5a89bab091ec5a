"""Cells as data, each one policy on one scenario over a batch of seeds; and suites."""

import contextlib
import dataclasses
import functools
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import controllers
from benchmarks.agents.policy import best_seed, shipped
from benchmarks.policies.isolation import CallLimits
from benchmarks.policies.key import data_digest
from benchmarks.policies.spec import PolicySpec, names, resolve
from benchmarks.seeds import SPLITS
from benchmarks.text import reason_of
from controllers.name import PolicyName
from fbl_gym import Scenario, scenarios
from fbl_gym.reading import read_bytes
from fbl_gym.records.checks import check_choice, check_whole, unknown
from fbl_gym.records.record import merged, naming, set_fields
from fbl_gym.scenarios import as_scenario
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.files import from_table, read_toml
from fbl_gym.scenarios.files import split as split_file


@dataclass(frozen=True)
class Cell:
    """One policy on one scenario over a batch of seeds.

    Args:
        policy: its specification, or the text that names it.
        scenario: a Scenario, its name, or the plain data that makes one.
        seeds: every policy meets the same ones, so comparisons are paired.
    """

    policy: PolicySpec
    scenario: Scenario
    seeds: tuple[int, ...]

    def __post_init__(self) -> None:
        set_fields(self, policy=resolve(self.policy), scenario=as_scenario(self.scenario), seeds=tuple(self.seeds))

    @property
    def id(self) -> str:
        """Policy and scenario, such as "cascade-flm/mass-error-2"."""
        return f"{self.policy.name}/{self.scenario.name}"

    @cached_property
    def identity(self) -> dict[str, Any]:
        """All that the cell's numbers depend on, as plain data."""
        policy = self.policy.identity
        robot = self.policy.parsed.robot_of(self.scenario.robot_class)
        return {
            **policy,
            "tuned": policy["tuned"].get(robot, {}),
            "scenario": plain_options(self.scenario, "description"),
            "seeds": list(self.seeds),
            **({"packages": versions(self.packages)} if self.packages else {}),
        }

    @property
    def packages(self) -> tuple[str, ...]:
        """Names of the packages of extras that compute its numbers."""
        return (*self.policy.packages, *(("mujoco",) if self.scenario.plant is not None else ()))

    @cached_property
    def key(self) -> str:
        """Hash of the cell's identity, 20 hexadecimal digits."""
        return data_digest(self.identity)[:20]


@functools.cache
def versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Return the version of each package, or "absent"."""
    known = dict.fromkeys(packages, "absent")
    for package in packages:
        with contextlib.suppress(metadata.PackageNotFoundError):
            known[package] = metadata.version(package)
    return known


def plain_options(scenario: Scenario, *without: str) -> dict[str, Any]:
    """Return a scenario's options as plain data, without some of them."""
    return {name: value for name, value in scenario.to_dict().items() if name not in without}


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
    """

    name: str
    policies: tuple[PolicySpec | PolicyName | str, ...]
    scenarios: tuple[Scenario, ...]
    seeds: int

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


def training(folder: Path) -> tuple[str, int]:
    """Return the settings of a run of `fbl-gym train` without the seed, as text, and the seed."""
    try:
        settings = json.loads(read_bytes(folder / "run.json"))
        seed = settings.pop("seed")
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as problem:
        raise ValueError(f"{folder / 'run.json'} must be as fbl-gym train writes it ({reason_of(problem)})") from None
    return json.dumps(settings, sort_keys=True), seed


def members(
    policies: Iterable[PolicySpec | PolicyName | str], limits: CallLimits | None = None
) -> tuple[PolicySpec, ...]:
    """Return the members of a board's policies, each with its rows.

    The members of a shipped agent are its training seeds, first that with the smallest validation
    error. Folders of `fbl-gym train` whose settings differ in the seed alone are members of one
    row, with the name of the first folder without the seed at its end; a second folder of the same
    settings and seed is a row of its own. Any other policy is its only member. NAME and NAME@0 are
    two rows, both of which have the member NAME@0. `limits` are those of loading a policy.
    """
    rows: dict[str, tuple[PolicySpec, ...]] = {}
    runs: dict[str, dict[int, PolicySpec]] = {}
    given = dict.fromkeys(resolve(policy, limits) for policy in policies)
    for spec in given:
        if spec.name in shipped():
            best = best_seed(spec.name)
            seeds = (best, *(seed for seed in shipped()[spec.name] if seed != best))
            rows[spec.name] = tuple(resolve(dataclasses.replace(spec.parsed, seed=seed)) for seed in seeds)
            continue
        if spec.parsed.form == "folder" and Path(spec.name, "run.json").is_file():
            settings, seed = training(Path(spec.name))
            if runs.setdefault(settings, {}).setdefault(seed, spec) is spec:
                continue
        for row in spec.rows or (spec.name,):
            rows[row] = (*rows.get(row, ()), spec)
    for run in runs.values():
        seed, spec = next(iter(run.items()))
        name = spec.name.removesuffix(f"-{seed}") if len(run) > 1 else spec.name
        taken = name in rows or any(name == other.name for other in given)
        rows[spec.name if taken else name] = tuple(run.values())
    specs = dict.fromkeys(spec for row in rows.values() for spec in row)
    return tuple(dataclasses.replace(spec, rows=tuple(row for row in rows if spec in rows[row])) for spec in specs)


def distinguish(tasks: Sequence[Scenario]) -> tuple[Scenario, ...]:
    """Return the scenarios, each once, and distinct names for those that share one.

    A name is kept by the scenario that the package has under it, or else by the first one.
    """
    owners: dict[str, str] = {}
    distinct: dict[tuple[str, str], Scenario] = {}
    for task in tasks:
        usual = scenarios.get(task.name) if task.name in scenarios.names() else task
        content, first = (data_digest(plain_options(each, "name", "description")) for each in (task, usual))
        own = owners.setdefault(task.name, first) == content
        distinct[task.name, content] = task if own else task.replace(name=f"{task.name}~{content[:6]}")
    return tuple(distinct.values())


def with_option(scenario: Scenario, option: str, value: float) -> Scenario:
    """Return the scenario with another value of an option, which becomes part of its name.

    `option` is its path, such as "noise.position", as `fbl-gym list options` prints it.
    """
    changes: Any = value
    for part in reversed(option.split(".")):
        changes = {part: changes}
    name = f"{scenario.name},{option}={value:g}"
    with naming(changes):
        return Scenario.from_dict({**merged(scenario.to_dict(), changes), "name": name})


PAPER = ("pid-flm", "cascade-flm", "robust-flm", "adaptive-flm")
"""The paper's controllers. They appear as printed, too, where they have tuned gains."""


@dataclass(frozen=True)
class SuiteSpec:
    """A suite as data. Nothing is built before `build`.

    Args:
        name: of the suite.
        meaning: one line.
        tiers: severities of the families of each tier.
        without: laws and agents that are left out of all policies, the tuned ones too.
        policies: their names; empty: all, tuned where they can be.
        tasks: names, families, files and tables of further scenarios.
        seeds: how many of the test seeds.
        robot: class of robots with whose gains laws are tuned.
        short: names of the scenarios of its short form.
        file: that describes the suite; None: it is one of `SUITES`.
    """

    name: str
    meaning: str = ""
    tiers: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    policies: tuple[PolicyName, ...] = ()
    tasks: tuple[Any, ...] = ()
    seeds: int = 32
    robot: str = "servo"
    short: tuple[str, ...] = ()
    file: Path | None = None

    @property
    def policy_names(self) -> tuple[str | PolicyName, ...]:
        """The names of its policies, or the texts of them."""
        tuned = {PolicyName.parse(name).law for name in controllers.tuned(self.robot)}
        return self.policies or tuple(
            name for name in names()
            if (law := PolicyName.parse(name)).source not in self.without
            and (law.law in tuned if law.tuned else name in PAPER or name not in tuned)
        )  # fmt: skip

    @property
    def scenarios(self) -> tuple[Scenario, ...]:
        """The scenarios of its tiers, and its tasks."""
        members = [name for tier, severities in self.tiers.items() for name in scenarios.in_tier(tier, severities)]
        tasks = [
            from_table(task, self.file) if isinstance(task, dict)
            else str(self.file.parent / task) if self.file and split_file(task)[0]
            else task
            for task in self.tasks
        ]  # fmt: skip
        return expand([*members, *tasks])

    def build(
        self, policies: Sequence[PolicySpec | PolicyName | str] = (), tasks: Sequence[str | Mapping[str, Any] | Scenario] = (),
        seeds: int | None = None, *, short: bool = False, more: Sequence[PolicySpec | PolicyName | str] = (),
        limits: CallLimits | None = None,
    ) -> Suite:  # fmt: skip
        """Return the suite of a board: with the `members` of its policies.

        Args:
            policies: instead of the suite's; empty: these.
            tasks: scenarios and families instead of the suite's; empty: these.
            seeds: of every scenario, instead of the suite's.
            short: a few of the suite's scenarios, with 8 seeds.
            more: policies to add.
            limits: of loading an external policy.
        """
        chosen = expand(tasks or (self.short if short else ())) or self.scenarios
        seeds = SHORT_SEEDS if short and seeds is None else seeds
        specs = members((*(policies or self.policy_names), *more), limits)
        return Suite(self.name, specs, chosen, self.seeds if seeds is None else seeds)


SHORT_SEEDS = 8
"""Seeds of a suite's short form."""

NEEDS_ACCELERATION = ("crossq", "ppo-memory", "ppo-torque", "sac", "td3", "tqc")
"""Agents that were trained with an accelerometer, which the classes of robots lack."""

_SINGLE = ("computed-torque-ilc",)  # it learns over trials; in one, it is computed torque
_PLANNED = "oracle-planned"  # it only differs from oracle-elastic where drives reach their limits

SUITES: dict[str, SuiteSpec] = {
    spec.name: spec
    for spec in (
        *(
            SuiteSpec(
                robot, f"{kind.text}; every policy, tuned where it can be, severity 2 and surprise, 32 seeds",
                {robot: (2,), f"{robot}-surprise": (2,)}, (*_SINGLE, _PLANNED, *NEEDS_ACCELERATION),
                robot=robot, short=(f"{robot}-nominal", f"{robot}-everything-2", f"{robot}-surprise-payload"),
            )
            for robot, kind in CLASSES.items()
        ),
        SuiteSpec(
            "ideal", "every policy, tuned where it can be, on the paper's assumptions at severity 2, 32 seeds",
            {"ideal": (2,)}, (*_SINGLE, _PLANNED),
        ),
    )
}  # fmt: skip


def load(name: str, trust: bool = False) -> SuiteSpec:
    """Return a suite by name, or from a TOML file.

    Args:
        trust: True allows the code of policies that the file names to run.
        name: one of `SUITES`, or the path of a file that ends in .toml. The file has `policies` and
            `scenarios` (names, families, files, or tables with the options of a scenario and
            perhaps a `base`), and may have `seeds` (64).
    """
    path = Path(name)
    if path.suffix != ".toml":
        if name not in SUITES:
            raise unknown("suite", name, SUITES)
        return SUITES[name]
    data = read_toml(path)
    entries = ("policies", "scenarios", "seeds")
    for key in data:
        check_choice(f"entry of {path}", key, entries)
    policies, tasks = data.get("policies", [*names()]), data.get("scenarios", list(scenarios.in_tier("ideal")))
    if not policies or not isinstance(policies, list) or not all(isinstance(policy, str) for policy in policies):
        raise ValueError(f"policies of {path} must be a list of names, got {policies!r}; without it, all are meant")
    if not tasks or not isinstance(tasks, list) or not all(isinstance(task, str | dict) for task in tasks):
        raise ValueError(f"scenarios of {path} must be a list of names and tables, got {tasks!r}")
    given = tuple(PolicyName.parse(policy, str(path), trust) for policy in policies)
    return SuiteSpec(path.stem, policies=given, tasks=tuple(tasks), seeds=data.get("seeds", 64), file=path)


def expand(tasks: Sequence[str | Mapping[str, Any] | Scenario]) -> tuple[Scenario, ...]:
    """Return the scenarios of all that `as_scenario` takes, and of names of families.

    A family such as "noise" or "servo-noise" stands for its severities 1 to 3.
    """
    chosen: list[Scenario] = []
    for name in tasks:
        if not isinstance(name, str) or split_file(name)[0] or name.partition("@")[0] in scenarios.names():
            chosen.append(as_scenario(name))
            continue
        family = [member for tier in scenarios.TIERS for member in scenarios.in_tier(tier) if member[:-2] == name]
        if not family:
            raise unknown("scenario or family", name, (*scenarios.families(), *scenarios.names()))
        chosen.extend(map(scenarios.get, family))
    return tuple(chosen)
