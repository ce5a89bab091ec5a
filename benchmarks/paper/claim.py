"""The record of a claim, and helpers to measure one."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from benchmarks.analysis.statistics import Estimate, proportion
from benchmarks.report.plot import Panel, plot_lines, plot_trace
from benchmarks.run.metrics import departure, measure
from benchmarks.run.rollout import Trace, Watch, rollout
from fbl_gym import SECTION_2_2, TABLE_1, ArmParameters, Scenario, scenarios
from fbl_gym.model.arm import Array

REPRODUCED, UNDER_ASSUMPTIONS, NOT_REPRODUCED, NO_CLAIM = "reproduced", "under assumptions", "not reproduced", "–"
"""The verdicts, by one rule. A claim is measured in cases: at the paper's stated values, with
misprints corrected, and at several values of all that it leaves open. "reproduced": it holds in all
cases; "under assumptions": in some; "not reproduced": in none. "–": the paper does not claim it."""

LEAST = 0.9
"""A claim holds in a case if the 95 % interval of the share of seeds that meet it lies above this.
A diverged run does not meet it."""

ARMS = {"§2.2": SECTION_2_2, "Table 1": TABLE_1}
"""The real arms on which claims are measured: that of §2.2 as printed, and that of Table 1."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper and its measurement.

    Args:
        figure: number of the figure, equation or section.
        claim: in one line.
        paper: statement or value of the paper.
        measured: value measured here; the median over the seeds, if not stated otherwise.
        verdict: by the rule above.
        holds: number of cases in which the claim holds.
        assumptions: under which the claim was measured.
        scenario: name of the scenario; `assumptions` states the changes to it.
        seed: seeds of the episodes.
        cases: name, measured value, seeds that meet the claim, and "yes" or "no" of each case.
        command: that measures this claim again; set by `claims.measure_claim`.
    """

    figure: str
    claim: str
    paper: str
    measured: str
    verdict: str
    holds: str
    assumptions: str
    scenario: str
    seed: str
    cases: tuple[tuple[str, ...], ...] = ()
    command: str = ""


@dataclass(frozen=True)
class Effort:
    """The amount of simulation for a claim.

    Args:
        seeds: number of episodes of a random scenario.
        many: number of episodes for a share near 95 %.
        points: number of points of a map.
        seconds: longest duration of an episode of the paper's scenarios, which step every 2 or 4 s.
    """

    seeds: int
    many: int
    points: int
    seconds: float

    @property
    def short(self) -> bool:
        """True for fewer cases and shorter episodes, where the verdict stays the same."""
        return self.points < 4

    def scenario(self, name: str) -> Scenario:
        """Return a scenario of the paper, of which the short form has the first seconds only."""
        scenario = scenarios.get(name)
        return scenario.replace(duration=min(self.seconds, scenario.duration), name=name)


FULL = Effort(seeds=64, many=512, points=8, seconds=20.0)
SHORT = Effort(seeds=64, many=64, points=3, seconds=4.0)


@dataclass(frozen=True)
class Case:
    """A claim at one value of what the paper leaves open.

    Args:
        name: the values.
        meets: whether each run meets the claim [n]; one flag for a measurement without chance.
            None: the case is shown, but the paper does not claim it.
        measured: value measured in this case.
    """

    name: str
    meets: Any = None
    measured: str = ""

    @property
    def share(self) -> Estimate:
        """Share of runs that meet the claim, with its interval by Clopper and Pearson."""
        return share(np.atleast_1d(self.meets))

    @property
    def holds(self) -> bool:
        """True if the claim holds in this case."""
        return bool(np.all(self.meets)) if np.size(self.meets) == 1 else bool(self.share.low >= LEAST)

    @property
    def row(self) -> tuple[str, ...]:
        """The case as texts, for `Claim.cases`."""
        if self.meets is None:
            return self.name, self.measured, "", ""
        low, high = (100 * float(end) for end in (self.share.low, self.share.high))
        seeds = f"{np.sum(self.meets)} of {np.size(self.meets)}, {low:.0f}–{high:.0f} %"
        return self.name, self.measured, seeds if np.size(self.meets) > 1 else "", "yes" if self.holds else "no"


def share(meets: Any) -> Estimate:
    """Return the share of True along the last axis, with its 95 % interval."""
    return proportion(np.sum(meets, axis=-1), np.shape(meets)[-1])


def judge(cases: Sequence[Case]) -> tuple[str, str]:
    """Return the verdict by the rule above, and the number of cases in which the claim holds."""
    holds = [case.holds for case in cases if case.meets is not None]
    if not holds:
        return NO_CLAIM, ""
    verdict = REPRODUCED if all(holds) else UNDER_ASSUMPTIONS if any(holds) else NOT_REPRODUCED
    return verdict, f"{sum(holds)} of {len(holds)}"


class Finding(NamedTuple):
    """The measurement of a claim.

    Attributes:
        cases: in which the claim was measured.
        measured: field of `Claim`.
        title: of the figure.
        drawn: panels of the figure, or a trace.
        seeds: number of the first seeds.
    """

    cases: Sequence[Case]
    measured: str
    title: str
    drawn: Sequence[Panel] | Trace
    seeds: int = 1

    def draw(self, path: Path) -> None:
        """Draw the figure to a file."""
        if isinstance(self.drawn, Trace):
            plot_trace(self.drawn, self.title, path)
        else:
            plot_lines(self.title, self.drawn, path)


class Declared(NamedTuple):
    """A claim, with the fields of `Claim` that are known before the measurement."""

    fields: dict[str, str]
    measure: Callable[[Effort], Finding]


def claim(
    figure: str, text: str, *, paper: str, scenario: str = "nominal", assumptions: str = ""
) -> Callable[[Callable[[Effort], Finding]], Declared]:
    """Declare a claim, which the decorated function measures; the function's name is the claim's.

    The arguments are fields of `Claim`. Without assumptions, the scenario's description states
    them.
    """
    assumptions = assumptions or scenarios.get(scenario).description
    fields = {"figure": figure, "claim": text, "paper": paper, "assumptions": assumptions, "scenario": scenario}
    return lambda measure: Declared(fields, measure)


def quote(*cases: Case) -> str:
    """Return the measured values of some cases with their names."""
    return "; ".join(f"{case.measured} ({case.name})" for case in cases)


def with_estimate(scenario: Scenario, real: ArmParameters, factor: float) -> Scenario:
    """Return the scenario with a real arm, and with nominal parameters `factor` times them.

    Parameters are masses and lengths.
    """
    nominal = {name: factor * getattr(real, name) for name in ("m1", "m2", "L1", "L2")}
    return scenario.replace(arm=dataclasses.replace(real, **nominal), parameter_error=1.0 / factor)


Rows: TypeAlias = dict[str, Array]
"""The metrics of each seed, by name."""


def run(
    policy: str, scenario: Scenario, seeds: int = 1, watch: Mapping[str, Watch] | None = None, **gains: Any
) -> tuple[Trace, Rows]:
    """Return the trace of the first seeds, and each metric of every seed [n].

    Errors in % are shares of the reference's largest departure from the start, such as a step.
    """
    trace = rollout(policy, scenario, range(seeds), gains, watch)
    rows = measure(trace, departure(trace))
    return trace, {name: np.array([row[name] for row in rows]) for name in rows[0]}


def percents(*values: Array | float) -> str:
    """Return medians in per cent as text."""
    return " / ".join(f"{np.median(value):.3g} %" for value in values)


def diverged(rows: Rows) -> str:
    """Return the number of diverged seeds as text; empty if there is none."""
    count = int(rows["diverged"].sum())
    return f" ({count} of {len(rows['diverged'])} diverged)" if count else ""
