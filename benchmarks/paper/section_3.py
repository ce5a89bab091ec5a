"""Section 3: the cascade and the Kalman filter; figure 4, equations (10) and (19) to (21)."""

from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.paper.claim import Outcome, Rows, Values, claim, diverged, number, percents
from benchmarks.paper.measuring import SEEDS, at_rate, noise, run, track_within, with_estimates
from benchmarks.paper.section_2 import HANGING
from benchmarks.report.plot import Line
from benchmarks.run.rollout import Trace
from controllers.paper.kalman import PAPER_SIGMA
from fbl_gym import scenarios

_DECAY: dict[str, Any] = {
    "paper": "E = exp(-Kp t)",
    "stated": {"estimates": ("exact",), "feed-forward of the acceleration": ("0",)},
    "panel": {"x": "time [s]", "y": "error / first error", "bounds": (-0.8, 1.0)},
}


def _decay(v: Values) -> tuple[float, float, float, str, Line]:
    """Return shortest and longest time to 1 % over exp(-Kp t)'s, overshoot [%], text and line.

    The arm hangs, E(0) is 0.1 rad, and the torque has no limit. (10) assumes a perfect inner loop.
    Feed-forward 1 adds the derivative of the velocity reference, r'' + Kp (r' - v).
    """
    kp, feedforward = number(v["Kp"]), number(v["feed-forward of the acceleration"])
    duration = round(min(1.0 + 10.0 / kp, 6.0), 3)
    hanging = scenarios.get("nominal").replace(actuator=None, reference=HANGING, initial_error=0.1)
    trace, _ = run("cascade-flm", at_rate(hanging, "10 kHz", duration=duration), kp=kp, feedforward=feedforward)
    error = (trace.reference - trace.position)[:, 0]
    parts = error / error[0]
    outside = np.abs(parts) > 0.01
    times = trace.time[len(parts) - np.argmax(outside[::-1], axis=0)]
    ideal, overshoot = np.log(100.0) / kp, 100 * max(-parts.min(), 0.0)
    text = f"1 % after {times[0]:.3g} and {times[1]:.3g} s, exp(-Kp t) after {ideal:.3g} s, overshoot {overshoot:.2g} %"
    near = trace.time <= 0.6
    line = Line(trace.time[near], parts[near, 0], f"Kp {v['Kp']}" + (", feed-forward" if feedforward else ""))
    return times.min() / ideal, times.max() / ideal, overshoot, text, line


@claim(
    "(10)", "the error decays as exp(-Kp t)", **_DECAY, chosen={"Kp": "10"},
    bound="both joints are within 1 % for good after ln(100) / Kp, to 10 %, and overshoot by less than 1 %",
    cases=[{"Kp": "1"}, {"Kp": "3"}, {"feed-forward of the acceleration": "1"}],
)  # fmt: skip
def equation_10(v: Values) -> Outcome:
    fast, slow, overshoot, text, line = _decay(v)
    return Outcome(fast > 0.9 and slow < 1.1 and overshoot < 1.0, text, [line])


@claim(
    "(10)", "the decay is arbitrarily fast by Kp", **_DECAY, chosen={"Kp": "1000"},
    bound="both joints are within 1 % for good after at most 1.1 ln(100) / Kp, at a Kp above 10",
    cases=[{"Kp": "30"}, {"Kp": "100"}, {"feed-forward of the acceleration": "1"}],
)  # fmt: skip
def equation_10_fast(v: Values) -> Outcome:
    _, slow, _, text, line = _decay(v)
    return Outcome(slow < 1.1, text, [line])


_FIGURE_4: dict[str, Any] = {
    "stated": {
        "estimates": ("half",), "noise": ("variance 0.1", "1 dB", "density 0.1"), "filter": ("on",), "power": ("1",),
    },
    "chosen": {"arm": "§2.2", "Kp": "10", "reference": "8 rad/s", "rate": "1 kHz"},
    "scenario": "paper-4b, 4 s, one step of both joints from -a to a behind a filter; a makes the power of the motion 1",
}  # fmt: skip
_UNFILTERED = _FIGURE_4 | {"stated": _FIGURE_4["stated"] | {"filter": ("none",)}}
_BEST = {"Kp": "150", "reference": "2 rad/s"}
_FASTER = {**_BEST, "rate": "10 kHz"}
_ONE_JOINT = "0.5, joint 1 alone"
READINGS = [{"noise": "1 dB"}, {"noise": "density 0.1"}]
_SMALL = {"noise": "σ 0.01"}
_SMALL_STEPS = {**_SMALL, "power": "0.3 to 0.4, steps of paper-4b"}
TABLE_1, _DOUBLE = {"arm": "Table 1"}, {"estimates": "double"}


