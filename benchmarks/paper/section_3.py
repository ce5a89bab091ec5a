"""Section 3: the cascade and the Kalman filter; figure 4, equations (10) and (19) to (21)."""

from collections.abc import Callable
from functools import lru_cache
from itertools import product
from typing import Any, TypeAlias

import numpy as np

from benchmarks.paper.claim import (
    ARMS,
    Case,
    Effort,
    Finding,
    Rows,
    claim,
    diverged,
    percents,
    quote,
    run,
    with_estimate,
)
from benchmarks.paper.radius import curve, errors, radii, radius, radius_text, share_panel, task
from benchmarks.report.plot import Line, Panel
from benchmarks.run.rollout import Trace, rollout
from controllers.kalman import PAPER_SIGMA, continuous_gains, gains
from fbl_gym import Noise, Scenario, scenarios
from fbl_gym.model.arm import Array


@claim(
    "(10)", "the error decays as exp(-Kp t), arbitrarily fast by Kp", paper="E = exp(-Kp t)",
    assumptions="within 1.1 times the claimed time, overshoot below 1 %; perfect model, no torque limit, 10 kHz, E(0) = "
        "0.1 rad. (10) assumes a perfect inner loop, whose poles are -29.6 and -0.44 for P, I = 30, 13. Feed-forward: the "
        "derivative of the velocity reference, r'' + Kp (r' - v)",
)  # fmt: skip
def equation_10(effort: Effort) -> Finding:
    cases, lines = [], []
    for feedforward, kp in product((0.0, 1.0), (10.0, 30.0, 100.0, 1000.0)):
        scenario = scenarios.get("nominal").replace(
            control_dt=1e-4, physics_dt=1e-4, actuator=None, duration=1.0 if effort.short else 3.0, initial_error=0.1,
            reference={"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.5),)},
        )  # fmt: skip
        trace = rollout("cascade-flm", scenario, [0], {"kp": kp, "feedforward": feedforward})
        error = trace.reference[:, 0] - trace.position[:, 0]
        share = error / error[0]
        times = [_time_to(trace.time, np.abs(share[:, j]), 0.01) for j in (0, 1)]
        overshoot, ideal = 100 * np.maximum(-share.min(axis=0), 0.0), np.log(100.0) / kp
        name = f"Kp = {kp:g}" + (" with feed-forward" if feedforward else "")
        text = f"{times[0]:.3g} and {times[1]:.3g} s (claimed {ideal:.2g} s), overshoot "
        text += f"{overshoot[0]:.2g} and {overshoot[1]:.2g} %"
        cases.append(Case(name, max(times) < 1.1 * ideal and overshoot.max() < 1.0, text))
        if not feedforward or kp == 10.0:
            lines.append(Line(trace.time, share[:, 0], name, style="--" if feedforward else "-"))
    first = [Line(line.x[line.x <= 0.6], line.y[line.x <= 0.6], line.label, style=line.style) for line in lines]
    panel = Panel("joint 1, a perfect model", "time [s]", "error / first error", tuple(first), marks=((0.0, ""),))
    measured = "1 % is reached, on joints 1 and 2, after " + quote(cases[0], cases[3])
    return Finding(cases, measured, "Equation (10): the decay of an error at four Kp", [panel])


def _time_to(time: Array, error: Array, bound: float) -> float:
    """Return the time [s] after which the error stays within the bound."""
    outside = np.flatnonzero(error > bound)
    return float(time[min(outside[-1] + 1, len(time) - 1)]) if len(outside) else 0.0


SIGMAS = {"σ = 0.01": 0.01, "variance 0.1": PAPER_SIGMA, "1 dB": 10 ** (-1 / 20), "density 0.1": 10.0}
"""Readings of §3.2's noise: standard deviation of a sample at 1 kHz. For a signal of unit power, a
variance of 0.1 is 10 dB, and 1 dB is a variance of 0.794. The first is the project's choice."""

DIRECTIONS = {"half": 0.5, "double": 2.0}
"""Estimates of all parameters over their real values, for an error of "50 %"."""


def _noise(sigma: float | None) -> Noise | None:
    return Noise(position=sigma, velocity=sigma, acceleration=sigma) if sigma else None


_LEVELS: Any = vars(scenarios.get("paper-4b").reference)["points"]


Setting: TypeAlias = tuple[str, str, str, float | None]
"""Arm, direction, reference and sigma of figure 4."""


def _scenario(arm: str, direction: str, reference: str, sigma: float | None) -> Scenario:
    """Return the scenario of figure 4 at one value of all that the paper leaves open."""
    scenario = with_estimate(scenarios.get("paper-4b"), ARMS[arm], DIRECTIONS[direction])
    steps = {} if reference == "filtered steps" else {"reference": {"kind": "steps", "points": _LEVELS, "period": 2.0}}
    wide = {"acceleration": 1e9, "position": 1e3, "velocity": 1e4}
    return scenario.replace(noise=_noise(sigma), limits=wide, **steps)


@lru_cache(maxsize=128)
def _rows(policy: str, setting: Setting, seeds: int) -> Rows:
    return run(policy, _scenario(*setting), seeds)[1]


_OPEN = (
    "; open: the arm, the sign of the error (estimates at half or double the real values), the reference (steps behind a "
    "filter of 8 rad/s, or literal), the noise of a 1 ms sample on each sensor; Kp = 10, 50 and 20 N m every 0.5 s"
)


def _figure_4(effort: Effort, judge: Callable[[Setting], tuple[Any, str]], readings: int = 2) -> list[Case]:
    """Return each case of figure 4, judged; the noise has the first readings of `SIGMAS`.

    The short form has the first arm only.
    """
    arms, noises = list(ARMS)[: effort.points // 3], list(SIGMAS.items())[:readings]
    return [
        Case(f"{arm}, {direction}, {reference}, {name}", *judge((arm, direction, reference, sigma)))
        for arm, direction, reference, (name, sigma) in product(
            arms, DIRECTIONS, ("filtered steps", "literal steps"), noises
        )
    ]


def _drawn(policy: str, title: str, sigma: float = PAPER_SIGMA) -> tuple[str, Trace]:
    """Return a title and the trace of seed 0 on §2.2's arm."""
    title += ", estimates at double, §2.2's arm"
    return title, run(policy, _scenario("§2.2", "double", "filtered steps", sigma))[0]


@claim(
    "4a", "noise degrades the cascade without a filter", paper="large position tracking error", scenario="paper-4a",
    assumptions="the error grows by half" + _OPEN,
)  # fmt: skip
def figure_4a(effort: Effort) -> Finding:
    def judge(setting: Setting) -> tuple[Any, str]:
        noisy, clean = (_rows("cascade-flm", (*setting[:3], sigma), effort.seeds) for sigma in (setting[3], None))
        times = np.median(noisy["variation"] / clean["variation"])
        text = f"{percents(clean['error_pct'])} to {percents(noisy['error_pct'])}{diverged(noisy)}, {times:.3g} times"
        return noisy["error_pct"] > 1.5 * clean["error_pct"], text

    cases = _figure_4(effort, judge)
    measured = "mean error without and with noise, total variation of the torque with noise: "
    measured += quote(cases[0], cases[-1])
    return Finding(cases, measured, *_drawn("cascade-flm", "Figure 4a: no filter, variance 0.1"), effort.seeds)


@claim(
    "4a, 4b", "the Kalman filter removes the noise", paper="degraded without the filter, good with it",
    scenario="paper-4b",
    assumptions="the torque varies by less than a fifth, and the error does not grow (by 5 %)" + _OPEN,
)  # fmt: skip
def figure_4b_filter(effort: Effort) -> Finding:
    def judge(setting: Setting) -> tuple[Any, str]:
        without, rows = (_rows(policy, setting, effort.seeds) for policy in ("cascade-flm", "robust-flm"))
        share = rows["variation"] / without["variation"]
        text = f"{percents(without['error_pct'])} to {percents(rows['error_pct'])}{diverged(rows)}, "
        text += f"{100 * np.median(share):.2g} % of the variation"
        return (share < 0.2) & (rows["error_pct"] < 1.05 * without["error_pct"]), text

    cases = _figure_4(effort, judge)
    measured = "mean error without and with the filter, total variation of the torque: " + quote(cases[0], cases[-1])
    return Finding(cases, measured, *_drawn("robust-flm", "Figure 4b: the filter, variance 0.1"), effort.seeds)


@claim(
    "4b", "average tracking error of 0.5 % without overshoot", paper="0.5 %, 0 %", scenario="paper-4b",
    assumptions="overshoot below 0.5 %" + _OPEN,
)  # fmt: skip
def figure_4b_error(effort: Effort) -> Finding:
    together = []

    def judge(setting: Setting) -> tuple[Any, str]:
        rows = _rows("robust-flm", setting, effort.seeds)
        good = (rows["error_pct"] <= 0.5) & (rows["overshoot_pct"] < 0.5)
        together.append(bool((good & (rows["settling_s"] <= 0.016)).any()))
        settling = f"{np.median(rows['settling_s']):.2g} s"
        return good, f"{percents(rows['error_pct'], rows['overshoot_pct'])} / {settling}{diverged(rows)}"

    cases = _figure_4(effort, judge, 2 if effort.short else 4)
    measured = f"mean error, overshoot and settling time: {quote(cases[0], cases[-1])}. All three numbers of the paper "
    measured += f"occur together in {'some' if any(together) else 'no'} run"
    return Finding(cases, measured, *_drawn("robust-flm", "Figure 4b: the filter, σ = 0.01", 0.01), effort.seeds)


def _step(
    seconds: float, arm: str, factor: float, height: tuple[float, float], sigma: float | None = None
) -> tuple[Array, float]:
    """Return the response of each moved joint over its step [T x joints], and the largest torque.

    The arm hangs at first, and the velocity impulse of the step is fed forward. With a sigma: with
    that noise on every sensor, and with the Kalman filter.
    """
    n, rest, moved = round(seconds / _STEP_DT) + 1, np.array([-np.pi / 2, 0.0]), np.flatnonzero(height)
    position, velocity = np.tile(rest, (n, 1)), np.zeros((n, 2))
    position[_BEGIN:] += height
    velocity[_BEGIN] = np.array(height) / _STEP_DT
    motion = {"position": position, "velocity": velocity, "acceleration": np.zeros((n, 2))}
    scenario = scenarios.get("nominal").replace(
        control_dt=_STEP_DT, duration=seconds, actuator=None, limits={"velocity": 1e5, "acceleration": 1e9},
        noise=_noise(sigma), reference={"kind": "array", "dt": _STEP_DT, **motion},
    )  # fmt: skip
    policy = "robust-flm" if sigma else "cascade-flm"
    trace = rollout(policy, with_estimate(scenario, ARMS[arm], factor), [0], {"kp": 1.0})
    fraction = (trace.position[_BEGIN:, 0, moved] - rest[moved]) / np.array(height)[moved]
    return fraction, float(np.abs(trace.torque).max())


_STEP_DT, _BEGIN = 1e-3, 10
"""Sample time [s] of a step, and the sample at which it begins."""


@claim(
    "4b", "settling time of 0.01 s", paper="0.01 s",
    assumptions="below 0.016 s; a step whose velocity impulse is fed forward; Kp = 1, no torque limit, no disturbance, "
        "from hanging, 1 kHz; no noise and no filter, but for the last case. Without the impulse no case settles in 0.1 s",
)  # fmt: skip
def figure_4b_settling(effort: Effort) -> Finding:
    seconds = 1.0 if effort.short else 3.0
    heights = {"joint 1 by 1 rad": (1.0, 0.0), "both by 0.01 rad": (0.01, 0.01), "both by 1 and 0.5 rad": (1.0, 0.5)}
    steps = {
        f"{arm}, {direction}, {name}": _step(seconds, arm, DIRECTIONS[direction], heights[name])
        for arm, direction, name in product(ARMS, DIRECTIONS, heights)
    }
    steps["§2.2, double, joint 1 by 1 rad, filter and σ = 0.01"] = _step(seconds, "§2.2", 2.0, (1.0, 0.0), 0.01)
    cases, lines = [], []
    for name, (fraction, torque) in steps.items():
        time = _STEP_DT * np.arange(float(len(fraction)))
        settled = _time_to(time, np.abs(fraction - 1.0).max(axis=1), 0.02)
        text = f"{settled:.3f} s" if settled < time[-1] else f"not within {time[-1]:.0f} s"
        text += f", {100 * max(fraction.max() - 1.0, 0.0):.2g} %, {torque:.0e} N m"
        cases.append(Case(name, settled <= 0.016, text))
        if name.startswith("§2.2") and "0.5 rad" not in name:
            lines.append((time, fraction[:, 0], name.removeprefix("§2.2, ")))
    panels = [
        Panel(
            f"joint 1, the first {end:g} s", "time [s]", "fraction of the step",
            tuple(Line(x[x <= end], y[x <= end], name) for x, y, name in lines), bounds=(0.0, 1.4),
        )
        for end in (0.05, seconds)
    ]  # fmt: skip
    measured = "settling time, overshoot and largest torque: " + quote(cases[3], cases[-1])
    return Finding(cases, measured, "A step with its velocity impulse fed forward, §2.2's arm", panels)


@claim(
    "(19)-(21)", "the filter estimates the position better than the sensor measures it", paper="the noise is eliminated",
    scenario="paper-4b",
    assumptions="§2.2's arm; 0.1 as variance of a sample in the noise, as density in (20): only the ratio of Q and R "
        "counts, so both forms have the same K at steady state",
)  # fmt: skip
def kalman_filter(effort: Effort) -> Finding:
    cases = []
    for direction in DIRECTIONS:
        scenario = with_estimate(scenarios.get("paper-4b"), ARMS["§2.2"], DIRECTIONS[direction])
        scenario = scenario.replace(noise=_noise(PAPER_SIGMA), limits={"acceleration": 1e9, "velocity": 1e4})
        for form in ("discrete", "continuous"):
            watch = {"error": lambda env, _, state: state.kalman.position - env.truth.position}
            trace, rows = run("robust-flm", scenario, effort.seeds, watch, filtering=form)
            sigma = np.sqrt((trace.watched["error"] ** 2).mean(axis=(0, 2)))
            text = f"{np.median(sigma):.3g} rad, {percents(rows['error_pct'])}"
            cases.append(Case(f"{form}, {direction}", sigma < PAPER_SIGMA, text))
    settled = [form(1e-3, PAPER_SIGMA, PAPER_SIGMA)[-1] / 1e-3 for form in (continuous_gains, gains)]
    measured = (
        f"rms error of the estimated position (sensor: {PAPER_SIGMA:.3f} rad) and tracking error: {text} "
        f"(continuous, which starts with its low final gain), {cases[-2].measured} (discrete), estimates at double. K at "
        f"steady state: {settled[0].round(3)} continuous, {settled[1].round(3)} discrete over dt"
    )
    return Finding(cases, measured, "Figure 4b with the continuous filter, variance 0.1", trace, effort.seeds)


@claim(
    "§3", "the robust design holds within a radius of 100 %", paper="radius 1: satisfactory",
    assumptions="each parameter has its own factor, drawn log-uniformly; the radius up to which 95 % of the seeds "
        "track, with its 95 % interval; open: the arm, the direction of real / nominal, the bound on the mean "
        "error; way-points at 1 kHz, no noise, no torque limit",
)  # fmt: skip
def robust_radius(effort: Effort) -> Finding:
    r = radii(3.5, effort.points, 1.0)
    at = int(np.flatnonzero(r == 1.0)[0])
    cases, texts, panels = [], [], []
    half = max(effort.many // 2, 40)
    for arm in ARMS:
        scenario = task(arm)
        seeds = {"larger": half, "smaller": half, "both": effort.many}
        curves = {direction: curve("robust-flm", scenario, direction, r, n) for direction, n in seeds.items()}
        for (direction, error), bound in product(curves.items(), (1.0, 2.0, 5.0, 10.0)):
            text = f"radius {radius_text(r, error, bound)}; {100 * np.mean(error[at] <= bound):.1f} % at 1"
            cases.append(Case(f"{arm}, {direction}, {bound:g} %", error[at] <= bound, text))
        corners = [scenario.replace(parameter_error={"ratio": c}) for c in product((0.5, 2.0), repeat=4)]
        exceeding = sum(errors("robust-flm", corner, effort.seeds).max() > 5.0 for corner in corners)
        pid = curve("pid-flm", scenario, "both", r[: at + 1], effort.seeds)
        texts.append(
            f"{arm}: radius {radius_text(r, curves['both'])} in both directions at 5 %, "
            f"{100 * np.mean(curves['both'][at] <= 5):.1f} % of the seeds track at 1; {exceeding} of 16 corners exceed 5 % "
            f"in some motion; pid-flm {radius_text(r[: at + 1], pid)}"
        )
        panels.append(share_panel(arm, r, curves))
        bounds = np.linspace(0.5, 10.0, 39)
        limits = {d: np.array([radius(r, error, b) for b in bounds]) for d, error in curves.items()}
        lines = tuple(
            Line(bounds, np.minimum(x[:, 0], r[-1]), d, low=np.minimum(x[:, 1], r[-1]), high=np.minimum(x[:, 2], r[-1]))
            for d, x in limits.items()
        )
        panels.append(
            Panel(f"{arm}, 95 % of the seeds", "bound on the mean error [%]", "radius", lines, marks=((1.0, "100 %"),))
        )
    title = "Share of seeds that track, and the radius against its bound"
    return Finding(cases, "; ".join(texts), title, panels, effort.many)
