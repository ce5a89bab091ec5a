"""The board: what the results of a suite say of each policy, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks.analysis import statistics
from benchmarks.analysis.statistics import Estimate
from benchmarks.policies import resolve
from benchmarks.run.metrics import METRICS
from benchmarks.run.store import Result
from fbl_gym.arm import Array

ORACLE = "oracle-flm"
"""The policy whose error scores 100."""

UNSCORED = f"No scores, since they need the errors of {ORACLE}, which is not on this board; ranked by the mean error."
"""What a board without the oracle says."""

CHANCE = 0
"""Seed of the bootstrap."""


@dataclass(frozen=True)
class Board:
    """Results of several policies on the same scenarios and seeds. p policies, s scenarios, n seeds.

    Args:
        policies: [p], those with a result for every scenario.
        scenarios: [s] names.
        seeds: [n].
        runs: each metric, [p x s x n].
        decision_us: of each policy, the median over scenarios [p].
        incomplete: policies left out, each with the reason.
    """

    policies: tuple[str, ...]
    scenarios: tuple[str, ...]
    seeds: tuple[int, ...]
    runs: dict[str, Array]
    decision_us: Array
    incomplete: dict[str, str]

    @property
    def errors(self) -> Array:
        """Mean absolute tracking error in % of the reference's amplitude, [p x s x n]."""
        return self.runs["error_pct"]

    @cached_property
    def ranked(self) -> list[int]:
        """The policies that are ranked: those that are not told the truth."""
        return [i for i, policy in enumerate(self.policies) if resolve.access(policy) != "privileged"]

    @cached_property
    def counts(self) -> Array:
        """How often each resample counts each seed; see `statistics.resample`."""
        return statistics.resample(len(self.seeds), CHANCE)

    @cached_property
    def scores(self) -> Array | None:
        """Scores of the runs [p x s x n]; None where the oracle has not run."""
        if ORACLE not in self.policies:
            return None
        oracle = self.errors[self.policies.index(ORACLE)]
        return statistics.score(self.errors, self.runs["stay_pct"], oracle, self.runs["diverged"])

    @cached_property
    def score(self) -> Estimate | None:
        """The mean score of each policy [p]: the mean, since a policy that fails now and then must feel it."""
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
    def failures(self) -> Estimate:
        """Share of each policy's runs that diverged [p]."""
        failed = self.runs["diverged"]
        return statistics.failures(failed.sum(axis=(1, 2)), np.full(len(failed), failed[0].size))

    @cached_property
    def rank(self) -> Estimate:
        """Rank of each ranked policy, in the order of `ranked`; by score, or by error where there is no oracle."""
        better = self.errors if self.scores is None else -self.scores
        return statistics.ranks(statistics.mean(better[self.ranked], self.counts))

    @cached_property
    def order(self) -> list[int]:
        """The policies, the best first; those told the truth stand at the end."""
        value = self.mean_error.value if self.score is None else -self.score.value
        told = [resolve.access(policy) == "privileged" for policy in self.policies]
        return sorted(range(len(self.policies)), key=lambda i: (told[i], value[i]))

    @cached_property
    def families(self) -> dict[str, list[int]]:
        """The scenarios of each family, as indices."""
        found: dict[str, list[int]] = {}
        for i, scenario in enumerate(self.scenarios):
            found.setdefault(family_of(scenario), []).append(i)
        return found

    @cached_property
    def family_errors(self) -> dict[str, Estimate]:
        """The interquartile mean of each policy's errors in each family [p]."""
        found = self.families.items()
        return {family: statistics.estimate(self.errors[:, indices], self.counts) for family, indices in found}

    def degradation(self, family: str, arm: str) -> tuple[list[int], Estimate] | None:
        """Severities [k], and the interquartile mean of each policy's errors at each [p x k]; None with fewer than two.

        Args:
            family: of scenarios, such as "mass-error".
            arm: the head of its scenarios' names: "" for Table 1's arm, or "section-2-2/".
        """
        named = {severity: f"{arm}{family}-{severity}" for severity in (1, 2, 3)} | {0: f"{arm}nominal"}
        at = {s: self.scenarios.index(named[s]) for s in range(4) if named[s] in self.scenarios}
        if len(at) < 2:
            return None
        runs = self.errors[:, list(at.values())][:, :, None]
        return list(at), statistics.estimate(runs, self.counts)


def family_of(scenario: str) -> str:
    """The family of a scenario, such as "mass-error".  scenario: a name, such as "section-2-2/mass-error-2@1000Hz"."""
    own = scenario.rpartition("/")[2].partition("@")[0]
    head, _, tail = own.rpartition("-")
    return head if head and tail.isdigit() else own


def assemble(results: Sequence[Result]) -> Board:
    """The board of a suite's results. Policies that lack a scenario, or failed, are left out and named.

    Args:
        results: of cells with the same seeds.
    """
    scenarios = tuple(dict.fromkeys(r.cell.scenario.name for r in results))
    policies = tuple(dict.fromkeys(r.cell.policy for r in results))
    found = {(r.cell.policy, r.cell.scenario.name): r for r in results if r.rows}
    incomplete = {r.cell.policy: r.error for r in results if r.error}
    for policy in policies:
        lacking = [s for s in scenarios if (policy, s) not in found]
        if lacking and policy not in incomplete:
            incomplete[policy] = f"no result yet for {lacking[0]}" + (
                f" and {len(lacking) - 1} more" if lacking[1:] else ""
            )
    kept = tuple(policy for policy in policies if policy not in incomplete)
    if not kept:
        raise ValueError("there is no policy with a result for every scenario: " + _because(incomplete))
    first = found[kept[0], scenarios[0]].cell
    runs = {
        name: np.array([[[row[name] for row in found[p, s].rows] for s in scenarios] for p in kept]) for name in METRICS
    }
    decision = np.array([np.median([found[p, s].decision_us for s in scenarios]) for p in kept])
    return Board(kept, scenarios, first.seeds, runs, decision, incomplete)


def _because(reasons: dict[str, str]) -> str:
    return "; ".join(f"{policy}: {reason}" for policy, reason in reasons.items()) or "the store has none of the cells"
