"""The board: score, errors, diverged share and rank of each policy of a suite, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from benchmarks.analysis import statistics
from benchmarks.analysis.statistics import Estimate
from benchmarks.policies.spec import PolicySpec
from benchmarks.run.metrics import METRICS
from benchmarks.run.store import Result
from benchmarks.run.suite import Cell
from fbl_gym import Scenario, scenarios
from fbl_gym.arm import Array

ORACLE = "oracle-flm"
"""The policy whose error scores 100."""

UNSCORED = f"No scores, since they need the errors of {ORACLE}, which is not on this board; ranked by the mean error."
"""The remark on a board without the oracle."""

BOOTSTRAP_SEED = 0
"""Seed of the bootstrap."""


@dataclass(frozen=True)
class Board:
    """Results of p policies on the same s scenarios with the same n seeds.

    Args:
        specs: policies [p] with a result for every scenario.
        scenarios: [s] names.
        seeds: [n].
        runs: each metric, [p x s x n].
        decision_us: time of a decision of each policy, the median over scenarios [p].
        incomplete: policies that are left out, each with the reason.
        lacking: a sentence on the scenarios without results; empty: there are none.
    """

    specs: tuple[PolicySpec, ...]
    scenarios: tuple[str, ...]
    seeds: tuple[int, ...]
    runs: dict[str, Array]
    decision_us: Array
    incomplete: dict[str, str]
    lacking: str = ""

    @property
    def gaps(self) -> list[str]:
        """Sentences on all that the board lacks; empty for a complete board."""
        left_out = [f"Left out: {policy}: {reason}" for policy, reason in self.incomplete.items()]
        return [*([f"Incomplete: {self.lacking}"] if self.lacking else []), *left_out]

    @cached_property
    def policies(self) -> tuple[str, ...]:
        """Name of each policy [p]."""
        return tuple(spec.name for spec in self.specs)

    @property
    def errors(self) -> Array:
        """Mean absolute tracking error in % of the reference's amplitude, [p x s x n]."""
        return self.runs["error_pct"]

    @cached_property
    def ranked(self) -> list[int]:
        """Indices of the policies that are ranked: those that do not know the truth."""
        return [i for i, spec in enumerate(self.specs) if spec.ranked]

    @cached_property
    def counts(self) -> Array:
        """Weight of each seed in each resample; see `statistics.resample`."""
        return statistics.resample(len(self.seeds), BOOTSTRAP_SEED)

    @cached_property
    def scores(self) -> Array | None:
        """Scores of the runs [p x s x n]; None where the oracle has not run."""
        if ORACLE not in self.policies:
            return None
        oracle = self.errors[self.policies.index(ORACLE)]
        return statistics.score(self.errors, self.runs["stay_pct"], oracle, self.runs["diverged"])

    @cached_property
    def score(self) -> Estimate | None:
        """Mean score of each policy [p]; the mean, so that rare divergence counts."""
        return None if self.scores is None else statistics.estimate(self.scores, self.counts, statistics.mean)

    @cached_property
    def error(self) -> Estimate:
        """The interquartile mean of each policy's errors [p]."""
        return statistics.estimate(self.errors, self.counts)

    @cached_property
    def mean_error(self) -> Estimate:
        """The mean of each policy's errors [p]."""
        return statistics.estimate(self.errors, self.counts, statistics.mean)

    @cached_property
    def diverged(self) -> Estimate:
        """Share of each policy's runs that diverged [p]."""
        diverged = self.runs["diverged"]
        return statistics.proportion(diverged.sum(axis=(1, 2)), np.full(len(diverged), diverged[0].size))

    @cached_property
    def rank(self) -> Estimate:
        """Rank of each ranked policy, in the order of `ranked`: by score, else by mean error."""
        better = self.errors if self.scores is None else -self.scores
        return statistics.ranks(statistics.mean(better[self.ranked], self.counts))

    @cached_property
    def order(self) -> list[int]:
        """Indices of the policies, the best first; unranked ones stand at the end."""
        value = self.mean_error.value if self.score is None else -self.score.value
        return sorted(range(len(self.specs)), key=lambda i: (not self.specs[i].ranked, value[i]))

    @cached_property
    def families(self) -> dict[str, list[int]]:
        """Indices of the scenarios of each family."""
        families: dict[str, list[int]] = {}
        for i, scenario in enumerate(self.scenarios):
            families.setdefault(family_of(scenario), []).append(i)
        return families

    @cached_property
    def family_errors(self) -> dict[str, Estimate]:
        """Interquartile mean of each policy's errors in each family [p]."""
        families = self.families.items()
        return {family: statistics.estimate(self.errors[:, indices], self.counts) for family, indices in families}

    def degradation(self, family: str, arm: str) -> tuple[list[int], Estimate] | None:
        """Return severities [k] and the interquartile mean of each policy's errors [p x k].

        The result is None where fewer than two severities have run.

        Args:
            family: one of `scenarios.families()`.
            arm: one of `scenarios.arms()`.
        """
        by_suffix: dict[str, dict[int, int]] = {}  # severities at one rate and in one world belong together
        for i, name in enumerate(self.scenarios):
            member = scenarios.member(name)
            if member and member.arm == arm and member.family in (family, "nominal"):
                by_suffix.setdefault(name.partition("@")[2], {})[member.severity] = i
        indices = next(iter(by_suffix.values()), {})
        if len(indices) < 2:
            return None
        severities = sorted(indices)
        runs = self.errors[:, [indices[severity] for severity in severities]][:, :, None]
        return severities, statistics.estimate(runs, self.counts)


