"""The board: error, lost runs and rank of each policy of a suite."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.analysis import statistics
from benchmarks.policies.spec import PolicySpec
from benchmarks.run.metrics import METRICS, counted_error, penalize
from benchmarks.run.store import Result
from benchmarks.run.suite import Cell
from fbl_gym import scenarios
from fbl_gym.model.arm import Array
from fbl_gym.scenarios.classes import CLASSES

#: A board is ranked in the first of these tiers that it has.
RANKED_FIRST = (
    *CLASSES, "ideal", *(tier for tier in scenarios.TIERS if tier.endswith(("surprise", "practice"))), "worlds"
)  # fmt: skip


@dataclass(frozen=True)
class Board:
    """Runs of p policies on the same s scenarios with the same n seeds, and functions of them.

    A policy is a law, or an agent with several training seeds. The m members of the board are the
    laws and the training seeds, policy by policy. A number of an agent is the mean over its
    members. Its intervals resample members and seeds.

    Many functions take the indices of some scenarios; None stands for those of the tier that ranks.

    Args:
        rows: members of each policy [p], by the policy's name, with a result for every scenario.
        scenarios: [s] names.
        seeds: [n].
        runs: each metric, [m x s x n]. Where a policy failed, they are the motionless baseline's,
            which are NaN but for error, its scales, torque variation and divergence.
        decision_us: time of a decision of each policy, the median over scenarios [p].
        incomplete: policies that are left out, each with the reason.
        lacking: a sentence on the scenarios without results; empty: there are none.
        failed: the policies of which a member failed in some scenarios, each with the error by the
            scenario's name.
        version: hash of all that its numbers depend on: policies, scenarios, seeds and code.
    """

    rows: dict[str, tuple[PolicySpec, ...]]
    scenarios: tuple[str, ...]
    seeds: tuple[int, ...]
    runs: dict[str, Array]
    decision_us: Array
    incomplete: dict[str, str]
    lacking: str = ""
    failed: dict[str, dict[str, str]] = field(default_factory=dict)
    version: str = ""

    @property
    def policies(self) -> tuple[str, ...]:
        """Name of each policy [p]."""
        return tuple(self.rows)

    @property
    def specs(self) -> tuple[PolicySpec, ...]:
        """First member of each policy [p]."""
        return tuple(members[0] for members in self.rows.values())

    @property
    def sizes(self) -> list[int]:
        """Number of members of each policy [p]."""
        return [len(members) for members in self.rows.values()]

    @property
    def ranked(self) -> list[int]:
        """Indices of the policies that are ranked: those that do not know the truth."""
        return [i for i, spec in enumerate(self.specs) if spec.ranked]

    @property
    def oracles(self) -> list[int]:
        """Indices of the policies that know the truth and failed nowhere."""
        return [i for i, spec in enumerate(self.specs) if not spec.ranked and self.policies[i] not in self.failed]

    @property
    def tiers(self) -> dict[str, list[int]]:
        """Indices of the scenarios of each tier; the first tier is the one that ranks."""
        tiers = [tier_of(scenario) for scenario in self.scenarios]
        return {x: [i for i, tier in enumerate(tiers) if tier == x] for x in RANKED_FIRST if x in tiers}

    @cached_property
    def main(self) -> list[int]:
        """Indices of the scenarios of the tier that ranks."""
        return next(iter(self.tiers.values()))

    @property
    def families(self) -> dict[str, list[int]]:
        """Indices of the scenarios of each family, which names its tier if that does not rank."""
        tiers = ("" if k in self.main else f"{tier_of(name)} " for k, name in enumerate(self.scenarios))
        names = [tier + family_of(name) for tier, name in zip(tiers, self.scenarios, strict=True)]
        return {x: [k for k, name in enumerate(names) if name == x] for x in names}

    @property
    def gaps(self) -> list[str]:
        """Sentences on all that the board lacks; empty for a complete board."""
        left_out = [f"Left out: {policy}: {reason}" for policy, reason in self.incomplete.items()]
        return [*([f"Incomplete: {self.lacking}"] if self.lacking else []), *left_out]

    @property
    def remarks(self) -> list[str]:
        """Sentences that a reader of the board needs, `gaps` among them."""
        failed = (
            f"{policy} counts as the motionless baseline in {_and_more([*errors])}: {next(iter(errors.values()))}"
            for policy, errors in self.failed.items()
        )
        return [*failed, *self.gaps]

    def split(self, values: Array) -> list[Array]:
        """Return some values of the members [m x ...] as a list of those of each policy."""
        return np.split(values, np.cumsum(self.sizes)[:-1])

    def of_seeds(self, some: slice | Array) -> "Board":
        """Return the board of some of the seeds, which a slice or a mask [n] chooses."""
        runs = {name: values[..., some] for name, values in self.runs.items()}
        return replace(self, seeds=tuple(np.array(self.seeds)[some].tolist()), runs=runs)

    @property
    def errors(self) -> Array:
        """Mean absolute tracking error in % of the reference's amplitude, [m x s x n].

        An error below the encoder's resolution counts as the resolution.
        """
        return counted_error(self.runs)

    def geometric_mean(self, runs: Array, some: Sequence[int] | None = None) -> Array:
        """Return the geometric mean of numbers of the runs [m x s x n] for each policy, [b x p].

        The first row is of the data. Each other one draws the seeds, and the members of each
        policy, with replacement; all policies share the drawn seeds.
        """
        seeds = statistics.resample(len(self.seeds), len(self.seeds))
        members = np.hstack([statistics.resample(len(x), [*map(ord, row)]) / len(x) for row, x in self.rows.items()])
        means = statistics.mean(np.log(runs[:, self.main if some is None else some]), seeds)
        return np.exp([rows.sum(axis=0) for rows in self.split((members * means).T)]).T

    def error(self, some: Sequence[int] | None = None) -> statistics.Estimate:
        """Return the geometric mean of each policy's errors [p] %."""
        return statistics.interval(self.geometric_mean(self.errors, some))

    def penalized(self, some: Sequence[int] | None = None) -> Array:
        """Return the error of each policy, doubled for each percent of lost runs, [b x p] %."""
        return self.geometric_mean(penalize(self.errors, self.runs["diverged"]), some)

    @property
    def rank(self) -> statistics.Estimate:
        """Rank of each policy [p] by its penalized error in the tier that ranks, or NaN."""
        ranked = statistics.ranks(self.penalized()[:, self.ranked])
        every = np.full((3, len(self.rows)), np.nan)
        every[:, self.ranked] = ranked.value, ranked.low, ranked.high
        return statistics.Estimate(*every)

    @cached_property
    def order(self) -> list[int]:
        """Indices of the policies, the best first; unranked ones stand at the end."""
        level = self.penalized()[0]
        return sorted(range(len(self.rows)), key=lambda i: (not self.specs[i].ranked, level[i]))

    def times_oracle(self, some: Sequence[int] | None = None) -> Array:
        """Return the penalized error of each policy in that of the best oracle [p], or NaN."""
        level = self.penalized(some)[0]
        return level / np.fmin.reduce(level[self.oracles], initial=np.nan)

    @property
    def lost(self) -> statistics.Estimate:
        """Share of each policy's runs that diverged in the tier that ranks [p], as `proportion`."""
        flags = [runs.ravel() for runs in self.split(self.runs["diverged"][:, self.main])]
        return statistics.proportion([x.sum() for x in flags], [x.size for x in flags])

    @property
    def worst(self) -> Array:
        """The mean of each policy's largest errors, 5 % of the runs in the tier that ranks [p]."""
        return np.array([statistics.tail_mean(errors.ravel()) for errors in self.split(self.errors[:, self.main])])

    def margin(self, name: str) -> Array:
        """Return the least of a metric of margins of each policy's arms and members [p], or NaN.

        The sensitivity is the largest.
        """
        pick = np.fmax if name == "sensitivity" else np.fmin
        return np.array([pick.reduce(runs, axis=None) for runs in self.split(self.runs[name])])

    def mrad(self, some: Sequence[int] | None = None) -> Array:
        """Return the geometric mean of each policy's errors [p] mrad.

        As in `errors`, an error below the encoder's resolution counts as the resolution.
        """
        percent, least = self.runs["error_pct"], np.full_like(self.errors, 1e-9)  # of a run without any error
        runs = np.divide(self.runs["error_mrad"] * self.errors, percent, out=least, where=percent > 0)
        return np.exp([np.log(x[:, self.main if some is None else some]).mean() for x in self.split(runs)])

    @property
    def effort(self) -> Array:
        """Torque variation of each policy in that of the best oracle, the median of scenarios [p].

        NaN: there is no oracle, or one that applies no torque.
        """
        medians = self.split(np.median(self.runs["variation"][:, self.main], axis=-1))
        oracles = [i for i in self.order if i in self.oracles]
        usual = medians[oracles[0]].mean(axis=0) if oracles else np.zeros(1)
        return np.array([np.median(rows / usual, axis=-1).mean() if usual.all() else np.nan for rows in medians])


