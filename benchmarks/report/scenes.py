"""The page's moving arms: one seed of a few scenarios, by every policy, as plain data."""

from collections.abc import Mapping, Sequence
from typing import Any

from fbl_gym import Scenario
from fbl_gym.scenarios import member

SCENES = 12
"""Largest number of scenarios with moving arms."""


def selected(scenarios: Sequence[str]) -> list[str]:
    """Return the scenarios of the page: all, or those of severity 2 where there are many."""
    if len(scenarios) <= SCENES:
        return list(scenarios)
    members = [(name, member(name)) for name in scenarios]
    return [name for name, place in members if place and (place.family == "nominal" or place.severity == 2)][:SCENES]


def scene(scenario: Scenario, seed: int, traces: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the moving arms of one seed of a scenario.

    Args:
        scenario: of the traces.
        seed: of the traces.
        traces: from `load_trace`, by policy, at least one.
    """
    first = next(iter(traces.values()))
    shared = ("time", "lengths", "reference", "disturbance")
    return {
        "scenario": scenario.name,
        "description": scenario.description,
        "seed": seed,
        **{name: first[name] for name in shared},
        "runs": [
            {"policy": policy, **{name: value for name, value in trace.items() if name not in shared}}
            for policy, trace in traces.items()
        ],
    }
