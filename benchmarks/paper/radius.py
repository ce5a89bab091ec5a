"""The uncertainty radius of the paper's controllers: the share of seeds that track, against it."""

from itertools import product

import numpy as np

from benchmarks.paper.claim import ARMS, Case, Effort, Measured, draw_lines, judged, run, share
from benchmarks.report.plot import Line, Panel
from fbl_gym import Scenario, scenarios
from fbl_gym.arm import Array

SHARE = 0.95
"""At the radius, this share of the seeds must track."""

DIRECTIONS = ("larger", "smaller", "both")

BOUNDS = (1.0, 2.0, 5.0, 10.0)
"""Mean errors [%] up to which an arm counts as tracking: the paper says "satisfactory"."""


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
    for each in (shares.value, shares.low, shares.high):
        below = np.flatnonzero(each < SHARE)
        ends.append(float(fine[max(below[0] - 1, 0)]) if len(below) else np.inf)
    return ends[0], ends[1], ends[2]


def _text(r: Array, error: Array, bound: float = 5.0) -> str:
    value, low, high = (f"≥ {r[-1]:.3g}" if np.isinf(x) else f"{x:.2f}" for x in radius(r, error, bound))
    return f"{value} [{low}, {high}]"


def _share_panel(arm: str, r: Array, curves: dict[str, Array]) -> Panel:
    """Return the share of seeds within 5 % over the radius, a line for each curve."""
    lines = []
    for name, error in curves.items():
        fine, errors = between(r, error)
        shares = share(errors <= 5.0)
        lines.append(Line(fine, 100 * shares.value, name, low=100 * shares.low, high=100 * shares.high))
    marks = ((95.0, "95 %"),)
    return Panel(f"{arm}, within 5 %", "radius", "seeds that track [%]", tuple(lines), bounds=(0.0, 102.0), marks=marks)


def robust_radius(effort: Effort) -> Measured:
    """Measure §3: the robust design holds within a radius of 100 %."""
    r = radii(3.5, effort.points, 1.0)
    at = int(np.flatnonzero(r == 1.0)[0])
    cases, texts, panels = [], [], []
    for arm in ARMS:
        scenario = task(arm)
        seeds = {d: effort.many if d == "both" else max(effort.many // 2, 40) for d in DIRECTIONS}
        curves = {d: curve("robust-flm", scenario, d, r, seeds[d]) for d in DIRECTIONS}
        for direction, bound in product(DIRECTIONS, BOUNDS):
            error = curves[direction]
            text = f"radius {_text(r, error, bound)}; {100 * np.mean(error[at] <= bound):.1f} % at 1"
            cases.append(Case(f"{arm}, {direction}, {bound:g} %", error[at] <= bound, text))
        corners = [scenario.replace(parameter_error={"ratio": c}) for c in product((0.5, 2.0), repeat=4)]
        exceeding = sum(errors("robust-flm", corner, effort.seeds).max() > 5.0 for corner in corners)
        pid = curve("pid-flm", scenario, "both", r[: at + 1], effort.seeds)
        texts.append(
            f"{arm}: radius {_text(r, curves['both'])} in both directions at 5 %, {100 * np.mean(curves['both'][at] <= 5):.1f} "
            f"% of the seeds track at 1; {exceeding} of 16 corners exceed 5 % in some motion; pid-flm "
            f"{_text(r[: at + 1], pid)}"
        )
        panels.append(_share_panel(arm, r, curves))
        bounds = np.linspace(0.5, 10.0, 39)
        limits = {d: np.array([radius(r, error, b) for b in bounds]) for d, error in curves.items()}
        lines = tuple(
            Line(bounds, np.minimum(x[:, 0], r[-1]), d, low=np.minimum(x[:, 1], r[-1]), high=np.minimum(x[:, 2], r[-1]))
            for d, x in limits.items()
        )
        panels.append(
            Panel(f"{arm}, 95 % of the seeds", "bound on the mean error [%]", "radius", lines, marks=((1.0, "100 %"),))
        )
    return judged(
        cases, draw_lines("Share of seeds that track, and the radius against its bound", panels),
        figure="§3", claim="the robust design holds within a radius of 100 %", paper="radius 1: satisfactory",
        measured="; ".join(texts),
        assumptions="each parameter has its own factor, drawn log-uniformly; the radius up to which 95 % of the seeds "
            "track, with its 95 % interval; open: the arm, the direction of real / nominal, the bound on the mean "
            "error; way-points at 1 kHz, no noise, no torque limit",
        scenario="nominal", seeds=effort.many,
    )  # fmt: skip


def adaptive_radius(effort: Effort) -> Measured:
    """Measure §4: the adaptive design holds within a radius of 1000 %.

    Its first estimate takes three samples, which must arrive before the arm diverges.
    """
    r = radii(10.0, effort.points, 9.0)
    at = int(np.flatnonzero(r == 9.0)[0])
    seeds = effort.seeds + 16  # From 73 on, the interval of a share of 100 % lies above 95 %.
    cases, panels = [], []
    for arm in ARMS:
        slow = task(arm).replace(duration=1.0)
        fast = slow.replace(control_dt=1e-4, physics_dt=1e-4)
        settings = {"larger, 1 kHz": slow, "smaller, 1 kHz": slow, "smaller, 10 kHz": fast}
        curves = {
            name: curve("adaptive-flm", scenario, name.partition(",")[0], r, seeds)
            for name, scenario in settings.items()
        }
        for name, error in curves.items():
            text = f"radius {_text(r, error)}; {100 * np.mean(error[at] <= 5.0):.0f} % at 9"
            cases.append(Case(f"{arm}, {name}", error[at] <= 5.0, text))
        panels.append(_share_panel(arm, r, curves))
    return judged(
        cases, draw_lines("Share of seeds that the adaptive controller tracks", panels),
        figure="§4", claim="the adaptive design holds within a radius of 1000 %", paper="1000 %: radius 9",
        measured="; ".join(f"{case.measured} ({case.name})" for case in cases if "smaller" in case.name),
        assumptions="the first second of way-points, mean error within 5 %, no noise, no friction, no torque limit; "
            "open: the arm, the direction, the sample time",
        scenario="nominal", seeds=seeds,
    )  # fmt: skip