def tier_of(scenario: str) -> str:
    """Return the tier of a scenario's name; one that belongs to no tier counts as "ideal".

    A scenario in another engine's world has a tier of its own.
    """
    if scenario.partition("@")[2] in scenarios.WORLDS:
        return "worlds"
    member = scenarios.member(scenario)
    return member.tier if member else "ideal"


def family_of(scenario: str) -> str:
    """Return the family of a scenario's name; one that belongs to no family stands for itself.

    "mass-error-2@mujoco" is of the family "mass-error". The world is left out.
    """
    member = scenarios.member(scenario)
    return scenario.partition("@")[0] if member is None else member.family


def meaning_of(scenario: str) -> str:
    """Return the description of a scenario's name; one that has no tier is of a suite."""
    name = scenario.partition("@")[0]
    return scenarios.get(name).description if scenarios.member(name) else "of this suite"


def assemble(results: Sequence[Result], expected: Sequence[Cell] = ()) -> Board:
    """Return the board of a suite's results.

    Members of a row are the policies whose specifications name it in `rows`. A row with a member
    that failed in a scenario counts there as the motionless baseline, an arm at its start, and all
    its runs are lost: to give up is no better than to diverge. One with a member that failed in all
    of them, or lacks a result, is left out and named.

    Args:
        results: of cells with the same seeds.
        expected: cells that the board should have.

    Raises:
        ValueError: two different scenarios or policies share a name, seeds differ, or no policy is
            complete.
    """
    tasks = _by_name(result.cell.scenario for result in results if result.rows)
    specs = _by_name(cell.policy for cell in (*(result.cell for result in results), *expected))
    stored: dict[str, dict[str, Result]] = {name: {} for name in specs}
    for result in results:
        stored[result.cell.policy.name][result.cell.scenario.name] = result
    still = {result.cell.scenario.name: [*map(_motionless, result.rows)] for result in results if result.rows}
    members: dict[str, list[PolicySpec]] = {}
    for spec in specs.values():
        for row in spec.rows or (spec.name,):
            members.setdefault(row, []).append(spec)
    rows, incomplete, failed = {}, {}, {}
    runs, keys, decision_us = [], [], []
    for row, some in members.items():
        reasons = {spec.name: reason for spec in some if (reason := _why_left_out(stored[spec.name], tasks))}
        if reasons:
            name, reason = next(iter(reasons.items()))
            incomplete[row] = reason if len(some) == 1 else f"{name}: {reason}"
            continue
        found = [stored[spec.name][task] for spec in some for task in tasks]
        errors = {result.cell.scenario.name: result.error for result in found if result.error}
        runs += [[still[task] if task in errors else stored[spec.name][task].rows for task in tasks] for spec in some]
        keys += [result.cell.key for result in found]
        decision_us.append(np.nanmedian([result.decision_us for result in found]))
        rows[row], failed[row] = tuple(some), errors
    if not rows:
        listed = "; ".join(f"{row}: {reason}" for row, reason in incomplete.items()) or "the store has no cell"
        raise ValueError(f"there is no policy with a result for every scenario: {listed}")
    seeds = {result.cell.seeds for result in results}
    if len(seeds) > 1:
        raise ValueError(f"results must be of the same seeds, got {' and '.join(str(len(x)) for x in seeds)} seeds")
    names = dict.fromkeys(cell.scenario.name for cell in expected)
    absent = [name for name in names if name not in tasks]
    return Board(
        rows, tuple(tasks), seeds.pop(),
        runs={name: np.array([[[run[name] for run in cell] for cell in line] for line in runs]) for name in METRICS},
        decision_us=np.array(decision_us), incomplete=incomplete,
        lacking=f"{len(absent)} of {len(names)} scenarios have no results: {', '.join(absent)}" if absent else "",
        failed={row: errors for row, errors in failed.items() if errors},
        version=hashlib.sha256("".join(sorted(keys)).encode()).hexdigest()[:12],
    )  # fmt: skip


def _why_left_out(results: Mapping[str, Result], tasks: Iterable[str]) -> str:
    """Return the reason why a member with some results has no place on the board; empty: it has."""
    if results and all(result.error for result in results.values()):
        return next(iter(results.values())).error
    if not results:
        return "no result yet"
    lacking = [task for task in tasks if task not in results]
    return f"no result yet for {_and_more(lacking)}" if lacking else ""


def _motionless(row: dict[str, float]) -> dict[str, float]:
    """Return the metrics of a lost run of an arm at its start, from those of any policy's run."""
    reference = {name: row[name] for name in ("baseline_error_pct", "resolution_pct")}
    still = {"error_pct": row["baseline_error_pct"], "variation": 0.0, "diverged": 1.0}
    return dict.fromkeys(row, float("nan")) | reference | still


def _and_more(names: Sequence[str]) -> str:
    return names[0] + (f" and {len(names) - 1} more" if names[1:] else "")


def _by_name(entries: Iterable[Any]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for entry in entries:
        if named.setdefault(entry.name, entry) != entry:
            raise ValueError(f"names on a board must differ, but two different entries are named {entry.name!r}")
    return named
