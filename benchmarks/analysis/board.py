"""The board: score, error, diverged share, effort and rank of each policy of a suite."""

import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.analysis import statistics
from benchmarks.analysis.statistics import Estimate
from benchmarks.policies.spec import PolicySpec
from benchmarks.run.metrics import Metric
from benchmarks.run.store import Result
from benchmarks.run.suite import Cell
from fbl_gym import scenarios
from fbl_gym.arm import Array

TIERS = ("hardware", "ideal", "surprise", "practice")
"""The tiers of scenarios. A board is ranked in the first of these that it has."""

UNSCORED = "No scores: no classical law with privileged access is a ceiling on this board. Ranked by the error."
"""The remark on a board without a ceiling."""

CLEAR = 0.5
"""A ceiling errs at most CLEAR times as much as an arm that stays at its start."""

MOST_DIVERGED = 0.1
"""Largest share of runs that diverge for which a law can be a ceiling."""

TOP = 10
"""A suite on which the rank intervals of the TOP best policies overlap is too easy."""

BOOTSTRAP_SEED = 0
"""Seed of the bootstrap."""


@dataclass(frozen=True)
class Board:
    """Results of p policies on the same s scenarios with the same n seeds.

    Args:
        specs: policies [p] with a result for every scenario.
        scenarios: [s] names.
        seeds: [n].
        runs: each metric, [p x s x n]. Where a policy failed, they are those of an arm that stays.
        decision_us: time of a decision of each policy, the median over scenarios [p].
        incomplete: policies that are left out, each with the reason.
        lacking: a sentence on the scenarios without results; empty: there are none.
        failed: the error of each policy and scenario, by index, where the policy failed.
        metrics: external ones, which `runs` has too.
    """

    specs: tuple[PolicySpec, ...]
    scenarios: tuple[str, ...]
    seeds: tuple[int, ...]
    runs: dict[str, Array]
    decision_us: Array
    incomplete: dict[str, str]
    lacking: str = ""
    failed: dict[tuple[int, int], str] = field(default_factory=dict)
    metrics: tuple[Metric, ...] = ()

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
        elif without := [self.scenarios[i] for i in np.flatnonzero(self.ceilings < 0)]:
            sentences.append(
                f"No error score, since no law with privileged access is a ceiling there: {', '.join(without)}. Diverged "
                "runs count there too."
            )
        rank, count = self.rank, min(TOP, len(self.ranked))
        best = np.argsort(rank.value, kind="stable")[:count]
        if count == TOP and rank.low[best].max() <= rank.high[best].min():
            sentences.append(f"This suite is too easy: the rank intervals of the best {TOP} policies overlap.")
        reasons: dict[str, dict[str, list[str]]] = {}
        for (i, k), reason in self.failed.items():
            sensor = re.search(r"needs a sensor of \w+", reason)
            rows = reasons.setdefault(sensor[0] if sensor else reason, {})
            rows.setdefault(self.policies[i], []).append(self.scenarios[k])
        for reason, rows in reasons.items():
            names = (f"{policy} in {_and_more(tasks)}" for policy, tasks in rows.items())
            sentences.append(f"Count as an arm that stays ({reason}): {', '.join(names)}.")
        return sentences + self.gaps

    @cached_property
    def policies(self) -> tuple[str, ...]:
        """Name of each policy [p]."""
        return tuple(spec.name for spec in self.specs)

    @cached_property
    def errors(self) -> Array:
        """Mean absolute tracking error in % of the reference's amplitude, [p x s x n].

        An error below the encoder's resolution counts as the resolution.
        """
        return np.maximum(self.runs["error_pct"], self.runs["resolution_pct"])

    @cached_property
    def ranked(self) -> list[int]:
        """Indices of the policies that are ranked: those that do not know the truth."""
        return [i for i, spec in enumerate(self.specs) if spec.ranked]

    @cached_property
    def tiers(self) -> dict[str, list[int]]:
        """Indices of the scenarios of each tier; the first tier is the one that ranks."""
        places = [tier_of(scenario) for scenario in self.scenarios]
        return {tier: [i for i, place in enumerate(places) if place == tier] for tier in TIERS if tier in places}

    @property
    def main(self) -> list[int]:
        """Indices of the scenarios of the tier that ranks."""
        return next(iter(self.tiers.values()))

    @cached_property
    def counts(self) -> Array:
        """Weight of each seed in each resample; see `statistics.resample`."""
        return statistics.resample(len(self.seeds), BOOTSTRAP_SEED)

    @cached_property
    def ceilings(self) -> NDArray[np.int64]:
        """Index of the policy that is the ceiling of each scenario, or -1 [s].

        The ceiling has the least error of all classical policies with privileged access.
        """
        laws = [i for i, spec in enumerate(self.specs) if spec.kind == "classical" and not spec.ranked]
        errors, stay = np.log(self.errors).mean(axis=-1), np.log(self.runs["stay_pct"][0]).mean(axis=-1)
        diverged = self.runs["diverged"].mean(axis=-1)
        ceilings = np.full(len(self.scenarios), -1)
        for k in range(len(self.scenarios)):
            best = min(laws, key=lambda i: errors[i, k], default=-1)
            if best >= 0 and errors[best, k] <= stay[k] + np.log(CLEAR) and diverged[best, k] <= MOST_DIVERGED:
                ceilings[k] = best
        return ceilings

    def _scores(self, counts: Array) -> dict[str, Array]:
        """Return the score of each policy in each tier with a ceiling [b x p].

        It has no lower bound. The counts are [b x n].
        """
        weights = counts.T
        errors, stay = (np.log(x) @ weights / len(self.seeds) for x in (self.errors, self.runs["stay_pct"][0]))
        scores = {}
        for tier, places in self.tiers.items():
            scored = [k for k in places if self.ceilings[k] >= 0]
            if scored:
                gains = stay[scored] - errors[:, scored]
                # A resample may lack the seeds on which the ceiling is clearly below staying.
                spans = np.maximum(stay[scored] - errors[self.ceilings[scored], scored], -np.log(CLEAR))
                counted = self.runs["diverged"][:, places].sum(axis=1) @ weights
                diverged = [statistics.diverged_share(*x) for x in zip(counted, self._runs(places), strict=True)]
                scores[tier] = statistics.score(gains.swapaxes(0, 1), spans[:, None], diverged).T
        return scores

    def _runs(self, places: Sequence[int]) -> NDArray[np.int64]:
        """Return the number of runs of each policy in the scenarios where it did not fail [p]."""
        failed = [sum(j == i and k in places for j, k in self.failed) for i in range(len(self.specs))]
        return np.maximum((len(places) - np.array(failed)) * len(self.seeds), 1)

    @cached_property
    def _draws(self) -> dict[str, Array]:
        return self._scores(self.counts)

    @cached_property
    def _unbounded(self) -> dict[str, Array]:
        """Score of each policy [p] in each tier with a ceiling, without the lower bound."""
        return {tier: values[0] for tier, values in self._scores(np.ones((1, len(self.seeds)))).items()}

    @cached_property
    def scores(self) -> dict[str, Estimate]:
        """Score of each policy [p] in each tier that has a ceiling: the mean over its scenarios."""
        scores = {}
        for tier, draws in self._draws.items():
            e = statistics.interval(self._unbounded[tier], draws)
            scores[tier] = Estimate(*(np.maximum(x, statistics.BOUNDS[0]) for x in (e.value, e.low, e.high)))
        return scores

    @property
    def score(self) -> Estimate | None:
        """Score of each policy [p] in the tier that ranks; None without a ceiling."""
        return self.scores.get(next(iter(self.tiers)))

    @cached_property
    def error(self) -> Estimate:
        """The geometric mean of each policy's errors in the tier that ranks [p]."""
        return statistics.estimate(self.errors[:, self.main], self.counts)

    @cached_property
    def worst(self) -> Array:
        """The mean of each policy's largest errors, 5 % of the runs in the tier that ranks [p]."""
        return statistics.tail_mean(self.errors[:, self.main].reshape(len(self.specs), -1))

    @cached_property
    def diverged(self) -> Estimate:
        """Share of each policy's runs that diverged in the tier that ranks [p]."""
        return statistics.proportion(self.runs["diverged"][:, self.main].sum(axis=(1, 2)), self._runs(self.main))

    @cached_property
    def effort(self) -> Array | None:
        """Torque variation of each policy relative to the ceiling's, the median of scenarios [p].

        None: the tier that ranks has no ceiling.
        """
        places = [k for k in self.main if self.ceilings[k] >= 0]
        variation = np.median(self.runs["variation"], axis=-1)
        return np.median(variation[:, places] / variation[self.ceilings[places], places], axis=-1) if places else None

    @cached_property
    def rank(self) -> Estimate:
        """Rank of each ranked policy, in the order of `ranked`: by score, else by error."""
        if self.score is not None:
            return statistics.ranks(-self._draws[next(iter(self.tiers))][:, self.ranked])
        return statistics.ranks(statistics.geometric_mean(self.errors[self.ranked][:, self.main], self.counts))

    @cached_property
    def order(self) -> list[int]:
        """Indices of the policies, the best first; unranked ones stand at the end."""
        values = self._unbounded.get(next(iter(self.tiers)))
        value = self.error.value if values is None else -values
        return sorted(range(len(self.specs)), key=lambda i: (not self.specs[i].ranked, value[i]))

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
        return {family: statistics.estimate(self.errors[:, indices], self.counts) for family, indices in families}

    @cached_property
    def recovery(self) -> dict[str, dict[str, Array]]:
        """Metrics of each scenario with events: the mean over the runs that did not diverge [p]."""
        names = ("recovery_s", "recovery_rad_s", "unrecovered_pct", "diverged")
        places = np.flatnonzero(np.isfinite(self.runs["recovery_s"]).any(axis=(0, 2)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a policy whose runs all diverged has NaN
            return {self.scenarios[k]: {x: np.nanmean(self.runs[x][:, k], axis=-1) for x in names} for k in places}

    @cached_property
    def degradation(self) -> dict[str, tuple[str, list[int], Estimate]]:
        """Description, severities [k], errors [p x k] of each family with two or more, by title."""
        groups: dict[tuple[str, str, str], dict[str, dict[int, int]]] = {}
        for i, name in enumerate(self.scenarios):
            if member := scenarios.member(name):
                # Severities of one arm, at one rate and in one world belong together.
                group = groups.setdefault((tier_of(name), member.arm, name.partition("@")[2]), {})
                group.setdefault(member.family, {})[member.severity] = i
        curves = {}
        for (tier, arm, suffix), group in groups.items():
            for family, members in group.items():
                severities = sorted((group.get("nominal", {}) | members).items())
                if family != "nominal" and len(severities) > 1:
                    runs = self.errors[:, [i for _, i in severities]][:, :, None]
                    estimate = statistics.estimate(runs, self.counts)
                    title = (family if arm == "table-1" else f"{arm}/{family}") + (f"@{suffix}" if suffix else "")
                    title = title if tier == next(iter(self.tiers)) else f"{tier} {title}"
                    text = meaning_of(self.scenarios[severities[-1][1]])
                    curves[title] = text, [severity for severity, _ in severities], estimate
        return curves


def tier_of(scenario: str) -> str:
    """Return the tier of a scenario's name; one that belongs to no tier counts as "ideal".

    A scenario in another engine's world is a surprise.
    """
    if scenario.partition("@")[2] in scenarios.WORLDS:
        return "surprise"
    member = scenarios.member(scenario)
    return member.tier if member else "ideal"


def family_of(scenario: str) -> str:
    """Return the family of a scenario's name; one that belongs to no family stands for itself.

    "section-2-2/mass-error-2@1000Hz" is of the family "mass-error". The rate is left out.
    """
    member = scenarios.member(scenario)
    return scenario.partition("@")[0] if member is None else member.family


def meaning_of(scenario: str) -> str:
    """Return the description of a scenario's name; one that has no tier is of a suite."""
    name = scenario.partition("@")[0]
    return scenarios.get(name).description if scenarios.member(name) else "of this suite"


def assemble(results: Sequence[Result], expected: Sequence[Cell] = ()) -> Board:
    """Return the board of a suite's results.

    A policy that failed in a scenario counts there as an arm that stays. One that failed in all of
    them, or lacks a result, is left out and named.

    Args:
        results: of cells with the same seeds.
        expected: cells that the board should have.

    Raises:
        ValueError: two different scenarios or policies share a name, or no policy is complete.
    """
    tasks = _by_name(result.cell.scenario for result in results if result.rows)
    specs = _by_name(result.cell.policy for result in results)
    stored = {(r.cell.policy.name, r.cell.scenario.name): r for r in results}
    incomplete = {}
    for policy in specs:
        errors = [result.error for (name, _), result in stored.items() if name == policy]
        lacking = [task for task in tasks if (policy, task) not in stored]
        if all(errors):
            incomplete[policy] = errors[0]
        elif lacking:
            incomplete[policy] = f"no result yet for {_and_more(lacking)}"
    for policy in dict.fromkeys(cell.policy.name for cell in expected):
        if policy not in specs:
            incomplete[policy] = "no result yet"
    names = dict.fromkeys(cell.scenario.name for cell in expected)
    absent = [name for name in names if name not in tasks]
    gap = f"{len(absent)} of {len(names)} scenarios have no results: {', '.join(absent)}" if absent else ""
    complete = [policy for policy in specs if policy not in incomplete]
    if not complete:
        reasons = "; ".join(f"{policy}: {reason}" for policy, reason in incomplete.items()) or "the store has no cell"
        raise ValueError(f"there is no policy with a result for every scenario: {reasons}")
    stays = {r.cell.scenario.name: [_staying(row) for row in r.rows] for r in results if r.rows}
    table = [[stored[policy, task] for task in tasks] for policy in complete]
    rows = [[result.rows or stays[result.cell.scenario.name] for result in row] for row in table]
    first = table[0][0].cell
    runs = {name: np.array([[[run[name] for run in cell] for cell in row] for row in rows]) for name in first.columns}
    decision = np.array([np.median([result.decision_us for result in row if result.rows]) for row in table])
    failed = {(i, k): r.error for i, row in enumerate(table) for k, r in enumerate(row) if r.error}
    members = tuple(specs[policy] for policy in complete)
    return Board(members, tuple(tasks), first.seeds, runs, decision, incomplete, gap, failed, first.metrics)


def _and_more(names: Sequence[str]) -> str:
    return names[0] + (f" and {len(names) - 1} more" if names[1:] else "")


def _staying(row: dict[str, float]) -> dict[str, float]:
    """Return the metrics of an arm that stays at its start, from those of any policy's run."""
    reference = {name: row[name] for name in ("stay_pct", "resolution_pct")}
    still = {"error_pct": row["stay_pct"], "variation": 0.0, "diverged": 0.0}
    return dict.fromkeys(row, float("nan")) | reference | still


def _by_name(things: Iterable[Any]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for thing in things:
        if named.setdefault(thing.name, thing) != thing:
            raise ValueError(f"names on a board must differ, but two different entries are named {thing.name!r}")
    return named
