"""The page's moving arms: one seed of a few scenarios, by every policy, as plain data."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.run.metrics import measure
from benchmarks.run.rollout import Trace
from fbl_gym.scenarios import member

POINTS = 201
"""Largest number of samples of a signal in the page: the start and 200 steps."""

SCENES = 12
"""Largest number of scenarios with moving arms."""


def selected(scenarios: Sequence[str]) -> list[str]:
    """Return the scenarios of the page: all, or those of severity 2 where there are many."""
    if len(scenarios) <= SCENES:
        return list(scenarios)
    members = [(name, member(name)) for name in scenarios]
    return [name for name, place in members if place and (place.family == "nominal" or place.severity == 2)][:SCENES]


def first_of(traces: Mapping[str, Trace]) -> Trace:
    """Return the first of some traces; all must be of one scenario and the same seeds."""
    if not traces:
        raise ValueError("traces must have at least one trace, got none")
    first = next(iter(traces.values()))
    for policy, trace in traces.items():
        if (trace.scenario, trace.seeds) != (first.scenario, first.seeds):
            raise ValueError(
                f"traces must be of one scenario and the same seeds, got {first.scenario.name!r} with seeds {first.seeds} "
                f"and, for {policy}, {trace.scenario.name!r} with seeds {trace.seeds}"
            )
    return first


def scene(traces: Mapping[str, Trace], lane: int = 0) -> dict[str, Any]:
    """Return one lane of some traces, thinned so that the page stays small.

    Time is in s, `lengths` in m. `reference` and `disturbance` are [2 x k], in rad and N m. So are
    `position` and `torque` of each run, which are NaN after it diverged; `diverged` is the time of
    that, or None.
    """
    first = first_of(traces)
    samples = slice(0, None, math.ceil((len(first.time) - 1) / (POINTS - 1)))
    runs = []
    for policy, trace in traces.items():
        alive = trace.alive[:, lane]
        position, torque = (np.where(alive[:, None], x[:, lane], np.nan) for x in (trace.position, trace.torque))
        runs.append(
            {
                "policy": policy,
                "position": position[samples].T,
                "torque": torque[samples].T,
                "error_pct": measure(trace)[lane]["error_pct"],
                "diverged": None if alive.all() else float(trace.time[np.argmin(alive)]),
            }
        )
    return {
        "scenario": first.scenario.name,
        "description": first.scenario.description,
        "seed": first.seeds[lane],
        "time": first.time[samples],
        "lengths": first.lengths[lane],
        "reference": first.reference[samples, lane].T,
        "disturbance": first.disturbance[samples, lane].T,
        "runs": runs,
    }
