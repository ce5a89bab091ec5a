"""The record of a claim, and helpers to measure one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from benchmarks.run.metrics import measure
from benchmarks.run.rollout import Trace, Watch, rollout
from fbl_gym import SECTION_2_2, TABLE_1, ArmParameters, Scenario

REPRODUCED, UNDER_ASSUMPTIONS, NOT_REPRODUCED = "reproduced", "under assumptions", "not reproduced"
"""The verdicts. "under assumptions": the paper is misprinted, ambiguous or silent, and
the claim holds
under the assumptions that are named."""

ARMS = {"section-2-2": SECTION_2_2, "table-1": TABLE_1}
"""The real arms on which claims are measured: that of §2.2 as printed, and that of Table 1."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper and its measurement.

    Args:
        figure: number of the figure, equation or section.
        claim: in one line.
        paper: statement or value of the paper.
        measured: value measured here; the median over the seeds, if not stated otherwise.
        verdict: "reproduced", "under assumptions" or "not reproduced".
        assumptions: under which the claim was measured.
        scenario: name of the scenario; `assumptions` states the changes to it.
        seed: seeds of the episodes.
        command: that measures this claim again; set by `claims.measure_claim`.
    """

    figure: str
    claim: str
    paper: str
    measured: str
    verdict: str
    assumptions: str
    scenario: str
    seed: str
    command: str = ""


@dataclass(frozen=True)
class Effort:
    """The amount of simulation for a claim.

    Args:
        seeds: number of episodes of a random scenario.
        ratios: number of points of a map over the radius.
        seconds: longest duration of an episode whose leakage is checked at every sample.
    """

    seeds: int
    ratios: int
    seconds: float


FULL, SHORT = Effort(seeds=16, ratios=13, seconds=20.0), Effort(seeds=2, ratios=2, seconds=3.0)

Draw: TypeAlias = Callable[[Path], None]
"""A function that draws a claim's figure to a file; the suffix sets the format."""

Measured: TypeAlias = tuple[Claim, Draw]


def verdict(reproduced: bool = False, under_assumptions: bool = False) -> str:
    """Return the verdict on a claim.

    Args:
        reproduced: the claim holds.
        under_assumptions: it holds under the assumptions named.
    """
    return REPRODUCED if reproduced else UNDER_ASSUMPTIONS if under_assumptions else NOT_REPRODUCED


def seed_range(seeds: int) -> str:
    """Return the first seeds as text, such as "0" or "0-15"."""
    return "0" if seeds == 1 else f"0-{seeds - 1}"


def scaled(arm: ArmParameters, factor: float) -> ArmParameters:
    """Return the arm with masses and lengths times `factor`."""
    return dataclasses.replace(arm, **{name: factor * getattr(arm, name) for name in ("m1", "m2", "L1", "L2")})


def with_estimate(scenario: Scenario, real: ArmParameters, factor: float) -> Scenario:
    """Return the scenario with a real arm, and with nominal parameters `factor` times them."""
    return scenario.replace(arm=scaled(real, factor), parameter_error=1.0 / factor)


def run(
    policy: str, scenario: Scenario, seeds: int = 1, watch: dict[str, Watch] | None = None, **gains: Any
) -> tuple[Trace, dict[str, float]]:
    """Return the trace of the first seeds, and the median of each metric over them."""
    trace = rollout(policy, scenario, range(seeds), gains, watch)
    rows = measure(trace)
    return trace, {name: float(np.median([row[name] for row in rows])) for name in rows[0]}


def percents(values: Iterable[float]) -> str:
    """Return numbers in per cent as text."""
    return " / ".join(f"{value:.3g} %" for value in values)
