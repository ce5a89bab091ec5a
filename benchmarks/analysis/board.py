"""The board: score, error, diverged share, effort and rank of each policy of a suite."""

import dataclasses
import hashlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.analysis import statistics
from benchmarks.analysis.statistics import Estimate
from benchmarks.policies.spec import PolicySpec
from benchmarks.run.metrics import METRICS, counted_error
from benchmarks.run.store import Result
from benchmarks.run.suite import Cell
from fbl_gym import scenarios
from fbl_gym.model.arm import Array
from fbl_gym.scenarios.classes import CLASSES

RANKED_FIRST = (
    *CLASSES, "ideal", *(tier for tier in scenarios.TIERS if tier.endswith(("surprise", "practice"))), "worlds"
)  # fmt: skip
"""A board is ranked in the first of these tiers that it has."""

UNSCORED = "No scores: no classical law with privileged access is a ceiling on this board. Ranked by the error."
"""The remark on a board without a ceiling."""

CLEAR = 0.5
"""A ceiling errs at most CLEAR times as much as the motionless baseline."""

MOST_DIVERGED = 0.1
"""Largest share of runs that diverge for which a law can be a ceiling."""

BOOTSTRAP_SEED = 0


@dataclass(frozen=True)
class Board:
    """Results of p policies on the same s scenarios with the same n seeds.

    A policy is a law, or an agent with several training seeds. The m members of the board are the
    laws and the training seeds, policy by policy. A number of an agent is the mean over its
    members. Its intervals resample members and seeds.

    Args:
        rows: members of each policy [p], by the policy's name, with a result for every scenario.
        scenarios: [s] names.
        seeds: [n].
        runs: each metric, [m x s x n]. Where a policy failed, they are the motionless baseline's,
            which are NaN but for error, torque variation and divergence.
        decision_us: time of a decision of each policy, the median over scenarios [p].
        incomplete: policies that are left out, each with the reason.
        lacking: a sentence on the scenarios without results; empty: there are none.
        failed: the error of each policy and scenario, by index, where a member failed.
        flags: of each scenario with more seeds, by index: 1 where a run diverged [m x seeds].
        version: hash of all that its numbers depend on: policies, scenarios, seeds and code.
        partial: metrics [n] of policies that only have results in some scenarios, where they may be
            the ceiling: by the scenario's index and the policy's name. They are no rows.
    """

    rows: dict[str, tuple[PolicySpec, ...]]
    scenarios: tuple[str, ...]
    seeds: tuple[int, ...]
    runs: dict[str, Array]
    decision_us: Array
    incomplete: dict[str, str]
    lacking: str = ""
    failed: dict[tuple[int, int], str] = field(default_factory=dict)
    flags: dict[int, Array] = field(default_factory=dict)
    version: str = ""
    partial: dict[int, dict[str, dict[str, Array]]] = field(default_factory=dict)

    @property
    def gaps(self) -> list[str]:
        """Sentences on all that the board lacks; empty for a complete board."""
        left_out = [f"Left out: {policy}: {reason}" for policy, reason in self.incomplete.items()]
        return [*([f"Incomplete: {self.lacking}"] if self.lacking else []), *left_out]

    @cached_property
    def remarks(self) -> list[str]:
        """Sentences that a reader of the board needs, `gaps` among them."""
        sentences = []
        if self.score is None:
            sentences.append(UNSCORED)
        elif without := [name for k, name in enumerate(self.scenarios) if k not in self.ceilings]:
            sentences.append(
                f"No error score, since no law with privileged access is a ceiling there: {', '.join(without)}. Diverged "
                "runs count there too."
            )
        for i, k, error, least in self.too_good:
            sentences.append(
                f"Check {self.policies[i]} in {self.scenarios[k]}: it errs by {error:.3g} %, less than {least:.3g} % of "
                "the best law that knows the truth."
            )
        reasons: dict[str, dict[str, list[str]]] = {}
        for (i, k), reason in self.failed.items():
            sensor = re.search(r"needs a sensor of \w+", reason)
            rows = reasons.setdefault(sensor[0] if sensor else reason, {})
            rows.setdefault(self.policies[i], []).append(self.scenarios[k])
        for reason, rows in reasons.items():
            names = (f"{policy} in {_and_more(tasks)}" for policy, tasks in rows.items())
            sentences.append(f"Count as the motionless baseline ({reason}): {', '.join(names)}.")
        return sentences + self.gaps

    @cached_property
    def policies(self) -> tuple[str, ...]:
        """Name of each policy [p]."""
        return tuple(self.rows)

    @cached_property
    def specs(self) -> tuple[PolicySpec, ...]:
        """First member of each policy [p]."""
        return tuple(members[0] for members in self.rows.values())

    @cached_property
    def _members(self) -> tuple[PolicySpec, ...]:
        """The members, policy by policy [m]."""
        return tuple(spec for members in self.rows.values() for spec in members)

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """Number of members of each policy [p]."""
        return np.array([len(members) for members in self.rows.values()])

    def split(self, values: Array) -> list[Array]:
        """Return some values of the members [m x ...] as a list of those of each policy."""
        return np.split(values, np.cumsum(self.sizes)[:-1])

    def average(self, draws: Array) -> Array:
        """Return the mean of draws [b x m x ...] over each policy's members, [b x p x ...]."""
        weights = self.weights[: len(draws)]
        weights = weights.reshape(*weights.shape, *[1] * (draws.ndim - 2))
        return np.add.reduceat(weights * draws, np.cumsum(self.sizes) - self.sizes, axis=1)

    @cached_property
    def errors(self) -> Array:
        """Mean absolute tracking error in % of the reference's amplitude, [m x s x n].

        An error below the encoder's resolution counts as the resolution.
        """
        return counted_error(self.runs)

    @cached_property
    def ranked(self) -> list[int]:
        """Indices of the policies that are ranked: those that do not know the truth."""
        return [i for i, spec in enumerate(self.specs) if spec.ranked]

    @cached_property
    def tiers(self) -> dict[str, list[int]]:
        """Indices of the scenarios of each tier; the first tier is the one that ranks."""
        tiers = [tier_of(scenario) for scenario in self.scenarios]
        return {x: [i for i, tier in enumerate(tiers) if tier == x] for x in RANKED_FIRST if x in tiers}

    @property
    def main(self) -> list[int]:
        """Indices of the scenarios of the tier that ranks."""
        return next(iter(self.tiers.values()))

    @cached_property
    def counts(self) -> Array:
        """Weight of each seed in the data and each draw [b x n]; see `statistics.weigh`."""
        return statistics.weigh(len(self.seeds), (BOOTSTRAP_SEED, len(self.seeds)))

    @cached_property
    def weights(self) -> Array:
        """Weight of each member in its policy's mean, in the data and each resample [b x m]."""
        rows = [(len(members), (BOOTSTRAP_SEED, *map(ord, policy))) for policy, members in self.rows.items()]
        return np.hstack([statistics.resample(size, seed) / size for size, seed in rows])

    @cached_property
    def ceilings(self) -> dict[int, tuple[str, dict[str, Array]]]:
        """Name of the ceiling of each scenario that has one, by index, and its metrics [n].

        The ceiling has the least error of all classical policies with privileged access.
        """
        laws = {spec.name: i for i, spec in enumerate(self._members) if spec.kind == "classical" and not spec.ranked}
        ceilings = {}
        for k in range(len(self.scenarios)):
            runs = {law: {name: x[i, k] for name, x in self.runs.items()} for law, i in laws.items()}
            runs |= self.partial.get(k, {})
            errors = {law: _geometric_mean(counted_error(metrics)) for law, metrics in runs.items()}
            best = min(errors, key=errors.__getitem__, default="")
            clear = best and errors[best] <= CLEAR * _geometric_mean(self.runs["baseline_error_pct"][0, k])
            if clear and runs[best]["diverged"].mean() <= MOST_DIVERGED:
                ceilings[k] = best, runs[best]
        return ceilings

    def _of_ceilings(self, scored: Sequence[int], value: Callable[[Mapping[str, Array]], Array]) -> Array:
        """Return a function of the metrics of the ceilings of some scenarios [... x n]."""
        return np.array([value(self.ceilings[k][1]) for k in scored])

    @cached_property
    def too_good(self) -> list[tuple[int, int, float, float]]:
        """Ranked policies with less error than the ceiling: policy, scenario and both errors [%].

        The ratio of the errors is below 1 with its whole interval.
        """
        found = []
        for k in self.ceilings:
            errors = self._mean_errors(self.errors[:, [k]])
            ceiling = statistics.geometric_mean(self._of_ceilings([k], counted_error), self.counts)
            ratio = statistics.interval(errors / ceiling[:, None])
            found += [(i, k, errors[0, i], ceiling[0]) for i in self.ranked if ratio.high[i] < 1.0]
        return found

    @cached_property
    def _scores(self) -> dict[str, Array]:
        """Score of each policy in each tier with a ceiling, without its lower bound [b x p]."""
        weights = self.counts.T
        errors, baseline = (
            np.log(x) @ weights / len(self.seeds) for x in (self.errors, self.runs["baseline_error_pct"][0])
        )
        scores = {}
        for tier, indices in self.tiers.items():
            scored = [k for k in indices if k in self.ceilings]
            if scored:
                gains = baseline[scored] - errors[:, scored]
                # A resample may lack the seeds on which the ceiling is clearly below the baseline.
                ceilings = np.log(self._of_ceilings(scored, counted_error)) @ weights / len(self.seeds)
                spans = np.maximum(baseline[scored] - ceilings, -np.log(CLEAR))
                shares, prior = self._diverged(indices)
                # The prior alone would charge all policies for few runs.
                diverged = np.maximum(shares.T - prior, 0.0)
                scores[tier] = self.average(statistics.score(gains.swapaxes(0, 1), spans[:, None], diverged).T)
        return scores

    def _diverged(self, indices: Sequence[int]) -> tuple[Array, float]:
        """Return `diverged_shares` of each member in some scenarios [b x m].

        Runs are likely to diverge where those of other policies do that seldom diverge.
        """
        flags = [self.flags.get(k, self.runs["diverged"][:, k]) for k in indices]
        means = np.array([scenario.mean(axis=-1) for scenario in flags])
        seldom = [means[:, i].mean() <= MOST_DIVERGED and self._members[i].ranked for i in range(len(means[0]))]
        runs = np.array([max(sum(seldom), 1) * scenario.shape[-1] for scenario in flags])
        likely = means[:, seldom].sum(axis=1) / max(sum(seldom), 1) + statistics.PRIOR_LOST / runs
        return statistics.diverged_shares(flags, likely, BOOTSTRAP_SEED)

    @cached_property
    def scores(self) -> dict[str, Estimate]:
        """Score of each policy [p] in each tier that has a ceiling: the mean over its scenarios."""
        scores = {}
        for tier, draws in self._scores.items():
            e = statistics.interval(draws)
            scores[tier] = Estimate(*(np.maximum(x, statistics.BOUNDS[0]) for x in (e.value, e.low, e.high)))
        return scores

    @property
    def score(self) -> Estimate | None:
        """Score of each policy [p] in the tier that ranks; None without a ceiling."""
        return self.scores.get(next(iter(self.tiers)))

    @cached_property
    def error(self) -> Estimate:
        """The geometric mean of each policy's errors in the tier that ranks [p]."""
        return statistics.interval(self._mean_errors(self.errors[:, self.main]))

    def mrad(self, some: Sequence[int]) -> Array:
        """Return the geometric mean of each policy's errors in some scenarios [p] mrad.

        As in `errors`, an error below the encoder's resolution counts as the resolution.
        """
        runs = self.runs["error_mrad"] * self.errors / self.runs["error_pct"]
        logs = np.log(runs[:, some]).mean(axis=(-1, -2))
        return np.asarray(np.exp(self.average(logs[None])[0]))

    def _mean_errors(self, errors: Array) -> Array:
        """Return the geometric mean of errors [m x ... x s x n] of each policy, [b x p x ...]."""
        return np.exp(self.average(statistics.mean(np.log(errors), self.counts)))

    @cached_property
    def worst(self) -> Array:
        """The mean of each policy's largest errors, 5 % of the runs in the tier that ranks [p]."""
        return np.array([statistics.tail_mean(errors.ravel()) for errors in self.split(self.errors[:, self.main])])

    @cached_property
    def diverged(self) -> Estimate:
        """Share of each policy's runs that diverge in the tier that ranks [p].

        The value is the mean of the scenarios' shares in the data.
        """
        flags = [self.flags.get(k, self.runs["diverged"][:, k]).mean(axis=-1) for k in self.main]
        estimate = statistics.interval(self.average(self._diverged(self.main)[0]))
        return dataclasses.replace(estimate, value=self.average(np.mean(flags, axis=0)[None])[0])

    @cached_property
    def effort(self) -> Array | None:
        """Torque variation of each policy relative to the ceiling's, the median of scenarios [p].

        None: the tier that ranks has no ceiling.
        """
        scored = [k for k in self.main if k in self.ceilings]
        if not scored:
            return None
        ceilings = self._of_ceilings(scored, lambda runs: runs["variation"])
        ratio = np.median(self.runs["variation"][:, scored], axis=-1) / np.median(ceilings, axis=-1)
        return self.average(np.median(ratio, axis=-1)[None])[0]

    @cached_property
    def _levels(self) -> Array:
        """Numbers that order the policies, the smallest first: by score, else by error [b x p]."""
        scores = self._scores.get(next(iter(self.tiers)))
        return self._mean_errors(self.errors[:, self.main]) if scores is None else -scores

    @cached_property
    def rank(self) -> Estimate:
        """Rank of each ranked policy, in the order of `ranked`."""
        return statistics.ranks(self._levels[:, self.ranked])

    @cached_property
    def error_rank(self) -> Estimate:
        """Rank of each policy in `ranked` by its error in the tier that ranks."""
        return statistics.ranks(self._mean_errors(self.errors[:, self.main])[:, self.ranked])

    @cached_property
    def diverged_rank(self) -> Estimate:
        """Rank of each policy in `ranked` by its share of diverged runs."""
        return statistics.ranks(self.average(self._diverged(self.main)[0])[:, self.ranked])

    @cached_property
    def order(self) -> list[int]:
        """Indices of the policies, the best first; unranked ones stand at the end."""
        return sorted(range(len(self.specs)), key=lambda i: (not self.specs[i].ranked, self._levels[0, i]))

    @cached_property
    def families(self) -> dict[str, list[int]]:
        """Indices of the scenarios of each family, which names its tier if that does not rank."""
        families: dict[str, list[int]] = {}
        for i, scenario in enumerate(self.scenarios):
            tier = "" if i in self.main else f"{tier_of(scenario)} "
            families.setdefault(tier + family_of(scenario), []).append(i)
        return families

    @cached_property
    def family_errors(self) -> dict[str, Estimate]:
        """Geometric mean of each policy's errors in each family [p]."""
        families = self.families.items()
        return {family: statistics.interval(self._mean_errors(self.errors[:, i])) for family, i in families}