def _figure_4(v: Values, watch: Any = None, **gains: Any) -> tuple[Trace, Rows]:
    """Return the trace and the metrics of the cascade on figure 4's motion of 4 s.

    The step behind the filter, 1 - 2 (1 + w t) exp(-w t), has a power of 1 - 3 / (4 w) in 4 s.
    """
    base, w = scenarios.get("paper-4b"), number(v["reference"])
    a = (1.0 - 0.75 / w) ** -0.5
    steps = {"1": ((-a, -a), (a, a)), _ONE_JOINT: ((0.0, 0.0), (1.0, 0.0))}
    points, seconds = (steps[v["power"]], 4.0) if v["power"] in steps else (vars(base.reference)["points"], 2.0)
    scenario = at_rate(
        with_estimates(base, v["arm"], v["estimates"]), v["rate"], duration=seconds * (len(points) - 1),
        reference={"kind": "filtered-steps", "points": points, "period": seconds, "bandwidth": w},
        noise=noise(v["noise"], v["rate"]), limits={"acceleration": 1e9, "position": 1e3, "velocity": 1e4},
    )  # fmt: skip
    policy = "robust-flm" if v["filter"] == "on" else "cascade-flm"
    return run(policy, scenario, SEEDS, watch, kp=number(v["Kp"]), **gains)


@lru_cache(maxsize=128)
def _cached_rows(values: tuple[tuple[str, Any], ...]) -> Rows:
    return _figure_4(dict(values))[1]


def _rows(v: Values) -> Rows:
    """Return the metrics of figure 4, which several claims share."""
    return _cached_rows(tuple(sorted(v.items())))


@claim(
    "4a", "noise degrades the cascade without a filter", paper="large position tracking error", **_UNFILTERED,
    bound="the mean error is more than 1.5 times that without noise",
    cases=[_BEST, *READINGS, TABLE_1, _DOUBLE, _SMALL, {**_SMALL, **_BEST}],
)  # fmt: skip
def figure_4a(v: Values) -> Outcome:
    noisy, clean = _rows(v), _rows({**v, "noise": "none"})
    times = np.median(noisy["variation"] / clean["variation"])
    text = f"mean error {percents(noisy['error_pct'])}{diverged(noisy)}, {percents(clean['error_pct'])} without noise; "
    text += f"{times:.3g} times the torque's variation"
    return Outcome(noisy["error_pct"] > 1.5 * clean["error_pct"], text)


@claim(
    "4a, 4b", "the Kalman filter removes the noise", paper="degraded without the filter, good with it", **_FIGURE_4,
    bound="the torque varies by less than a fifth of that without the filter, and the error does not grow by 5 %",
    cases=[_BEST, *READINGS, TABLE_1, _DOUBLE, _SMALL, {**_SMALL, **_BEST}, {**_SMALL, **_DOUBLE}],
)  # fmt: skip
def figure_4b_filter(v: Values) -> Outcome:
    without, rows = _rows({**v, "filter": "none"}), _rows(v)
    part = rows["variation"] / without["variation"]
    text = f"mean error {percents(rows['error_pct'])}{diverged(rows)}, {percents(without['error_pct'])} without the filter; "
    text += f"{100 * np.median(part):.2g} % of the torque's variation"
    return Outcome((part < 0.2) & (rows["error_pct"] < 1.05 * without["error_pct"]), text)


def _numbers(rows: Rows) -> str:
    """Return the three numbers of figure 4b as text."""
    error, overshoot = percents(rows["error_pct"]), percents(rows["overshoot_pct"])
    settling = np.median(rows["settling_s"])
    return f"mean error {error}, overshoot {overshoot}, settling time {settling:.2g} s{diverged(rows)}"


