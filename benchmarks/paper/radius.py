"""The uncertainty radius of the paper's controllers: the share of seeds that track, against it."""

from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.paper.claim import ARMS, SEEDS, Outcome, Values, at_rate, noise, number, run, share
from benchmarks.report.plot import Line
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import Array

RADIUS_PANEL = {"x": "radius", "y": "seeds that track [%]", "bounds": (0.0, 102.0), "marks": ((90.0, "90 %"),)}

RADII = {"adaptive": (1.0, 3.0, 9.0)}
"""Radii at which a law is measured; others: 0.1, 0.5, 1 and 2."""

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
def _errors(law: str, arm: str, direction: str, disturbed: str, reading: str, rate: str, kp: str) -> dict[float, Array]:
    """Return the mean tracking error of each seed [%] at each radius.

    A seed's factors are the same powers of 1 + r at every radius. An adaptive law has the first
    second of the motion only.
    """
    scenario = at_rate(
        scenarios.get("nominal"), rate, arm=ARMS[arm], actuator=None, duration=1.0 if law == "adaptive" else 4.0,
        disturbance=_LOADS[disturbed], noise=noise(reading, rate),
    )  # fmt: skip
    gains: dict[str, Any] = {} if law == "PID" else {"kp": number(kp)}
    return {
        r: run(_LAWS[law], with_radius(scenario, r, direction), 2 * SEEDS, **gains)[1]["error_pct"]
        for r in RADII.get(law, (0.1, 0.5, 1.0, 2.0))
    }


def track_within(v: Values) -> Outcome:
    """Return whether each seed tracks at the claimed radius, with the shares at all radii."""
    errors = _errors(*(v[name] for name in ("law", "arm", "direction", "loads", "noise", "rate", "Kp")))
    meets = {r: error <= number(v["bound"]) for r, error in errors.items()}
    shares = share(np.array([*meets.values()]))
    text = ", ".join(f"{100 * part:.3g} % at {r:g}" for r, part in zip(meets, shares.value, strict=True))
    label = f"{v['law']}, {v['arm']}, {v['direction']}, Kp {v['Kp']}, noise {v['noise']}"
    line = Line(np.array([*meets]), 100 * shares.value, label, low=100 * shares.low, high=100 * shares.high)
    claimed = number(v["radius"])
    drawn = v["bound"] == "5 %" and claimed >= 1.0
    return Outcome(meets[claimed], f"seeds within the bound: {text}", [line] if drawn else [])
