"""Section 3: the cascade and the Kalman filter.  Equations (7)-(21) and figure 4."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.paper.claim import (
    ARMS,
    NOT,
    READING,
    REPRODUCED,
    Claim,
    Effort,
    Measured,
    percents,
    run,
    seed_range,
    with_estimate,
)
from benchmarks.report.plot import Line, Panel, plot_lines, plot_trace
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios
from fbl_gym.arm import Array


def figure_4_filter(effort: Effort, arm: str) -> Measured:
    """The Kalman filter takes the noise out."""
    real = ARMS[arm]
    _, without = run("cascade-flm", with_estimate(scenarios.get("paper-4a"), real, 0.5), effort.seeds)
    trace, found = run("robust-flm", with_estimate(scenarios.get("paper-4b"), real, 0.5), effort.seeds)
    share = found["variation"] / without["variation"]
    claim = Claim(
        "4a, 4b", f"the Kalman filter takes the noise out ({arm})", "degraded without, good with it",
        f"total variation of the torque {100 * share:.1f} % of that without the filter; mean error "
        f"{percents([found['error_pct']])} with, {percents([without['error_pct']])} without",
        READING if share < 0.2 else NOT, scenarios.get("paper-4b").description, "paper-4b", seed_range(effort.seeds),
    )  # fmt: skip
    return claim, lambda path: plot_trace(trace, f"Figure 4b: the robust controller, {arm}", path)


def figure_4a(effort: Effort, arm: str) -> Measured:
    """Noise degrades the cascade without a filter."""
    scenario = with_estimate(scenarios.get("paper-4a"), ARMS[arm], 0.5)
    trace, noisy = run("cascade-flm", scenario, effort.seeds)
    _, clean = run("cascade-flm", scenario.replace(noise=None), effort.seeds)
    factor = noisy["variation"] / clean["variation"]
    claim = Claim(
        "4a", f"noise degrades the cascade without a filter ({arm})", "large position tracking error",
        f"mean error {percents([noisy['error_pct']])} with noise, {percents([clean['error_pct']])} without; torque variation "
        f"{factor:.0f} times",
        REPRODUCED if noisy["error_pct"] > 1.5 * clean["error_pct"] else READING if factor > 5 else NOT,
        "holds for the torque, which chatters; the mean tracking error hardly changes", "paper-4a", seed_range(effort.seeds),
    )  # fmt: skip
    return claim, lambda path: plot_trace(trace, f"Figure 4a: the cascade without a filter, {arm}", path)


def figure_4b_error(effort: Effort, arm: str) -> Measured:
    """Average tracking error and overshoot of the robust design."""
    scenario, real = scenarios.get("paper-4b"), ARMS[arm]
    _, half = run("robust-flm", with_estimate(scenario, real, 0.5), effort.seeds)
    trace, double = run("robust-flm", with_estimate(scenario, real, 2.0), effort.seeds)

    def holds(found: dict[str, float]) -> bool:
        return found["error_pct"] <= 0.5 and found["overshoot_pct"] < 0.5

    claim = Claim(
        "4b", f"average tracking error and overshoot ({arm})", "0.5 %, 0 %",
        f"{half['error_pct']:.1f} %, {half['overshoot_pct']:.0f} % (estimate = half the real); "
        f"{double['error_pct']:.1f} %, {double['overshoot_pct']:.1f} % (double)",
        REPRODUCED if holds(half) and holds(double) else READING if holds(double) else NOT,
        "holds where the estimate is double the real; Kp = 10, steps behind a filter of 8 rad/s, sigma = 0.01", "paper-4b",
        seed_range(effort.seeds),
    )  # fmt: skip
    return claim, lambda path: plot_trace(trace, f"Figure 4b, estimates at double the real values, {arm}", path)


def one_decibel(effort: Effort) -> Measured:
    """The noise that the paper states, in its three readings, each as the standard deviation of a sample at 1 kHz."""
    scenario = with_estimate(scenarios.get("paper-4b"), ARMS["section-2-2"], 2.0)
    readings = {
        "variance 0.1": np.sqrt(0.1),
        "1 dB": 10 ** (-1 / 20),
        "density 0.1": np.sqrt(0.1 / scenario.control_dt),
    }
    errors, traces = {}, {}
    for name, sigma in readings.items():
        noise = {"position": sigma, "acceleration": sigma}
        wide = {"acceleration": 1e9, "position": 1e3, "velocity": 1e4}
        trace, found = run("robust-flm", scenario.replace(noise=noise, limits=wide), effort.seeds)
        errors[name], traces[name] = found["error_pct"], trace
    text = ", ".join(f"{percents([errors[name]])} ({name}: {sigma:.2g} rad)" for name, sigma in readings.items())
    claim = Claim(
        "§3.2", "0.5 % under noise of 1 dB and variance 0.1", "0.5 %", f"mean error {text}",
        REPRODUCED if max(errors.values()) <= 0.5 else READING if min(errors.values()) <= 0.5 else NOT,
        "estimates at double, 1 kHz, sigma of each sample; unit power over variance 0.1 is 10 dB, 1 dB is variance 0.794",
        "paper-4b", seed_range(effort.seeds),
    )  # fmt: skip
    return claim, lambda path: plot_trace(traces["variance 0.1"], "Figure 4b with noise of variance 0.1 a sample", path)


@dataclass(frozen=True)
class _Step:
    """A literal step: the share of it that was made [T x joints], its 2 % settling time [s], and the largest torque [N m]."""

    time: Array
    share: Array
    settled: float
    torque: float

    @property
    def overshoot(self) -> float:
        """In % of the step."""
        return 100.0 * max(float(self.share.max()) - 1.0, 0.0)


def _step(arm: str, factor: float, height: tuple[float, float]) -> _Step:
    """A step from hanging, with its impulse as feed-forward."""
    dt, begin, seconds = 1e-3, 10, 3.0
    n = round(seconds / dt) + 1
    rest = np.array([-np.pi / 2, 0.0])
    position, velocity = np.tile(rest, (n, 1)), np.zeros((n, 2))
    position[begin:] += height
    velocity[begin] = np.array(height) / dt
    scenario = scenarios.get("nominal").replace(
        control_dt=dt, duration=seconds, actuator=None,
        limits={"velocity": 1e5, "acceleration": 1e9},
        reference={
            "kind": "array", "dt": dt, "position": position, "velocity": velocity, "acceleration": np.zeros((n, 2)),
        },
    )  # fmt: skip
    trace = rollout("cascade-flm", with_estimate(scenario, ARMS[arm], factor), [0], {"kp": 1.0})
    moved = np.flatnonzero(height)
    share = (trace.position[begin:, 0, moved] - rest[moved]) / np.array(height)[moved]
    outside = (np.abs(share - 1.0) > 0.02).any(axis=1)
    settled = (len(outside) - np.argmax(outside[::-1])) * dt if outside.any() else 0.0
    return _Step(trace.time[begin:] - trace.time[begin], share, settled, float(np.abs(trace.torque).max()))


def figure_4b_settling(effort: Effort, arm: str) -> Measured:
    """Settling time of the robust design."""
    one, half = _step(arm, 2.0, (1.0, 0.0)), _step(arm, 0.5, (1.0, 0.0))
    small, both = _step(arm, 2.0, (0.01, 0.01)), _step(arm, 2.0, (1.0, 0.5))
    claim = Claim(
        "4b", f"settling time ({arm})", "0.01 s",
        f"estimate = double: {_settled(one)}, overshoot {one.overshoot:.1f} % (joint 1 alone, 1 rad, {one.torque:.0e} N m); "
        f"both joints: {_settled(small)} (0.01 rad), {_settled(both)} (1 and 0.5 rad); estimate = half: {_settled(half)}",
        READING if min(one.settled, small.settled) <= 0.016 else NOT,
        "literal step with its impulse as feed-forward, Kp = 1, no torque limit, no noise, no disturbance, from hanging, 1 kHz",
        "nominal", "0",
    )  # fmt: skip

    def lines(end: float) -> tuple[Line, ...]:
        cases = {"double, joint 1 by 1 rad": one, "double, both by 0.01 rad": small, "half, joint 1 by 1 rad": half}
        return tuple(
            Line(case.time[case.time <= end], case.share[case.time <= end, 0], f"estimate {name}")
            for name, case in cases.items()
        )

    panels = tuple(
        Panel(f"joint 1, the first {end:g} s", "time [s]", "share of the step", lines(end), bounds=(0.0, 1.4))
        for end in (0.05, 3.0)
    )
    return claim, lambda path: plot_lines(f"A literal step with an impulse as feed-forward, {arm}", panels, path)


def _settled(step: _Step) -> str:
    return f"{step.settled:.3f} s" if step.settled < step.time[-1] else "not within 3 s"


def _time_to(time: Array, error: Array, bound: float) -> float:
    """From when on the error stays within the bound [s]."""
    outside = np.flatnonzero(error > bound)
    return float(time[min(outside[-1] + 1, len(time) - 1)]) if len(outside) else 0.0


def error_dynamics(effort: Effort) -> Measured:
    """E(0) = 0.1 rad on a perfect model: what the outer loop's gain makes of it."""
    kp = 10.0
    scenario = scenarios.get("nominal").replace(
        control_dt=1e-4, physics_dt=1e-4, actuator=None, duration=5.0, initial_error=0.1,
        reference={"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.5),)},
    )  # fmt: skip
    trace = rollout("cascade-flm", scenario, [0], {"kp": kp})
    error = np.abs(trace.reference[:, 0] - trace.position[:, 0])
    times = [_time_to(trace.time, error[:, j], 0.01 * error[0, j]) for j in (0, 1)]
    ideal = np.log(100.0) / kp
    # Both loops closed: s (s^2 + P s + I) + Kp (P s + I) = 0.
    slow = [float(np.roots([1.0, p, i + kp * p, kp * i]).real.max()) for p, i in ((30.0, 13.0), (35.0, 20.0))]
    claim = Claim(
        "(10)", "the error decays as exp(-Kp t)", "E = exp(-Kp t)",
        f"down to 1 % after {times[0]:.2f} s and {times[1]:.2f} s, where exp(-{kp:.0f} t) takes {ideal:.2f} s; the closed loop "
        f"has slow poles at {slow[0]:.2f} and {slow[1]:.2f}",
        READING if max(times) < 1.1 * ideal else NOT,
        "as fast as claimed down to 1 %, with a slow tail below; perfect model, Kp = 10, E(0) = 0.1 rad; "
        "(10) takes the inner loop for perfect, with P, I = 30, 13 its poles are "
        "-29.6 and -0.44", "nominal", "0",
    )  # fmt: skip

    def draw(path: Any) -> None:
        def lines(j: int) -> tuple[Line, ...]:
            paper = error[0, j] * np.exp(-kp * trace.time)
            return (Line(trace.time, error[:, j], "measured"), Line(trace.time, paper, "E(0) exp(−Kp t)", style="--"))

        panels = tuple(
            Panel(f"joint {j + 1}", "time [s]", "|error| [rad]", lines(j), ("linear", "log"), (1e-6, 0.2))
            for j in (0, 1)
        )
        plot_lines("Equation (10): the outer loop's error on a perfect model", panels, path)

    return claim, draw
