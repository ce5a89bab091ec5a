"""The uncertainty radius of the paper's controllers: the share of seeds that track, against it."""

from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.paper.claim import ARMS, Outcome, Values, at_rate, noise, number, run, share
from benchmarks.report.plot import Line
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import Array

SHARE = 0.95
"""At the radius, this share of the seeds must track."""

RADIUS_PANEL = {"x": "radius", "y": "seeds that track [%]", "bounds": (0.0, 102.0), "marks": ((95.0, "95 %"),)}

_LAWS = {"cascade": "cascade-flm", "cascade and filter": "robust-flm", "PID": "pid-flm", "adaptive": "adaptive-flm"}
_LOADS = {"none": None, "50 and 20 N m": {"kind": "piecewise-constant", "amplitude": (50.0, 20.0), "period": 0.5}}


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


@lru_cache
def _curve(law: str, arm: str, direction: str, disturbed: str, reading: str, rate: str, kp: str) -> tuple[Array, Array]:
    """Return radii, and the mean tracking error of each seed at each of them [% radii x seeds].

    The radii are evenly spaced in log(1 + r), with the claimed ones among them. An adaptive law has
    the first second only, and fewer seeds: from 73 on, the interval of a share of 100 % lies above
    95 %.
    """
    adaptive = law == "adaptive"
    largest, claimed, seeds, seconds = (10.0, [9.0], 80, 1.0) if adaptive else (3.5, [0.1, 1.0], 128, 4.0)
    radii = np.unique([*np.expm1(np.linspace(0.0, np.log1p(largest), 6)), *claimed])
    scenario = at_rate(
        scenarios.get("nominal"), rate, arm=ARMS[arm], actuator=None, duration=seconds, disturbance=_LOADS[disturbed],
        noise=noise(reading, rate),
    )  # fmt: skip
    gains: dict[str, Any] = {} if law == "PID" else {"kp": number(kp)}
    tasks = [with_radius(scenario, float(r), direction) for r in radii]
    return radii, np.array([run(_LAWS[law], task, seeds, **gains)[1]["error_pct"] for task in tasks])


def _between(r: Array, error: Array) -> tuple[Array, Array]:
    """Return radii between those measured, and each seed's error there, linear in log(1 + r).

    A seed's factors are the same powers of 1 + r at every radius, so its error is smooth in r.
    """
    z = np.linspace(0.0, np.log1p(r[-1]), 400)
    return np.expm1(z), np.stack([np.interp(z, np.log1p(r), seed) for seed in error.T], axis=-1)


def radius(r: Array, error: Array, bound: float) -> tuple[float, float, float]:
    """Return the radius up to which 95 % of the seeds track within a bound, and its 95 % interval.

    The interval's ends are the radii at which the ends of the share's interval drop below 95 %.
    """
    fine, errors = _between(r, error)
    shares = share(errors <= bound)
    ends: list[float] = []
    for curve_of_shares in (shares.value, shares.low, shares.high):
        below = np.flatnonzero(curve_of_shares < SHARE)
        ends.append(float(fine[max(below[0] - 1, 0)]) if len(below) else np.inf)
    return ends[0], ends[1], ends[2]


def track_within(v: Values) -> Outcome:
    """Return whether each seed tracks within the bound at a radius, and the radius of 95 %."""
    r, error = _curve(*(v[name] for name in ("law", "arm", "direction", "loads", "noise", "rate", "Kp")))
    bound, claimed = number(v["bound"]), number(v["radius"])
    meets = error[np.flatnonzero(r == claimed)[0]] <= bound
    value, low, high = (f"≥ {r[-1]:.3g}" if np.isinf(x) else f"{x:.2f}" for x in radius(r, error, bound))
    fine, errors = _between(r, error)
    shares = share(errors <= bound)
    label = f"{v['law']}, {v['arm']}, {v['direction']}, Kp {v['Kp']}"
    line = Line(fine, 100 * shares.value, label, low=100 * shares.low, high=100 * shares.high)
    lines = [line] if v["bound"] == "5 %" and claimed >= 1.0 else []
    text = f"{100 * np.mean(meets):.1f} % of the seeds; 95 % up to a radius of {value} [{low}, {high}]"
    return Outcome(meets, text, lines)
