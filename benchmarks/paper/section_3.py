"""Section 3: the cascade and the Kalman filter; figure 4, equations (10) and (19) to (21)."""

import numpy as np

from benchmarks.paper.measuring import HANGING, SEEDS, at_rate, metrics, noise, run, score, track_within, with_estimates
from benchmarks.paper.outcome import Outcome, Rows, Values, diverged, number, percents
from benchmarks.report.plot import Line, Panel
from controllers.paper.cascade import CascadeFlm
from controllers.paper.kalman import PAPER_SIGMA
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import Array


def _decay(v: Values) -> tuple[Array, float, str, Panel]:
    """Return each joint's time to 1 % over exp(-Kp t)'s [2], overshoot [%], text and picture.

    The arm hangs at first, and the torque has no limit. (10) assumes a perfect inner loop.
    Feed-forward 1 adds the derivative of the velocity reference, r'' + Kp (r' - v).
    """
    kp, feedforward = number(v["Kp"]), number(v["feed-forward of the acceleration"])
    duration = round(min(1.0 + 10.0 / kp, 6.0), 3)
    hanging = scenarios.get("nominal").replace(actuator=None, reference=HANGING, initial_error=number(v["E(0)"]))
    trace = run("cascade-flm", at_rate(hanging, "10 kHz", duration=duration), kp=kp, feedforward=feedforward)
    error = (trace.reference - trace.position)[:, 0]
    parts = error / error[0]
    outside = np.abs(parts) > 0.01
    times = trace.time[len(parts) - np.argmax(outside[::-1], axis=0)]
    ideal, overshoot = np.log(100.0) / kp, 100 * max(-parts.min(), 0.0)
    text = f"1 % after {times[0]:.3g} and {times[1]:.3g} s, exp(-Kp t) after {ideal:.3g} s, overshoot {overshoot:.2g} %"
    near = trace.time <= 0.6
    line = Line(trace.time[near], parts[near, 0], f"Kp {v['Kp']}" + (", feed-forward" if feedforward else ""))
    panel = Panel("", "time [s]", "error / first error", (line,), bounds=(-0.8, 1.0))
    return times / ideal, overshoot, text, panel


def equation_10(v: Values) -> Outcome:
    times, overshoot, text, panel = _decay(v)
    return Outcome(times.min() > 0.9 and times.max() < 1.1 and overshoot < 1.0, text, panel)


def equation_10_fast(v: Values) -> Outcome:
    times, _, text, panel = _decay(v)
    return Outcome(times.max() < 1.1, text, panel)


def _figure_4(v: Values) -> tuple[str, Scenario, float]:
    """Return the cascade with or without filter, figure 4's motion of 4 s, and Kp.

    The step behind the filter, 1 - 2 (1 + w t) exp(-w t), has a power of 1 - 3 / (4 w) in 4 s.
    """
    base, w = scenarios.get("paper-4b"), number(v["reference"])
    a = (1.0 - 0.75 / w) ** -0.5
    steps = {"1": ((-a, -a), (a, a)), "0.5, joint 1 alone": ((0.0, 0.0), (1.0, 0.0))}
    points, seconds = (steps[v["power"]], 4.0) if v["power"] in steps else (vars(base.reference)["points"], 2.0)
    scenario = at_rate(
        with_estimates(base, v["arm"], v["estimates"]), v["rate"], duration=seconds * (len(points) - 1),
        reference={"kind": "filtered-steps", "points": points, "period": seconds, "bandwidth": w},
        noise=noise(v["noise"], v["rate"]), limits={"acceleration": 1e9, "position": 1e3, "velocity": 1e4},
    )  # fmt: skip
    return "robust-flm" if v["filter"] == "on" else "cascade-flm", scenario, number(v["Kp"])


def _rows(v: Values, factor: float = 1.0) -> Rows:
    """Return the metrics of figure 4, with the inner loop's gains times a factor."""
    policy, scenario, kp = _figure_4(v)
    inner = {name: tuple(factor * x for x in getattr(CascadeFlm, name)) for name in ("velocity_p", "velocity_i")}
    return metrics(policy, scenario, SEEDS, kp=kp, **inner)


def figure_4a(v: Values) -> Outcome:
    noisy, clean = _rows(v), _rows({**v, "noise": "none"})
    times = np.median(noisy["variation"] / clean["variation"])
    text = f"mean error {percents(noisy['error_pct'])}{diverged(noisy)}, {percents(clean['error_pct'])} without noise; "
    return Outcome(noisy["error_pct"] > 1.5 * clean["error_pct"], f"{text}{times:.3g} times the torque's variation")


def gains_noise(v: Values) -> Outcome:
    grown, texts = [], []
    for factor in (10.0, 1.0):
        noisy, clean = (_rows(each, factor)["error_pct"] for each in (v, {**v, "noise": "none"}))
        grown.append(noisy / clean)
        texts.append(f"mean error {percents(noisy)} with gains times {factor:g}, {percents(clean)} without noise")
    return Outcome(grown[0] > 1.5 * grown[1], "; ".join(texts))


def figure_4b_filter(v: Values) -> Outcome:
    rows, without = _rows(v), _rows({**v, "filter": "none"})
    error, unfiltered, part = rows["error_pct"], without["error_pct"], rows["variation"] / without["variation"]
    text = f"mean error {percents(error)}{diverged(rows)}, {percents(unfiltered)} without the filter; "
    text += f"{100 * np.median(part):.2g} % of the torque's variation"
    return Outcome((part < 0.2) & (error < 1.05 * unfiltered), text)


def _numbers(rows: Rows) -> str:
    """Return the three numbers of figure 4b as text."""
    error, overshoot = percents(rows["error_pct"]), percents(rows["overshoot_pct"])
    settling = np.median(rows["settling_s"])
    return f"mean error {error}, overshoot {overshoot}, settling time {settling:.2g} s{diverged(rows)}"


def figure_4b_error(v: Values) -> Outcome:
    rows = _rows(v)
    return Outcome((rows["error_pct"] <= 0.5) & (rows["overshoot_pct"] < 0.5), _numbers(rows))


def figure_4b_settling(v: Values) -> Outcome:
    rows = _rows(v)
    return Outcome(rows["settling_s"] <= 0.016, _numbers(rows))


def kalman_filter(v: Values) -> Outcome:
    policy, scenario, kp = _figure_4(v)
    watch = {"error": lambda env, _, state: state.kalman.position - env.truth.position}
    trace = run(policy, scenario, SEEDS, watch, kp=kp, filtering=v["form"])
    sigma = np.sqrt((trace.watched["error"] ** 2).mean(axis=(0, 2)))
    text = f"{np.median(sigma):.3g} rad; mean tracking error {percents(score(trace)['error_pct'])}"
    return Outcome(sigma < PAPER_SIGMA, text)


# One measurement has several claims.
robust_radius = robust_radius_with_noise = track_within
