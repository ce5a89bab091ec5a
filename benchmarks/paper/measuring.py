"""Measurements on the paper's arms: scenarios, metrics, and the uncertainty radius of its laws."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np

from benchmarks.paper.outcome import Outcome, Rows, Values, number, share
from benchmarks.report.plot import Line, Panel
from benchmarks.run.metrics import departure, measure
from benchmarks.run.rollout import Trace, rollout
from fbl_gym import SECTION_2_2, TABLE_1, Noise, Scenario, scenarios

#: Episodes of a random scenario. All of them must meet a claim: 39 are not enough.
SEEDS = 40

#: The real arms on which claims are measured: that of §2.2 as printed, and that of Table 1.
ARMS = {"§2.2": SECTION_2_2, "Table 1": TABLE_1}

#: Estimates over the real values, of all parameters or of m1, m2, L1, L2.
ESTIMATES: dict[str, Any] = {"exact": 1.0, "half": 0.5, "1.5 times": 1.5, "double": 2.0, "mixed": (0.5, 2.0, 2.0, 0.5)}

#: Variance of a sample on each sensor. For a signal of unit power, 1 dB is a variance of 0.794.
VARIANCES = {"variance 0.1": 0.1, "1 dB": 10**-0.1, "σ 0.01": 1e-4}

#: A reference that stays at the hanging position.
HANGING = {"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.0),)}


def at_rate(scenario: Scenario, rate: str, **options: Any) -> Scenario:
    """Return the scenario at a rate such as "1 kHz", with some options."""
    dt = 1e-3 / number(rate)
    return scenario.replace(control_dt=dt, physics_dt=dt, **options)


def noise(reading: str, rate: str) -> Noise | None:
    """Return the noise on every sensor: a variance of a sample, or "density 0.1"; "none"."""
    sigma = np.sqrt(100.0 * number(rate) if reading == "density 0.1" else VARIANCES.get(reading, 0.0))
    return Noise(position=sigma, velocity=sigma, acceleration=sigma) if sigma else None


def with_estimates(scenario: Scenario, arm: str, estimates: str) -> Scenario:
    """Return the scenario with a real arm, and with some estimates as its nominal parameters."""
    real, factors = ARMS[arm], np.broadcast_to(ESTIMATES[estimates], 4).astype(float)
    names = zip(("m1", "m2", "L1", "L2"), factors.tolist(), strict=True)
    nominal = dataclasses.replace(real, **{name: factor * getattr(real, name) for name, factor in names})
    return scenario.replace(arm=nominal, parameter_error={"ratio": tuple(1.0 / factors)})


def run(policy: str, scenario: Scenario, seeds: int = 1, watch: Any = None, **gains: Any) -> Trace:
    """Return the trace of the first seeds, with what is watched: a `Watch` by name."""
    return rollout(policy, scenario, range(seeds), gains, watch)


def score(trace: Trace) -> Rows:
    """Return each metric of every seed [n].

    Errors in % are shares of the reference's largest departure from the start, such as a step.
    """
    rows = measure(trace, departure(trace))
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@cache  # cases of several claims share runs
def metrics(policy: str, scenario: Scenario, seeds: int = 1, **gains: Any) -> Rows:
    """Return each metric of the first seeds [n]."""
    return score(run(policy, scenario, seeds, **gains))


# The uncertainty radius: the share of seeds that track, against it.

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


def track_within(v: Values) -> Outcome:
    """Return whether each seed tracks at the claimed radius, with the shares at all radii.

    A seed's factors are the same powers of 1 + r at every radius. An adaptive law has the first
    second of the motion only.
    """
    adaptive, claimed = v["law"] == "adaptive", number(v["radius"])
    gains = {} if v["law"] == "PID" else {"kp": number(v["Kp"])}
    scenario = at_rate(
        scenarios.get("nominal"), v["rate"], arm=ARMS[v["arm"]], actuator=None, duration=1.0 if adaptive else 4.0,
        disturbance=_LOADS[v["loads"]], noise=noise(v["noise"], v["rate"]),
    )  # fmt: skip
    meets = {}
    for r in (1.0, 3.0, 9.0) if adaptive else (0.1, 0.5, 1.0, 2.0):
        rows = metrics(_LAWS[v["law"]], with_radius(scenario, r, v["direction"]), 2 * SEEDS, **gains)
        meets[r] = rows["error_pct"] <= number(v["bound"])
    shares = share(np.array([*meets.values()]))
    text = ", ".join(f"{100 * part:.3g} % at {r:g}" for r, part in zip(meets, shares.value, strict=True))
    label = f"{v['law']}, {v['arm']}, {v['direction']}, Kp {v['Kp']}, noise {v['noise']}"
    line = Line(np.array([*meets]), 100 * shares.value, label, low=100 * shares.low, high=100 * shares.high)
    panel = Panel("", "radius", "seeds that track [%]", (line,), bounds=(0.0, 102.0), marks=((90.0, "90 %"),))
    drawn = v["bound"] == "5 %" and claimed >= 1.0
    return Outcome(meets[claimed], f"seeds within the bound: {text}", panel if drawn else None)