@claim(
    "4b", "average tracking error of 0.5 % without overshoot", paper="0.5 %, 0 %", **_FIGURE_4,
    bound="mean error at most 0.5 %, overshoot below 0.5 %",
    cases=[
        _FASTER, *READINGS, TABLE_1, _BEST, {"Kp": "80", "reference": "2 rad/s"}, {"Kp": "80", "reference": "1.5 rad/s"},
        {**_FASTER, **TABLE_1}, *({**_FASTER, **reading} for reading in READINGS), _DOUBLE, {**_BEST, **_DOUBLE},
        {"estimates": "exact"}, _SMALL, {**_SMALL, **_BEST},
        *({**motion, "estimates": x} for motion in (_SMALL, _SMALL_STEPS) for x in ("exact", "1.5 times", "double", "mixed")),
        {**_SMALL_STEPS, **_BEST}, {**_SMALL_STEPS, **_BEST, "noise": "variance 0.1"},
    ],
)  # fmt: skip
def figure_4b_error(v: Values) -> Outcome:
    rows = _rows(v)
    good = (rows["error_pct"] <= 0.5) & (rows["overshoot_pct"] < 0.5)
    return Outcome(good, _numbers(rows))


_STEP = {"reference": "400 rad/s"}
_ALONE = {"reference": "2000 rad/s", "rate": "10 kHz", "Kp": "1", "power": _ONE_JOINT, **_DOUBLE}


@claim(
    "4b", "settling time of 0.01 s", paper="0.01 s", bound="at most 0.016 s until within 2 % of a step for good", **_FIGURE_4,
    cases=[
        _STEP, *READINGS, {**_STEP, "Kp": "1"}, {**_STEP, "Kp": "150"}, _BEST, {**_STEP, **_DOUBLE},
        {**_ALONE, "noise": "none", "filter": "none"},
    ],
)  # fmt: skip
def figure_4b_settling(v: Values) -> Outcome:
    rows = _rows(v)
    return Outcome(rows["settling_s"] <= 0.016, _numbers(rows))


@claim(
    "(19)-(21)", "the filter estimates the position better than the sensor measures it", paper="the noise is eliminated",
    bound="the rms error of the estimated position is below the sensor's 0.316 rad. 0.1 is the variance of a sample in the "
    "noise and the density in (20): only the ratio of Q and R counts at steady state",
    stated={**_FIGURE_4["stated"], "noise": ("variance 0.1",)}, chosen={**_FIGURE_4["chosen"], "form": "continuous"},
    scenario=_FIGURE_4["scenario"], cases=[{"form": "discrete"}, _DOUBLE, {"form": "discrete", **_DOUBLE}],
)  # fmt: skip
def kalman_filter(v: Values) -> Outcome:
    watch = {"error": lambda env, _, state: state.kalman.position - env.truth.position}
    trace, rows = _figure_4(v, watch=watch, filtering=v["form"])
    sigma = np.sqrt((trace.watched["error"] ** 2).mean(axis=(0, 2)))
    text = f"{np.median(sigma):.3g} rad; mean tracking error {percents(rows['error_pct'])}"
    return Outcome(sigma < PAPER_SIGMA, text)


RADIUS: dict[str, Any] = {
    "chosen": {"arm": "§2.2", "direction": "both", "bound": "5 %", "Kp": "10", "rate": "1 kHz"},
    "scenario": "nominal without a torque limit, 4 s of way-points",
    "panel": {"x": "radius", "y": "seeds that track [%]", "bounds": (0.0, 102.0), "marks": ((90.0, "90 %"),)},
}
WITHOUT = {"radius": ("1",), "law": ("cascade",), "noise": ("none",), "loads": ("none",)}
WITH = {
    "radius": ("1",), "law": ("cascade and filter",), "noise": ("variance 0.1", "1 dB", "density 0.1"),
    "loads": ("50 and 20 N m",),
}  # fmt: skip
TRACKS = (
    "the mean error is within the bound. Each parameter has its own factor, drawn log-uniformly, real / nominal larger or "
    "smaller than 1, or both"
)
BOUNDS = [{"bound": f"{bound} %"} for bound in (10, 2, 1)]


robust_radius = claim(
    "§3.1", "the cascade holds within a radius of 100 %", paper="radius 1: satisfactory", bound=TRACKS, stated=WITHOUT,
    **RADIUS,
    cases=[
        {"Kp": "150"}, *BOUNDS, {"direction": "larger"}, {"direction": "smaller"}, TABLE_1, {"law": "PID"},
    ],
)(track_within)  # fmt: skip


robust_radius_with_noise = claim(
    "§3.2", "with noise, filter and loads, the design holds within a radius of 100 %", paper="radius 1: satisfactory",
    bound=TRACKS, stated=WITH, **RADIUS,
    cases=[{"Kp": "150"}, *READINGS, *BOUNDS, TABLE_1, _SMALL, {**TABLE_1, **_SMALL}],
)(track_within)  # fmt: skip
