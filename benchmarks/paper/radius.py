"""The uncertainty radius of the paper's controllers: the share of seeds that track, against it."""

import numpy as np

from benchmarks.paper.claim import ARMS, run, share
from benchmarks.report.plot import Line, Panel
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import Array

SHARE = 0.95
"""At the radius, this share of the seeds must track."""


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


def task(arm: str) -> Scenario:
    """Return way-points at 1 kHz without noise, friction and torque limit."""
    return scenarios.get("nominal").replace(arm=ARMS[arm], control_dt=1e-3, actuator=None, duration=4.0)


def radii(largest: float, points: int, claimed: float) -> Array:
    """Return radii up to the largest, evenly spaced in log(1 + r), and the claimed one."""
    return np.unique(np.append(np.expm1(np.linspace(0.0, np.log1p(largest), points)), claimed))


def errors(policy: str, scenario: Scenario, seeds: int) -> Array:
    """Return the mean tracking error of each seed [%]."""
    return run(policy, scenario, seeds)[1]["error_pct"]


def curve(policy: str, scenario: Scenario, direction: str, r: Array, seeds: int) -> Array:
    """Return the mean tracking error of each seed at each radius [len(r) x seeds] in %."""
    return np.array([errors(policy, with_radius(scenario, float(x), direction), seeds) for x in r])


def between(r: Array, error: Array) -> tuple[Array, Array]:
    """Return radii between those measured, and each seed's error there, linear in log(1 + r).

    A seed's factors are the same powers of 1 + r at every radius, so its error is smooth in r.
    """
    z = np.linspace(0.0, np.log1p(r[-1]), 400)
    return np.expm1(z), np.stack([np.interp(z, np.log1p(r), seed) for seed in error.T], axis=-1)


def radius(r: Array, error: Array, bound: float) -> tuple[float, float, float]:
    """Return the radius up to which 95 % of the seeds track within a bound, and its 95 % interval.

    The interval's ends are the radii at which the ends of the share's interval drop below 95 %.
    """
    fine, errors = between(r, error)
    shares = share(errors <= bound)
    ends: list[float] = []
    for curve_of_shares in (shares.value, shares.low, shares.high):
        below = np.flatnonzero(curve_of_shares < SHARE)
        ends.append(float(fine[max(below[0] - 1, 0)]) if len(below) else np.inf)
    return ends[0], ends[1], ends[2]


def radius_text(r: Array, error: Array, bound: float = 5.0) -> str:
    """Return a radius with its interval as text."""
    value, low, high = (f"≥ {r[-1]:.3g}" if np.isinf(x) else f"{x:.2f}" for x in radius(r, error, bound))
    return f"{value} [{low}, {high}]"


def share_panel(arm: str, r: Array, curves: dict[str, Array]) -> Panel:
    """Return the share of seeds within 5 % over the radius, a line for each curve."""
    lines = []
    for name, error in curves.items():
        fine, errors = between(r, error)
        shares = share(errors <= 5.0)
        lines.append(Line(fine, 100 * shares.value, name, low=100 * shares.low, high=100 * shares.high))
    marks = ((95.0, "95 %"),)
    return Panel(f"{arm}, within 5 %", "radius", "seeds that track [%]", tuple(lines), bounds=(0.0, 102.0), marks=marks)
