"""The command `fbl-gym sweep`: the error over the values of options."""

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np

from benchmarks.cli import common
from benchmarks.cli.names import options
from benchmarks.report.export import csv_file
from benchmarks.report.latex import write_table
from benchmarks.report.plot import QUANTILES, Line, Panel, caption, plot_lines
from benchmarks.run.metrics import counted_errors
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
            ends = float(low), float(high), common.count(number)
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
    common.add_policies(parser)
    parser.add_argument(
        "--over", type=over, action="append", required=True, metavar="OPTION=VALUES",
        help="an option from `fbl-gym list options` and its values: LOW:HIGH:log:N, LOW:HIGH:lin:N, or A,B,C; "
        "given more than once, all combinations of values",
    )  # fmt: skip
    common.add_scenario(parser)
    runs = "write all metrics of all runs: .csv"
    common.add_option(parser, "--csv", common.csv_path, Path("results/sweep.csv"), "FILE", runs)
    common.add_plot(parser, "the errors (a .png beside --csv)")
    common.add_tex(parser)
    common.add_metrics(parser)
    common.add_run(parser, seeds=32)


def run(arguments: argparse.Namespace) -> int:
    """Measure each policy at each value, and write all runs and a figure."""
    common.trust(arguments)
    names, scales, values = zip(*arguments.over, strict=True)
    if any(f"{one}.".startswith(f"{other}.") for one, other in itertools.permutations(names, 2)):
        raise ValueError(f"--over must name options that are no part of each other, got {' '.join(names)}")
    points = list(itertools.product(*values))
    tasks = []
    for point in points:
        task = scenarios.get(arguments.scenario)
        for name, value in zip(names, point, strict=True):
            task = with_option(task, name, value)
        tasks.append(task)
    suite = Suite("sweep", tuple(arguments.policies), tuple(tasks), arguments.seeds, arguments.metrics)
    store, cells = Store(arguments.store), suite.cells
    failed = 0
    for result in common.run_all(cells, arguments):
        if result.error:
            failed += 1
            say(f"fbl-gym: {result.cell.id} failed: {result.error}", sys.stderr)
    curves: dict[str, list[np.ndarray]] = {}
    with csv_file(arguments.csv, ("policy", *names), cells[0].columns) as append:
        for i, cell in enumerate(cells):
            point = points[i // (len(cells) // len(points))]
            band = np.full(3, np.nan)
            if (stored := store.find(cell)) is not None:
                append((cell.policy.name, *point), cell.seeds, stored.rows)
                band = np.quantile(counted_errors(stored.rows), QUANTILES)
            others = (f"{name} {value:g}" for name, value in zip(names[1:], point[1:], strict=True))
            curves.setdefault(", ".join([cell.policy.name, *others]), []).append(band)
    path = arguments.plot or arguments.csv.with_suffix(".png")
    unit = {option.path: option.unit for option in options()}.get(names[0])
    label = f"{names[0]} [{unit}]" if unit else names[0]
    lines = []
    for name, bands in curves.items():
        low, median, high = np.transpose(bands)
        lines.append(Line(np.array(values[0]), median, name, low=low, high=high))
    panel = Panel("", label, "error [%]", tuple(lines), (scales[0], "log"))
    plot_lines(f"Error on {arguments.scenario}, {arguments.seeds} seeds", [panel], path, arguments.columns)
    if arguments.tex is not None:
        header = ("policy", *(f"{names[0]} {value:g}" for value in values[0]))
        rows = [
            (name, *(f"{median:.3g} ({low:.3g}–{high:.3g})" for low, median, high in bands))
            for name, bands in curves.items()
        ]
        write_table(arguments.tex, header, rows, common.command_line())
        say(f"table: {arguments.tex}, medians (10 to 90 % of the seeds) of the error [%]")
    say(f"runs: {arguments.csv}\nfigure: {path}, {caption(arguments.seeds)}")
    return 1 if failed else 0
