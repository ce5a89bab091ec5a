"""`fbl-gym curves`."""

import argparse

import numpy as np

from benchmarks.analysis.curves import Group, read_groups
from benchmarks.analysis.statistics import Estimate
from benchmarks.report.plot import Line, Panel, plot_lines
from benchmarks.report.terminal import show

AXES = {"steps": "environment steps", "cpu_s": "processor time [s]"}


def run(arguments: argparse.Namespace) -> int:
    """Compare training runs after equal steps and after equal processor time."""
    groups = read_groups(arguments.runs)
    common = {axis: min(group.ends(axis).min() for group in groups) for axis in AXES}
    header = ["runs", "seeds", "steps", f"after {common['steps']:,.0f} steps", f"after {common['cpu_s']:.0f} s"]
    rows = []
    for group in sorted(groups, key=lambda group: group.estimate("cpu_s", np.array([common["cpu_s"]])).value[0]):
        ends = group.ends("steps")
        errors = (_text(group.estimate(axis, np.array([point]))) for axis, point in common.items())
        rows.append([group.name, str(len(group.runs)), f"{ends.min():,.0f} to {ends.max():,.0f}", *errors])
    show("Validation error [mrad]", header, rows)
    print("Geometric mean over the training seeds, of the best agent so far, with a 95 % interval over these seeds.")
    if arguments.plot is not None:
        panels = [
            Panel("", label, "validation error [mrad]", tuple(_line(group, axis) for group in groups), ("log", "log"))
            for axis, label in AXES.items()
        ]
        plot_lines("Learning curves", panels, arguments.plot, arguments.width, across=2)
    return 0


def _text(error: Estimate) -> str:
    (value,), (low,), (high,) = error.value, error.low, error.high
    return f"{value:.4g}" if low == high else f"{value:.4g} [{low:.4g}, {high:.4g}]"


def _line(group: Group, axis: str) -> Line:
    first, last = max(run[axis][run[axis] > 0][0] for run in group.runs), group.ends(axis).min()
    points = np.geomspace(max(first, 0.02 * last), last, 60)
    error = group.estimate(axis, points)
    return Line(points, error.value, group.name, low=error.low, high=error.high)
