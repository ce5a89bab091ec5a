"""What the page shows of a board: its rows, curves, pairs and scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.analysis import statistics
from benchmarks.analysis.board import Board
from benchmarks.analysis.generalization import MEANING, RangeErrors
from benchmarks.analysis.statistics import Estimate, Radius
from benchmarks.report.page import Chart, Curve, Interval, Page, Pairs, Policy, Reach, Scene, between, scene
from benchmarks.rl.policy import curves, shipped
from benchmarks.run.rollout import rollout
from benchmarks.run.store import Result
from fbl_gym import TwoLinkArmEnv, scenarios
from fbl_gym.arm import Array

SCENES = 12
"""So many scenarios, at most, have their motions in the page."""


def contents(
    board: Board,
    results: Sequence[Result],
    radii: Mapping[tuple[str, str], Radius],
    splits: Mapping[str, RangeErrors],
    command: str,
) -> Page:
    """All that the page shows.

    Args:
        board: of the results.
        results: of the cells, for what is known of them.
        radii: of each policy and direction of error; may be empty.
        splits: of the radius; may be empty.
        command: that makes the page.
    """
    latest = max(results, key=lambda result: result.provenance.get("time", ""))
    packages = latest.provenance.get("packages", {})
    return {
        "title": "fbl-gym leaderboard",
        "summary": (
            f"{len(board.policies)} policies on {len(board.scenarios)} scenarios with the same {len(board.seeds)} seeds. The "
            "score is 0 for an arm that stays where it started and 100 for the oracle, which knows the truth and is not "
            "ranked; a run that diverged has the worst. Intervals cover 95 %, by a bootstrap over seeds."
            + ("" if statistics.enough(len(board.seeds)) else " There are too few episodes to claim failure rates.")
        ),
        "facts": {
            "command": command,
            "computed with": latest.provenance.get("command", ""),
            "on": latest.provenance.get("machine", ""),
            "at": latest.provenance.get("time", ""),
            "Python": latest.provenance.get("python", ""),
            **packages,
        },
        "families": {family: scenarios.families().get(family, "") for family in board.families},
        "splits": {split: MEANING[split] for split in splits},
        "policies": [_policy(board, i, splits) for i in board.order],
        "degradation": _degradation(board),
        "radius": [_reach(policy, direction, found) for (policy, direction), found in radii.items()],
        "profiles": _profiles(board),
        "pairs": _pairs(board),
        "learning": _learning(board),
        "scenes": _scenes(board, results),
    }


def _policy(board: Board, i: int, splits: Mapping[str, RangeErrors]) -> Policy:
    spec = board.specs[i]
    ranked = board.ranked
    return {
        "name": spec.name,
        "summary": spec.summary,
        "access": spec.access,
        "sensors": ", ".join(spec.needs),
        "preview": f"{spec.preview:.2g} s" if spec.preview else "none",
        "tuning": spec.tuning,
        "rank": between(board.rank, ranked.index(i)) if i in ranked else None,
        "score": _nothing() if board.score is None else between(board.score, i),
        "error": between(board.error, i),
        "families": {family: between(board.family_errors[family], i) for family in board.families},
        "splits": {
            split: {**between(found.error, i), "diverged": float(found.diverged[i])} for split, found in splits.items()
        },
        "failures": between(board.failures, i),
        "variation": float(np.median(board.runs["variation"][i])),
        "decision_us": float(board.decision_us[i]),
        "label": "",
    }


def _nothing() -> Interval:
    return {"value": float("nan"), "low": float("nan"), "high": float("nan")}


def _curve(policy: str, x: Sequence[float] | Array, estimate: Estimate, i: int) -> Curve:
    value, low, high = (np.asarray(y)[i].tolist() for y in (estimate.value, estimate.low, estimate.high))
    return {"policy": policy, "x": list(map(float, x)), "value": value, "low": low, "high": high}


def _degradation(board: Board) -> list[Chart]:
    charts: list[Chart] = []
    for arm in ("", "section-2-2/"):
        for family in board.families:
            found = board.degradation(family, arm)
            if family == "nominal" or found is None:
                continue
            severities, estimate = found
            charts.append(
                {
                    "title": f"{arm}{family}",
                    "description": scenarios.families().get(family, ""),
                    "x": "severity",
                    "y": "tracking error [%]",
                    "scales": ("linear", "log"),
                    "curves": [_curve(board.policies[i], severities, estimate, i) for i in board.order],
                }
            )
    return charts


def _profiles(board: Board) -> list[Chart]:
    tau = np.geomspace(0.05, 100.0, 60)
    estimate = statistics.profile(board.errors, tau, board.counts)
    return [
        {
            "title": "Performance profile",
            "description": "Share of all runs whose tracking error is at most the value on the x axis.",
            "x": "tracking error [%]",
            "y": "share of runs",
            "scales": ("log", "linear"),
            "curves": [_curve(board.policies[i], tau, estimate, i) for i in board.order],
        }
    ]


def _reach(policy: str, direction: str, found: Radius) -> Reach:
    return {
        "policy": policy,
        "direction": direction,
        "value": None if np.isnan(found.value) else found.value,
        "text": str(found),
        "tried": list(found.tried),
    }


def _pairs(board: Board) -> list[Pairs]:
    p = len(board.policies)
    shape: list[list[float | None]] = [[None] * p for _ in range(p)]
    value, low, high = ([row[:] for row in shape] for _ in range(3))
    for a, i in enumerate(board.order):
        for b, j in enumerate(board.order):
            if i != j:
                found = statistics.wins(board.errors[i], board.errors[j], board.counts)
                value[a][b], low[a][b], high[a][b] = (float(x) for x in (found.value, found.low, found.high))
    return [
        {
            "title": "Who errs less",
            "description": "Share of the runs in which the row's policy errs less than the column's on the same seed.",
            "policies": [board.policies[i] for i in board.order],
            "value": value,
            "low": low,
            "high": high,
        }
    ]


def _learning(board: Board) -> list[Chart]:
    """Validation error of the shipped agents while they learned, beside the classical policies' on the same scenario."""
    scenario = "everything-2"
    agents = [policy for policy in board.policies if policy in shipped()]
    if not agents or scenario not in board.scenarios:
        return []
    rms = board.runs["rms_mrad"][:, board.scenarios.index(scenario)].mean(axis=1)
    charts: list[Chart] = []
    for x, column in (("environment steps", 0), ("wall time [s]", 1)):
        lines: list[Curve] = []
        for agent in agents:
            runs = list(curves(agent).values())
            grid = np.unique(np.concatenate([run[:, column] for run in runs]))
            grid = grid[grid > 0]
            values = np.array([np.interp(grid, run[:, column], run[:, 2]) for run in runs])
            bounds = (values.min(axis=0), values.max(axis=0)) if len(runs) > 1 else ([], [])
            lines.append(
                {"policy": agent, "x": grid.tolist(), "value": np.median(values, axis=0).tolist(),
                 "low": list(bounds[0]), "high": list(bounds[1])}
            )  # fmt: skip
        ends = [min(line["x"][0] for line in lines), max(line["x"][-1] for line in lines)]
        for i in board.order:
            if board.specs[i].kind != "learned":
                lines.append(
                    {"policy": board.policies[i], "x": ends, "value": [float(rms[i])] * 2, "low": [], "high": []}
                )
        charts.append(
            {
                "title": f"Learning curves by {x}",
                "description": "RMS error on the validation seeds: median of the training seeds, from least to largest. "
                f"Level lines: the classical policies on {scenario}, test seeds.",
                "x": x,
                "y": "RMS joint error [mrad]",
                "scales": ("log", "log"),
                "curves": lines,
            }
        )
    return charts


def _scenes(board: Board, results: Sequence[Result]) -> list[Scene]:
    """The first seed of each scenario (of severity 2, where there are many), by every policy."""
    tasks = {result.cell.scenario.name: result.cell.scenario for result in results}
    names = list(tasks)
    if len(names) > SCENES:
        names = [name for name in names if name.endswith(("nominal", "-2"))][:SCENES]
    found = []
    for name in names:
        env = TwoLinkArmEnv(tasks[name], action="torque")
        env.reset(seed=board.seeds[0])
        traces = {board.policies[i]: rollout(board.specs[i], tasks[name], board.seeds[:1]) for i in board.order}
        found.append(scene(traces, env.truth.lengths))
    return found
