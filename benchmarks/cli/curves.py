"""`fbl-gym curves`: learning curves of training runs, grouped over their training seeds."""

import argparse
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.analysis.statistics import Estimate, geometric_mean, interval, resample
from benchmarks.cli.common import write
from benchmarks.report.plot import Line, Panel, plot_lines
from benchmarks.report.terminal import show
from benchmarks.run.expansion import training
from benchmarks.text import reason_of
from fbl_gym.model.arm import Array
from fbl_gym.reading import read_text

AXES = {"steps": "environment steps", "cpu_s": "processor time [s]"}


@dataclass(frozen=True)
class Group:
    """Runs whose settings differ in the training seed alone.

    Attributes:
        name: of the first run's folder, without the seed at its end.
        runs: of each run, the steps and the processor time [s], and `best`, the validation error of
            its best agent so far [mrad]; each [n].
    """

    name: str
    runs: tuple[dict[str, Array], ...]

    def ends(self, axis: str) -> Array:
        """Return the last value of an axis, "steps" or "cpu_s", of each run."""
        return np.array([run[axis][-1] for run in self.runs])

    def estimate(self, axis: str, points: Array) -> Estimate:
        """Return the validation error of the best agent so far at points of an axis [mrad].

        It is the geometric mean over the runs, with its 95 % interval.
        """
        places = [np.searchsorted(run[axis], points, side="right") - 1 for run in self.runs]
        errors = np.array([run["best"][np.maximum(k, 0)] for run, k in zip(self.runs, places, strict=True)])
        return interval(geometric_mean(errors.T[:, None], resample(len(self.runs), 0)))


def read_groups(folders: Sequence[Path]) -> tuple[Group, ...]:
    """Return the runs in some folders of `fbl-gym train`, grouped by their settings.

    Raises:
        ValueError: a folder has no run, or one of other scenarios, or a group has a training seed
            twice.
    """
    groups: dict[str, tuple[str, dict[int, tuple[Path, dict[str, Array]]]]] = {}
    for folder in folders:
        try:
            settings, seed = training(folder)
            table = pd.read_csv(io.StringIO(read_text(folder / "curve.csv")))
            run = {axis: table[axis].to_numpy(float) for axis in AXES}
            run["best"] = np.minimum.accumulate(table["validation_mrad"].to_numpy(float))
            if not run["steps"][-1] > 0:
                raise ValueError("it was stopped before its second validation")
        except (OSError, ValueError, LookupError, TypeError, AttributeError) as problem:
            reason = reason_of(problem)
            raise ValueError(f"RUN must be a folder of fbl-gym train, got {str(folder)!r} ({reason})") from None
        _, runs = groups.setdefault(settings, (folder.resolve().name.removesuffix(f"-{seed}"), {}))
        tasks, first = (json.loads(each).get("scenarios") for each in (settings, next(iter(groups))))
        if tasks != first:
            raise ValueError(f"RUN must have trained on the scenarios of the first RUN, got {str(folder)!r}")
        if seed in runs:
            raise ValueError(f"RUN must differ in settings or seed, got {str(runs[seed][0])!r} and {str(folder)!r}")
        runs[seed] = folder, run
    return tuple(Group(name, tuple(run for _, run in runs.values())) for name, runs in groups.values())


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
    panels = [
        Panel("", label, "validation error [mrad]", tuple(_line(group, axis) for group in groups), ("log", "log"))
        for axis, label in AXES.items()
    ]
    write(arguments.plot, "plot", lambda path: plot_lines("Learning curves", panels, path, arguments.width, across=2))
    return 0


def _text(error: Estimate) -> str:
    (value,), (low,), (high,) = error.value, error.low, error.high
    return f"{value:.4g}" if low == high else f"{value:.4g} [{low:.4g}, {high:.4g}]"


def _line(group: Group, axis: str) -> Line:
    first, last = max(run[axis][run[axis] > 0][0] for run in group.runs), group.ends(axis).min()
    points = np.geomspace(max(first, 0.02 * last), last, 60)
    error = group.estimate(axis, points)
    return Line(points, error.value, group.name, low=error.low, high=error.high)
