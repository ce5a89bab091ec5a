"""The uncertainty radius of the paper's controllers, and their error against real / nominal."""

from __future__ import annotations

import numpy as np

from benchmarks.analysis.robustness import BOUND, LARGEST, search, with_radius
from benchmarks.analysis.statistics import Radius
from benchmarks.paper.claim import ARMS, Claim, Draw, Effort, Measured, seed_range, verdict
from benchmarks.report.plot import Line, Panel, plot_lines
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import Scenario, scenarios
from fbl_gym.arm import Array

POLICIES = ("pid-flm", "cascade-flm", "robust-flm", "adaptive-flm")


def task(arm: str) -> Scenario:
    """Return way-points at 1 kHz without noise, friction and torque limit."""
    return scenarios.get("nominal").replace(arm=ARMS[arm], control_dt=1e-3, actuator=None, duration=4.0)


def errors(policy: str, scenario: Scenario, seeds: int) -> Array:
    """Return the mean tracking error of each seed [%]."""
    return np.array([row["error_pct"] for row in measure(rollout(policy, scenario, range(seeds)))])


def measured_radius(policy: str, scenario: Scenario, direction: str, seeds: int, effort: Effort) -> Radius:
    """Return the largest radius at which 95 % of the seeds track within 5 %."""
    return search(
        lambda r: errors(policy, with_radius(scenario, r, direction), seeds),
        scan=effort.ratios // 2 + 1, tolerance=0.6 / effort.ratios,
    )  # fmt: skip


def _maps(scenario: Scenario, effort: Effort, arm: str) -> Draw:
    """Return a function that draws the error against one common ratio, and against the radius."""
    r = np.expm1(np.linspace(0.0, np.log1p(LARGEST), effort.ratios))
    ratio = np.concatenate([1.0 / (1.0 + r[:0:-1]), 1.0 + r])
    seeds = effort.seeds
    uniform, mixed = [], []
    for policy in POLICIES:
        same = [np.median(errors(policy, scenario.replace(parameter_error=float(x)), seeds)) for x in ratio]
        uniform.append(Line(ratio, np.array(same), policy))
        each = [errors(policy, with_radius(scenario, x, "both"), seeds) for x in r]
        low, middle, high = np.quantile(each, (0.05, 0.5, 0.95), axis=1)
        mixed.append(Line(1.0 + r, middle, policy, low=low, high=high))
    y, logs, marks = "mean tracking error [%]", ("log", "log"), ((BOUND, "5 %"),)
    panels = (
        Panel("all parameters by one factor", "real / nominal", y, tuple(uniform), logs, None, marks),
        Panel("each by its own: median, 5 to 95 % of the seeds", "1 + radius", y, tuple(mixed), logs, None, marks),
    )  # fmt: skip
    return lambda path: plot_lines(f"Tracking error against parameter error, {arm}", panels, path)


def robust_radius(effort: Effort, arm: str) -> Measured:
    """Measure §3: the robust design holds within a radius of 100 %."""
    scenario, seeds = task(arm), 4 * effort.seeds
    radii = {p: measured_radius(p, scenario, "both", seeds, effort) for p in POLICIES}
    one_sided = [
        measured_radius("robust-flm", scenario, direction, seeds, effort) for direction in ("larger", "smaller")
    ]
    text = ", ".join(f"{policy} {radii[policy]}" for policy in POLICIES)
    uniform = [errors("robust-flm", scenario.replace(parameter_error=x), effort.seeds) for x in (0.5, 2.0)]
    same = max(float(np.median(each)) for each in uniform)
    reached = [r.value >= 1.0 for r in (radii["robust-flm"], *one_sided)]
    claim = Claim(
        figure="§3", claim=f"the robust design holds within a radius of 100 % ({arm})", paper="radius 1: satisfactory",
        measured=f"radius {text}; robust-flm {one_sided[0]} if the real parameters are only larger, {one_sided[1]} if "
            f"only smaller; error at most {same:.2g} % if all have the factor 2 or 1/2",
        verdict=verdict(all(reached), under_assumptions=any(reached) or same < BOUND),
        assumptions="radius: 95 % of the seeds track within 5 %, each parameter has its own factor; under assumptions: only "
            "in some directions, or if all share one factor; way-points at 1 kHz, no noise, no torque limit",
        scenario="nominal", seed=seed_range(seeds),
    )  # fmt: skip
    return claim, _maps(scenario, effort, arm)


def adaptive_radius(effort: Effort, arm: str) -> Measured:
    """Measure §4: the adaptive design holds within a radius of 1000 %.

    Its first estimate takes three samples, which must arrive before the arm diverges.
    """
    slow = task(arm).replace(duration=1.0)
    fast = slow.replace(control_dt=1e-4, physics_dt=1e-4)
    seeds = 2 * effort.seeds
    larger = measured_radius("adaptive-flm", slow, "larger", seeds, effort)
    smaller = {
        rate: measured_radius("adaptive-flm", scenario, "smaller", seeds, effort)
        for rate, scenario in (("1 kHz", slow), ("10 kHz", fast))
    }
    wide = larger.value >= 9.0 and smaller["10 kHz"].value >= 9.0
    claim = Claim(
        figure="§4", claim=f"the adaptive design holds within a radius of 1000 % ({arm})", paper="1000 %: radius 9",
        measured=f"real parameters larger: {larger} at 1 kHz; smaller: {smaller['1 kHz']} at 1 kHz, {smaller['10 kHz']} "
            "at 10 kHz",
        verdict=verdict(wide and smaller["1 kHz"].value >= 9.0, under_assumptions=wide),
        assumptions="as for the robust design, no noise, no friction; under assumptions: 10 kHz if the arm is lighter than "
            "its model",
        scenario="nominal", seed=seed_range(seeds),
    )  # fmt: skip
    grid = np.expm1(np.linspace(0.0, np.log1p(LARGEST), effort.ratios))

    def line(scenario: Scenario, direction: str, name: str) -> Line:
        quantiles = [
            np.quantile(errors("adaptive-flm", with_radius(scenario, r, direction), seeds), 0.95) for r in grid
        ]
        return Line(1.0 + grid, np.array(quantiles), name)

    lines = (
        line(slow, "larger", "larger, 1 kHz"),
        line(slow, "smaller", "smaller, 1 kHz"),
        line(fast, "smaller", "smaller, 10 kHz"),
    )
    panel = Panel(
        "adaptive-flm, each parameter by its own factor", "1 + radius", "error not exceeded by 95 % of the seeds [%]", lines,
        ("log", "log"), None, ((BOUND, "5 %"),),
    )  # fmt: skip
    return claim, lambda path: plot_lines(f"Radius of the adaptive controller, {arm}", (panel,), path)
