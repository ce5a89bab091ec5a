"""How far off the model may be for a policy: the uncertainty radius, each step of its search a cell of the store."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.analysis.statistics import Radius, radius
from benchmarks.run.runner import run_cell
from benchmarks.run.store import Store
from benchmarks.run.suite import SPLITS, Cell
from fbl_gym import Scenario, scenarios

BOUND, SHARE, LARGEST = 5.0, 0.95, 10.0
"""A seed tracks within this mean error [%]; so must this share of them; up to this radius, the paper's 1000 %."""

DIRECTIONS = ("larger", "smaller", "both")


def with_radius(scenario: Scenario, r: float, direction: str) -> Scenario:
    """The scenario with real parameters within a radius, each by its own factor.

    Args:
        scenario: without parameter error.
        r: zero or more.
        direction: "larger" draws real / nominal from [1, 1 + r], "smaller" from [1 / (1 + r), 1], "both" from
            [1 / (1 + r), 1 + r]; all log-uniformly.
    """
    if direction == "both":
        return scenario.replace(parameter_error={"radius": r})
    middle = np.sqrt(1.0 + r)
    ratio = middle if direction == "larger" else 1.0 / middle
    return scenario.replace(parameter_error={"ratio": ratio, "radius": middle - 1.0})


def task() -> Scenario:
    """The nominal scenario without torque limits, which would otherwise set the radius."""
    return scenarios.get("nominal").replace(actuator=None)


def reach(policy: str, direction: str, store: Store, seeds: int = 64, tolerance: float = 0.05) -> Radius:
    """The largest radius at which 95 % of the seeds track within 5 %, by bisection. What the store has is not run again.

    Args:
        policy: its name.
        direction: of the error, see `with_radius`.
        store: for the cells of the search.
        seeds: how many test seeds.
        tolerance: of log(1 + r).
    """

    def share(r: float) -> float:
        scenario = with_radius(task(), r, direction).replace(name=f"radius-{direction}-{r:.4g}")
        cell = Cell(policy, scenario, tuple(SPLITS["test"][:seeds]))
        result = store.find(cell)
        if result is None:
            result = run_cell(cell, "fbl-gym report --radius")
            store.save(result)
        if result.error:
            raise ValueError(f"{policy} failed at radius {r:.3g}: {result.error}")
        return float(np.mean([row["error_pct"] <= BOUND for row in result.rows]))

    return radius(share, bracket=(0.0, LARGEST), share=SHARE, tolerance=tolerance)


def reaches(policies: Sequence[str], store: Store, workers: int, seeds: int = 64) -> dict[tuple[str, str], Radius]:
    """The radius of each policy in each direction."""
    from joblib import Parallel, delayed, parallel_config

    asked = [(policy, direction) for policy in policies for direction in DIRECTIONS]
    with parallel_config(backend="loky", n_jobs=workers, inner_max_num_threads=1):
        found = Parallel()(delayed(reach)(policy, direction, store, seeds) for policy, direction in asked)
    return dict(zip(asked, found, strict=True))
