"""The uncertainty radius of each policy of a board, for `fbl-gym report --radius`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.analysis.statistics import Radius, radius
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.cell import compute
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from benchmarks.seeds import SPLITS
from fbl_gym import Scenario, scenarios
from fbl_gym.arm import ARMS, Array
from fbl_gym.real_arms import REAL_ARMS

BOUND, SHARE, LARGEST = 5.0, 0.95, 10.0
"""A seed tracks if its mean error is at most BOUND [%]. At the radius, the share SHARE of them
must. LARGEST is the paper's largest radius, 1000 %."""

DIRECTIONS = ("larger", "smaller", "both")


def with_radius(scenario: Scenario, r: float, direction: str) -> Scenario:
    """Return the scenario with real parameters within a radius, each by its own factor.

    "larger" draws real / nominal from [1, 1 + r], "smaller" from [1 / (1 + r), 1], "both" from [1 /
    (1 + r), 1 + r]; all log-uniformly.
    """
    if direction == "both":
        return scenario.replace(parameter_error={"radius": r})
    middle = np.sqrt(1.0 + r)
    ratio = middle if direction == "larger" else 1.0 / middle
    return scenario.replace(parameter_error={"ratio": ratio, "radius": middle - 1.0})


def task(like: Scenario) -> Scenario:
    """Return the scenario of a radius: the nominal one, on the arm and at the rate of another.

    It has no torque limits, which would otherwise set the radius.
    """
    arm = next((name for name, arm in (ARMS | REAL_ARMS).items() if arm == like.arm), "the suite's arm")
    return scenarios.get("nominal").replace(
        arm=like.arm, control_dt=like.control_dt, physics_dt=like.physics_dt, actuator=None,
        description=f"{arm} at {1 / like.control_dt:g} Hz",
    )  # fmt: skip


def search(errors: Callable[[float], Array], *, scan: int = 6, tolerance: float = 0.05) -> Radius:
    """Return the largest radius at which 95 % of the seeds track within 5 %.

    `errors` returns the error of each seed at a radius [%]; the rest is as in `statistics.radius`.
    """

    def success_share(r: float) -> float:
        return float(np.mean(errors(r) <= BOUND))

    return radius(success_share, bracket=(0.0, LARGEST), share=SHARE, scan=scan, tolerance=tolerance)


def stored_radius(
    policy: PolicySpec | str, direction: str, like: Scenario, store: Store, seeds: int = 64, tolerance: float = 0.05
) -> Radius:
    """Return a policy's radius in a direction; every radius tried is a cell of the store.

    The arm and the rate are those of the scenario `like`.
    """
    spec = resolve(policy)

    def errors(r: float) -> Array:
        scenario = with_radius(task(like), r, direction).replace(name=f"radius-{direction}-{r:.4g}")
        cell = Cell(spec, scenario, tuple(SPLITS["test"][:seeds]))
        outcome = compute(cell, store, "fbl-gym report --radius")
        result = store.find(cell)
        if result is None:
            raise ValueError(f"{spec.name} failed at radius {r:.3g}: {outcome.error}")
        return np.array([row["error_pct"] for row in result.rows])

    return search(errors, tolerance=tolerance)


def stored_radii(
    policies: Sequence[PolicySpec], like: Scenario, store: Store, workers: int, seeds: int = 64
) -> dict[tuple[str, str], Radius]:
    """Return the radius of each policy, by name, in each direction."""
    from joblib import Parallel, delayed, parallel_config

    searches = [(spec, direction) for spec in policies for direction in DIRECTIONS]
    with parallel_config(backend="loky", n_jobs=workers, inner_max_num_threads=1):
        radii = Parallel()(delayed(stored_radius)(spec, direction, like, store, seeds) for spec, direction in searches)
    return {(spec.name, direction): value for (spec, direction), value in zip(searches, radii, strict=True)}
