"""What a claim is, and what measuring one takes."""

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

REPRODUCED, READING, NOT = "reproduced", "under a reading", "not reproduced"
"""The verdicts. "under a reading": the paper is misprinted, ambiguous or silent, and the claim holds in the reading named."""

ARMS = {"section-2-2": SECTION_2_2, "table-1": TABLE_1}
"""The real arms that claims are measured on: §2.2 as printed, and Table 1."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper and what became of it.

    Args:
        figure: the figure, equation or section.
        claim: in short.
        paper: what the paper says.
        measured: what came out; the median over the seeds, unless said otherwise.
        verdict: "reproduced", "under a reading" or "not reproduced".
        reading: the choices under which it was measured.
        scenario: its name; what was changed in it is said in `reading`.
        seed: the seeds of the episodes.
        command: what measures this claim again, alone; `claims.measure_claim` knows it.
    """

    figure: str
    claim: str
    paper: str
    measured: str
    verdict: str
    reading: str
    scenario: str
    seed: str
    command: str = ""


@dataclass(frozen=True)
class Effort:
    """How much is run for a claim.

    Args:
        seeds: episodes, where chance is at work.
        ratios: points of a radius map.
        seconds: of an episode that is watched sample by sample, at most.
    """

    seeds: int
    ratios: int
    seconds: float


FULL, SHORT = Effort(seeds=16, ratios=13, seconds=20.0), Effort(seeds=2, ratios=2, seconds=3.0)

Draw: TypeAlias = Callable[[Path], None]
"""Draws a claim's figure into a file, whose ending says the format."""

Measured: TypeAlias = tuple[Claim, Draw]


def seed_range(seeds: int) -> str:
    """The first seeds as text: "0", or "0-15"."""
    return "0" if seeds == 1 else f"0-{seeds - 1}"


def scaled(arm: ArmParameters, factor: float) -> ArmParameters:
    """The arm with masses and lengths times `factor`."""
    return dataclasses.replace(arm, **{name: factor * getattr(arm, name) for name in ("m1", "m2", "L1", "L2")})


def with_estimate(scenario: Scenario, real: ArmParameters, factor: float) -> Scenario:
    """The scenario with this real arm, of which the nominal model has every parameter times `factor`."""
    return scenario.replace(arm=scaled(real, factor), parameter_error=1.0 / factor)


def run(
    policy: str, scenario: Scenario, seeds: int = 1, watch: dict[str, Watch] | None = None, **gains: Any
) -> tuple[Trace, dict[str, float]]:
    """The trace of the first seeds, and the median of each metric over them."""
    trace = rollout(policy, scenario, range(seeds), gains, watch)
    rows = measure(trace)
    return trace, {name: float(np.median([row[name] for row in rows])) for name in rows[0]}


def percents(values: Iterable[float]) -> str:
    """Numbers in per cent as text."""
    return " / ".join(f"{value:.3g} %" for value in values)