def family_of(scenario: str) -> str:
    """Return the family of a scenario's name; one that belongs to no family stands for itself.

    "section-2-2/mass-error-2@1000Hz" is of the family "mass-error". The rate is left out.
    """
    member = scenarios.member(scenario)
    return scenario.partition("@")[0] if member is None else member.family


def assemble(results: Sequence[Result], expected: Sequence[Cell] = ()) -> Board:
    """Return the board of a suite's results.

    A policy that lacks a scenario, or failed, is left out and named.

    Args:
        results: of cells with the same seeds.
        expected: cells that the board should have.

    Raises:
        ValueError: two different scenarios or policies share a name, or no policy is complete.
    """
    tasks = _by_name([result.cell.scenario for result in results])
    specs = _by_name([result.cell.policy for result in results])
    finished = {(r.cell.policy.name, r.cell.scenario.name): r for r in results if r.rows}
    incomplete = {r.cell.policy.name: r.error for r in results if r.error}
    for policy in specs:
        lacking = [task for task in tasks if (policy, task) not in finished]
        if lacking and policy not in incomplete:
            more = f" and {len(lacking) - 1} more" if lacking[1:] else ""
            incomplete[policy] = f"no result yet for {lacking[0]}{more}"
    for policy in dict.fromkeys(cell.policy.name for cell in expected):
        if policy not in specs:
            incomplete[policy] = "no result yet"
    names = dict.fromkeys(cell.scenario.name for cell in expected)
    absent = [name for name in names if name not in tasks]
    gap = f"{len(absent)} of {len(names)} scenarios have no results: {', '.join(absent)}" if absent else ""
    complete = [policy for policy in specs if policy not in incomplete]
    if not complete:
        reasons = "; ".join(f"{policy}: {reason}" for policy, reason in incomplete.items())
        raise ValueError(
            f"there is no policy with a result for every scenario: {reasons or 'the store has none of the cells'}"
        )
    rows = [[finished[policy, task] for task in tasks] for policy in complete]
    runs = {name: np.array([[[run[name] for run in r.rows] for r in row] for row in rows]) for name in METRICS}
    decision = np.array([np.median([result.decision_us for result in row]) for row in rows])
    return Board(
        tuple(specs[policy] for policy in complete), tuple(tasks), rows[0][0].cell.seeds, runs, decision, incomplete, gap
    )  # fmt: skip


_Named = TypeVar("_Named", Scenario, PolicySpec)


def _by_name(things: Sequence[_Named]) -> dict[str, _Named]:
    named: dict[str, _Named] = {}
    for thing in things:
        if named.setdefault(thing.name, thing) != thing:
            raise ValueError(f"names on a board must differ, but two different entries are named {thing.name!r}")
    return named