def _geometric_mean(x: Array) -> float:
    return float(np.exp(np.log(x).mean()))


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

    Members of a row are the policies whose specifications name it in `rows`. A policy that the
    expected cells have in some scenarios only is no row, and may be the ceiling there. A row with a
    member that failed in a scenario counts there as the motionless baseline: an arm at its start.
    One with a member that failed in all of them, or lacks a result, is left out and named.

    Args:
        results: of cells with the same seeds; a scenario may have more, which only tell how often a
            policy's runs diverge.
        expected: cells that the board should have.

    Raises:
        ValueError: two different scenarios or policies share a name, or no policy is complete.
    """
    tasks = _by_name(result.cell.scenario for result in results if result.rows)
    specs = _by_name(cell.policy for cell in (*(result.cell for result in results), *expected))
    stored: dict[str, dict[str, Result]] = {name: {} for name in specs}
    for result in results:
        stored[result.cell.policy.name][result.cell.scenario.name] = result
    wanted: dict[str, set[str]] = {}
    for one in expected:
        wanted.setdefault(one.policy.name, set()).add(one.scenario.name)
    names = dict.fromkeys(one.scenario.name for one in expected)
    partial = {policy: some for policy, some in wanted.items() if len(some) < len(names)}

    rows, incomplete = _complete([spec for spec in specs.values() if spec.name not in partial], stored, tasks)
    for policy, some in partial.items():
        if reason := _lack(stored[policy], some):
            incomplete[policy] = f"{reason}, where it may be the ceiling"
    if not rows:
        reasons = "; ".join(f"{row}: {reason}" for row, reason in incomplete.items()) or "the store has no cell"
        raise ValueError(f"there is no policy with a result for every scenario: {reasons}")

    cell = min((result.cell for result in results), key=lambda cell: len(cell.seeds))

    def columns(rows: Sequence[Mapping[str, float]]) -> dict[str, Array]:
        return {name: np.array([row[name] for row in rows]) for name in METRICS}

    by_length = sorted(results, key=lambda result: len(result.rows))  # a ceiling may have fewer seeds
    still = {r.cell.scenario.name: [_motionless(row) for row in r.rows] for r in by_length if r.rows}
    failed, table, decision, count = {}, [], [], len(cell.seeds)
    for i, members in enumerate(rows.values()):
        own = [stored[spec.name] for spec in members]
        for k, task in enumerate(tasks):
            if errors := [given[task].error for given in own if given[task].error]:
                failed[i, k] = errors[0]
        for given in own:
            table.append([columns(still[x] if (i, k) in failed else given[x].rows) for k, x in enumerate(tasks)])
        decision.append(np.median([result.decision_us for given in own for result in given.values() if result.rows]))
    used = [*partial, *(spec.name for members in rows.values() for spec in members)]
    keys = sorted(result.cell.key for policy in used for result in stored[policy].values())
    absent = [name for name in names if name not in tasks]
    return Board(
        rows=rows,
        scenarios=tuple(tasks),
        seeds=cell.seeds,
        runs={name: np.array([[x[name][:count] for x in row] for row in table]) for name in METRICS},
        decision_us=np.array(decision),
        incomplete=incomplete,
        lacking=f"{len(absent)} of {len(names)} scenarios have no results: {', '.join(absent)}" if absent else "",
        failed=failed,
        flags={
            k: np.array([row[k]["diverged"] for row in table])
            for k, task in enumerate(tasks) if len(still[task]) > count
        },
        version=hashlib.sha256("".join(keys).encode()).hexdigest()[:12],
        partial={
            k: {policy: columns(stored[policy][task].rows[:count])
                for policy in partial if task in stored[policy] and stored[policy][task].rows}
            for k, task in enumerate(tasks)
        },
    )  # fmt: skip


def _complete(
    specs: Sequence[PolicySpec], stored: Mapping[str, Mapping[str, Result]], tasks: Iterable[str]
) -> tuple[dict[str, tuple[PolicySpec, ...]], dict[str, str]]:
    """Return the members of each row, by its name, and why the rows are left out that lack some."""
    rows: dict[str, tuple[PolicySpec, ...]] = {}
    for spec in specs:
        for row in spec.rows or (spec.name,):
            rows[row] = (*rows.get(row, ()), spec)
    incomplete: dict[str, str] = {}
    for row, members in rows.items():
        for spec in members:
            if reason := _lack(stored[spec.name], tasks):
                incomplete.setdefault(row, reason if len(members) == 1 else f"{spec.name}: {reason}")
    return {row: members for row, members in rows.items() if row not in incomplete}, incomplete


def _lack(results: Mapping[str, Result], tasks: Iterable[str]) -> str:
    """Return the reason why a policy with some results, by scenario, has no row; empty: it has."""
    if results and all(result.error for result in results.values()):
        return next(iter(results.values())).error
    lacking = [task for task in tasks if task not in results]
    return "" if not lacking else f"no result yet for {_and_more(lacking)}" if results else "no result yet"


def _and_more(names: Sequence[str]) -> str:
    return names[0] + (f" and {len(names) - 1} more" if names[1:] else "")


def _motionless(row: dict[str, float]) -> dict[str, float]:
    """Return the metrics of the motionless baseline, from those of any policy's run."""
    reference = {name: row[name] for name in ("baseline_error_pct", "resolution_pct")}
    still = {"error_pct": row["baseline_error_pct"], "variation": 0.0, "diverged": 0.0}
    return dict.fromkeys(row, float("nan")) | reference | still


def _by_name(entries: Iterable[Any]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for entry in entries:
        if named.setdefault(entry.name, entry) != entry:
            raise ValueError(f"names on a board must differ, but two different entries are named {entry.name!r}")
    return named
