"""The record of a claim, and helpers to measure one."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from benchmarks.analysis.statistics import Estimate, proportion
from benchmarks.report.plot import Panel, plot_lines, plot_trace
from benchmarks.run.metrics import departure, measure
from benchmarks.run.rollout import Trace, Watch, rollout
from fbl_gym import SECTION_2_2, TABLE_1, ArmParameters, Scenario
from fbl_gym.arm import Array

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
        seconds: longest duration of an episode whose leakage is checked at every sample.
    """

    seeds: int
    many: int
    points: int
    seconds: float


FULL = Effort(seeds=64, many=512, points=8, seconds=20.0)
SHORT = Effort(seeds=64, many=64, points=3, seconds=3.0)

Draw: TypeAlias = Callable[[Path], None]
"""A function that draws a claim's figure to a file; the suffix sets the format."""

Measured: TypeAlias = tuple[Claim, Draw]


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


def judged(cases: Sequence[Case], draw: Draw, seeds: int = 1, **fields: Any) -> Measured:
    """Return a claim with its verdict, by the rule above, and the function that draws its figure.

    Args:
        cases: in which the claim was measured.
        draw: draws the figure to a file.
        seeds: number of the first seeds.
        **fields: the other fields of `Claim`.
    """
    fields["seed"] = "0" if seeds == 1 else f"0-{seeds - 1}"
    rows = tuple(case.row for case in cases)
    claimed = [case for case in cases if case.meets is not None]
    count = sum(case.holds for case in claimed)
    if not claimed:
        return Claim(verdict=NO_CLAIM, holds="", cases=rows, **fields), draw
    verdict = REPRODUCED if count == len(claimed) else UNDER_ASSUMPTIONS if count else NOT_REPRODUCED
    return Claim(verdict=verdict, holds=f"{count} of {len(claimed)}", cases=rows, **fields), draw


def quote(*cases: Case) -> str:
    """Return the measured values of some cases with their names."""
    return "; ".join(f"{case.measured} ({case.name})" for case in cases)


def draw_lines(title: str, panels: Sequence[Panel]) -> Draw:
    """Return a function that draws panels of lines."""
    return lambda path: plot_lines(title, panels, path)


def draw_trace(trace: Trace, title: str) -> Draw:
    """Return a function that draws the first seed of a trace."""
    return lambda path: plot_trace(trace, title, path)


def scaled(arm: ArmParameters, factor: float) -> ArmParameters:
    """Return the arm with masses and lengths times `factor`."""
    return dataclasses.replace(arm, **{name: factor * getattr(arm, name) for name in ("m1", "m2", "L1", "L2")})


def with_estimate(scenario: Scenario, real: ArmParameters, factor: float) -> Scenario:
    """Return the scenario with a real arm, and with nominal parameters `factor` times them."""
    return scenario.replace(arm=scaled(real, factor), parameter_error=1.0 / factor)


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
