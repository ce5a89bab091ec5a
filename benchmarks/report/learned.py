"""What of a learned policy's error is its training seed's, and what the world's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.analysis.statistics import Components, Estimate, components, resample, trained
from benchmarks.report.markdown import table
from benchmarks.rl.policy import shipped
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import Scenario


@dataclass(frozen=True)
class Learned:
    """A shipped agent over all its training seeds on one scenario.

    Args:
        policy: its name.
        scenario: its name.
        training_seeds: how many.
        error: interquartile mean of the error in % over training and test seeds; its interval resamples both.
        parts: variances of the logarithm of the error: of training, of the world, of neither alone.
    """

    policy: str
    scenario: str
    training_seeds: int
    error: Estimate
    parts: Components


def learned(scenarios: Sequence[Scenario], seeds: Sequence[int], rng: int = 0) -> list[Learned]:
    """Each shipped agent with two training seeds or more on each scenario.

    Args:
        scenarios: the tasks.
        seeds: test seeds, the same for every agent.
        rng: seed of the bootstrap.
    """
    counts = resample(len(seeds), rng)
    found = []
    for policy, training in shipped().items():
        if len(training) < 2:
            continue
        for scenario in scenarios:
            runs = np.array(
                [
                    [row["error_pct"] for row in measure(rollout(policy, scenario, seeds, {"seed": seed}))]
                    for seed in training
                ]
            )
            estimate = trained(runs[:, None], counts, rng)
            found.append(Learned(policy, scenario.name, len(training), estimate, components(np.log(runs))))
    return found


def learned_table(rows: Sequence[Learned]) -> str:
    """The rows in Markdown."""
    header = (
        "policy",
        "scenario",
        "training seeds",
        "error %",
        "of the variance of log error: training",
        "world",
        "neither",
    )
    lines = []
    for row in rows:
        parts = np.array([row.parts.training, row.parts.world, row.parts.rest])
        shares = [f"{100 * share:.0f} %" for share in parts / parts.sum()]
        label = f", {row.error.label}" if row.error.label else ""
        error = f"{row.error.value:.3f} ({row.error.low:.3f}–{row.error.high:.3f}{label})"
        lines.append((f"`{row.policy}`", row.scenario, str(row.training_seeds), error, *shares))
    return table(header, lines)
