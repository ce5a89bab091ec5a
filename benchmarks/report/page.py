"""The leaderboard as one HTML file that opens without a network: `page.html` with its data and Plotly's JavaScript put in.

What the page shows is a `Page`, plain data. `between` and `scene` make its parts from estimates and traces.
"""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from plotly.offline import get_plotlyjs

from benchmarks.analysis.statistics import Estimate
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import Trace
from fbl_gym.arm import Array

DIGITS = 5
"""Significant digits of the numbers in the page."""

POINTS = 201
"""Samples of a signal in the page, at most: the start and 200 steps."""


class Interval(TypedDict):
    """A value and its interval."""

    value: float
    low: float
    high: float


class InSplit(Interval):
    """An error with its interval, and the share of runs that diverged, from 0 to 1."""

    diverged: float


class Policy(TypedDict):
    """A row of the board.

    name, summary: what it is called, and one line on it.
    access: what it is told, one of `controllers.policy.ACCESS`.
    sensors: that it needs, such as "position, velocity".
    preview: what it knows of the reference's future, such as "none" or "0.5 s".
    tuning: such as "default gains" or "tuned".
    rank: among the ranked; None: unranked.
    score: the mean of the runs' scores; None: the oracle has not run.
    error: the IQM of error_pct.
    families: the IQM of error_pct per family of scenarios.
    splits: the same per split of the uncertainty radius, where that was measured.
    failures: share of runs that diverged, from 0 to 1.
    variation: of the torque [N m/s].
    decision_us: wall time of a decision [us].
    label: of its intervals, such as "optimistic"; "": none.
    """

    name: str
    summary: str
    access: str
    sensors: str
    preview: str
    tuning: str
    rank: Interval | None
    score: Interval | None
    error: Interval
    families: dict[str, Interval]
    splits: dict[str, InSplit]
    failures: Interval
    variation: float
    decision_us: float
    label: str


class Curve(TypedDict):
    """A line of a chart: a policy of the board, x and value [k]; its band low and high [k], or empty for none."""

    policy: str
    x: list[float]
    value: list[float]
    low: list[float]
    high: list[float]


class Chart(TypedDict):
    """One pair of axes: texts with units, and whether each axis is "linear" or "log"."""

    title: str
    description: str
    x: str
    y: str
    scales: tuple[str, str]
    curves: list[Curve]


class Reach(TypedDict):
    """How far off the model may be for a policy, in one direction of error.

    direction: of the real parameters, such as "larger".
    value: the radius; None: it fails at the least.
    text: as `str(Radius)` says it, such as "≥ 10".
    tried: radii and shares of successful seeds.
    """

    policy: str
    direction: str
    value: float | None
    text: str
    tried: list[tuple[float, float]]


class Pairs(TypedDict):
    """A matrix [p x p] of the row's policy against the column's, None on the diagonal, and the intervals."""

    title: str
    description: str
    policies: list[str]
    value: list[list[float | None]]
    low: list[list[float | None]]
    high: list[list[float | None]]


class Run(TypedDict):
    """One policy's run in a scene: position [rad] and torque [N m], [2 x k], None after it diverged.

    error_pct: its mean absolute tracking error.
    diverged: when [s]; None: it did not.
    """

    policy: str
    position: list[list[float | None]]
    torque: list[list[float | None]]
    error_pct: float
    diverged: float | None


class Scene(TypedDict):
    """One seed of a scenario: what was asked, what disturbed, and what each policy did.

    time: [k] s.
    lengths: of the true links [m].
    reference, disturbance: [2 x k] rad and N m.
    """

    scenario: str
    description: str
    seed: int
    time: list[float]
    lengths: list[float]
    reference: list[list[float]]
    disturbance: list[list[float]]
    runs: list[Run]


class Page(TypedDict):
    """All that the page shows. A section whose list is empty is left out.

    title, summary: above the board.
    facts: name and value of how it came about: command, version, machine, seeds.
    families: each family of scenarios and what it varies, in the order of the board's columns.
    splits: each split of the uncertainty radius and what it is, in the order of the columns behind those.
    degradation: a chart per family, error against severity.
    """

    title: str
    summary: str
    facts: dict[str, str]
    families: dict[str, str]
    splits: dict[str, str]
    policies: list[Policy]
    degradation: list[Chart]
    radius: list[Reach]
    profiles: list[Chart]
    pairs: list[Pairs]
    learning: list[Chart]
    scenes: list[Scene]


def between(estimate: Estimate, *index: int) -> Interval:
    """One element of an estimate."""
    value, low, high = (float(np.asarray(x)[index]) for x in (estimate.value, estimate.low, estimate.high))
    return {"value": value, "low": low, "high": high}


def scene(traces: Mapping[str, Trace], lengths: Array, lane: int = 0) -> Scene:
    """A scene from each policy's trace of the same scenario and seeds.

    Args:
        traces: by policy.
        lengths: of the true links [2] m.
        lane: which seed.
    """
    first = next(iter(traces.values()))
    for policy, trace in traces.items():
        if (trace.scenario, trace.seeds) != (first.scenario, first.seeds):
            raise ValueError(
                f"traces must be of one scenario and the same seeds, got {trace.scenario.name!r} with seeds {trace.seeds} "
                f"for {policy}, and {first.scenario.name!r} with {first.seeds}"
            )
    # Every so many samples, so that the page stays small.
    shown = slice(0, None, math.ceil((len(first.time) - 1) / (POINTS - 1)))
    runs: list[Run] = []
    for policy, trace in traces.items():
        alive = trace.alive[:, lane]
        position, torque = (np.where(alive[:, None], x[:, lane], np.nan) for x in (trace.position, trace.torque))
        runs.append(
            {
                "policy": policy,
                "position": position[shown].T.tolist(),
                "torque": torque[shown].T.tolist(),
                "error_pct": measure(trace)[lane]["error_pct"],
                "diverged": None if alive.all() else float(trace.time[np.argmin(alive)]),
            }
        )
    return {
        "scenario": first.scenario.name,
        "description": first.scenario.description,
        "seed": first.seeds[lane],
        "time": first.time[shown].tolist(),
        "lengths": list(map(float, lengths)),
        "reference": first.reference[shown, lane].T.tolist(),
        "disturbance": first.disturbance[shown, lane].T.tolist(),
        "runs": runs,
    }


def write_page(path: Path, data: Page) -> None:
    """Write the page to `path`, its folder too."""
    parts = {
        "TITLE": html.escape(data["title"]),
        "PLOTLY": get_plotlyjs(),
        # In a script element only "<" could end it, and it is the same string to JSON when escaped.
        "DATA": json.dumps(_plain(data), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
    }
    template = resources.files("benchmarks.report").joinpath("page.html").read_text(encoding="utf-8")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(re.sub(r"\{\{ (\w+) \}\}", lambda found: parts[found[1]], template), encoding="utf-8")


def _plain(value: Any) -> Any:
    """JSON's own types, with few digits; NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
