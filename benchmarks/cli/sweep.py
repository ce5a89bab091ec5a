"""The command `fbl-gym sweep`: the error over the values of one or two options."""

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np
from rich.progress import track

from benchmarks.cli.common import (
    add_metrics,
    add_plot,
    add_policies,
    add_run,
    add_scenario,
    command_line,
    count,
    csv_path,
    trust,
)
from benchmarks.cli.names import options
from benchmarks.report.export import csv_file
from benchmarks.report.plot import QUANTILES, Line, Panel, caption, plot_lines, plot_maps
from benchmarks.report.terminal import Screen
from benchmarks.run.metrics import counted_errors
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Store
from benchmarks.run.suite import Suite, with_option
from benchmarks.text import say
from fbl_gym import scenarios

Over = tuple[str, str, list[float]]
"""The path of an option, the scale of its axis, and its values."""


def over(text: str) -> Over:
    """Return an option and its values; an argument's type."""
    path, _, values = text.partition("=")
    try:
        if ":" in values:
            low, high, scale, number = values.split(":")
            ends = float(low), float(high), count(number)
            points = {"log": lambda: np.geomspace(*ends), "lin": lambda: np.linspace(*ends)}[scale]().tolist()
        else:
            scale, points = "lin", [float(value) for value in values.split(",")]
    except (ValueError, KeyError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(
            f"must be such as noise.position=1e-4:1e-2:log:9, actuator.delay=0:0.03:lin:4 or arm.m2=2,4,6, got {text!r}"
        ) from None
    points = [float(f"{point:.6g}") for point in points]
    if len(set(points)) < len(points):
        raise argparse.ArgumentTypeError(f"must have values that differ in their first six digits, got {text!r}")
    return path, scale.replace("lin", "linear"), points


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policies(parser)
    parser.add_argument(
        "--over", type=over, action="append", required=True, metavar="OPTION=VALUES",
        help="an option from `fbl-gym list options` and its values: LOW:HIGH:log:N, LOW:HIGH:lin:N, or A,B,C; "
        "given twice, every pair of values",
    )  # fmt: skip
    add_scenario(parser)
    parser.add_argument(
        "--csv",
        type=csv_path,
        default=Path("results/sweep.csv"),
        metavar="FILE",
        help="write all metrics of all runs: .csv (results/sweep.csv)",
    )
    add_plot(parser, "the errors (a .png beside --csv)")
    add_metrics(parser)
    add_run(parser, seeds=32)


def run(arguments: argparse.Namespace) -> int:
    """Measure each policy at each value, and write all runs and a figure."""
    trust(arguments)
    names, scales, values = zip(*arguments.over, strict=True)
    if len(names) > 2:
        raise ValueError(f"--over may be given once or twice, got {' '.join(names)}")
    if len(names) == 2 and any(f"{one}.".startswith(f"{other}.") for one, other in (names, names[::-1])):
        raise ValueError(f"--over must name two options that are no part of each other, got {' '.join(names)}")
    points = list(itertools.product(*values))
    tasks = []
    for point in points:
        task = scenarios.get(arguments.scenario)
        for name, value in zip(names, point, strict=True):
            task = with_option(task, name, value)
        tasks.append(task)
    suite = Suite("sweep", tuple(arguments.policies), tuple(tasks), arguments.seeds, arguments.metrics)
    store, cells = Store(arguments.store), suite.cells
    outcomes = run_cells(cells, store, workers=arguments.workers, command=command_line(), cluster=arguments.cluster)
    failed = 0
    for outcome in track(outcomes, "cells", len(cells), console=Screen(stderr=True)):
        if outcome.error:
            failed += 1
            say(f"fbl-gym: {outcome.id} failed: {outcome.error}", sys.stderr)
    curves: dict[str, list[np.ndarray]] = {}
    with csv_file(arguments.csv, ("policy", *names), cells[0].columns) as append:
        for i, cell in enumerate(cells):
            band = np.full(3, np.nan)
            if (result := store.find(cell)) is not None:
                append((cell.policy.name, *points[i // (len(cells) // len(points))]), cell.seeds, result.rows)
                band = np.quantile(counted_errors(result.rows), QUANTILES)
            curves.setdefault(cell.policy.name, []).append(band)
    path = arguments.plot or arguments.csv.with_suffix(".png")
    title = f"Error on {arguments.scenario}, {arguments.seeds} seeds"
    bands = {policy: np.array(bands) for policy, bands in curves.items()}
    units = {option.path: option.unit for option in options()}
    labels = [f"{name} [{units[name]}]" if units.get(name) else name for name in names]
    if len(names) == 1:
        (x,) = map(np.array, values)
        lines = tuple(Line(x, band[:, 1], policy, low=band[:, 0], high=band[:, 2]) for policy, band in bands.items())
        panel = Panel("", labels[0], "error [%]", lines, (scales[0], "log"))
        plot_lines(title, [panel], path, arguments.columns)
    else:
        shape = tuple(map(len, values))
        maps = {policy: band[:, 1].reshape(shape) for policy, band in bands.items()}
        plot_maps(title, labels, values, maps, path, arguments.columns)
    say(f"runs: {arguments.csv}\nfigure: {path}, {caption(arguments.seeds)}")
    return 1 if failed else 0
