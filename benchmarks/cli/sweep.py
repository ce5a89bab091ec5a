"""The command `fbl-gym sweep`: the error over the values of options."""

import argparse
import functools
import itertools
import math
import re
import sys
from pathlib import Path

import numpy as np

from benchmarks.cli import common
from benchmarks.cli.list import options
from benchmarks.report.columns import number
from benchmarks.report.export import write_runs
from benchmarks.report.latex import write_table
from benchmarks.report.plot import QUANTILES, Panel, band, caption, plot_lines
from benchmarks.report.terminal import Screen, table
from benchmarks.run.expansion import with_option
from benchmarks.run.metrics import counted_errors
from benchmarks.run.suite import Suite
from benchmarks.text import say
from fbl_gym import scenarios

MOST_CELLS = 100_000
"""Most cells of a sweep."""


def over(text: str) -> tuple[str, str, list[float], bool]:
    """Return an option's path, the scale of its axis, its values, and True if they are factors."""
    path, _, values = text.partition("=")
    factors, values = values.startswith("x"), values.removeprefix("x")
    try:
        if ":" in values:
            low, high, scale, number = values.split(":")
            ends = float(low), float(high), common.count(number, 10_000)
            points = {"log": lambda: np.geomspace(*ends), "lin": lambda: np.linspace(*ends)}[scale]().tolist()
        else:
            scale, points = "lin", [float(value) for value in values.split(",")]
    except (ValueError, KeyError):
        raise argparse.ArgumentTypeError(
            "must be such as noise.position=1e-4:1e-2:log:9, actuator.delay=0:0.03:lin:4, arm.m2=2,4,6 or "
            f"friction.coulomb=x0.5:2:log:5, got {text!r}"
        ) from None
    points = [float(f"{point:.6g}") for point in points]
    if len(set(points)) < len(points):
        raise argparse.ArgumentTypeError(f"must have values that differ in their first six digits, got {text!r}")
    return path, scale.replace("lin", "linear"), points, factors


def add_arguments(parser: argparse.ArgumentParser) -> None:
    common.add(parser, "policies")
    values = "an option from `fbl-gym list options` and its values: LOW:HIGH:log:N, LOW:HIGH:lin:N, or A,B,C; "
    values += (
        "after an x, factors on the scenario's own, of both joints; given more than once, all combinations of values"
    )
    parser.add_argument("--over", type=over, action="append", required=True, metavar="OPTION=VALUES", help=values)
    common.add(parser, "--scenario")
    common.add_file(parser, "--csv", "write all metrics of all runs, by default to results/sweep.csv", ".csv")
    parser.set_defaults(csv=Path("results/sweep.csv"))
    common.add_plot(parser, "the errors (a .png beside --csv)")
    common.add_tex(parser)
    common.add_option(parser, "--seeds", common.episodes, 32, "N", "test seeds 0 to N-1")
    common.add(parser, *common.RUN)


def run(arguments: argparse.Namespace) -> int:
    """Measure each policy at each value, and write all runs and a figure."""
    common.trust(arguments)
    names, scales, values, factors = zip(*arguments.over, strict=True)
    if any(f"{one}.".startswith(f"{other}.") for one, other in itertools.permutations(names, 2)):
        raise ValueError(f"--over must name options that are no part of each other, got {' '.join(names)}")
    if (size := math.prod(map(len, values)) * len(arguments.policies)) > MOST_CELLS:
        raise ValueError(f"--over must give at most {MOST_CELLS} cells, policies times values, got {size}")
    base, points = scenarios.get(arguments.scenario), list(itertools.product(*values))
    options_of = (zip(names, point, factors, strict=True) for point in points)
    tasks = tuple(
        functools.reduce(lambda task, each: with_option(task, *each[:2], factor=each[2]), changes, base)
        for changes in options_of
    )
    cells = Suite("sweep", tuple(arguments.policies), tasks, arguments.seeds).cells
    results = common.results_by_id(cells, arguments)
    curves: dict[str, list[list[float]]] = {}
    lost: dict[str, list[int]] = {}
    runs = []
    for i, cell in enumerate(cells):
        point, result = points[i // (len(cells) // len(points))], results[cell.id]
        if result.error:
            say(f"fbl-gym: {cell.id} failed: {result.error}", sys.stderr)
        runs.append(((cell.policy.name, *point), cell.seeds, result.rows))
        others = (f"{option} {value:g}" for option, value in zip(names[1:], point[1:], strict=True))
        name = ", ".join([cell.policy.name, *others])
        curves.setdefault(name, []).append(counted_errors(result.rows) or [np.nan] * len(cell.seeds))
        lost.setdefault(name, []).append(sum(row["diverged"] > 0 for row in result.rows))
    write_runs(arguments.csv, ("policy", *names), runs)
    path = arguments.plot or arguments.csv.with_suffix(".png")
    unit = _unit(names[0])
    label = f"factor on {names[0]}" if factors[0] else f"{names[0]} [{unit}]" if unit else names[0]
    lines = tuple(band(np.array(values[0]), np.array(errors), name) for name, errors in curves.items())
    panel = Panel("", label, "error [%]", lines, (scales[0], "log"))
    plot_lines(f"Error on {arguments.scenario}, {arguments.seeds} seeds", [panel], path, arguments.width)
    columns = [[np.format_float_positional(value, trim="-") for value in values[0]]]
    for name, curve in curves.items():
        bands = zip(*np.quantile(curve, QUANTILES, axis=-1), lost[name], strict=True)
        texts = ((f"{number(mid)} ({number(low)}–{number(high)})", n) for low, mid, high, n in bands)
        columns.append([text + f", {n} lost" * (n > 0) for text, n in texts])
    header, rows = (label, *curves), list(zip(*columns, strict=True))
    meaning = f"median error in % (10 to 90 % of {arguments.seeds} seeds), and the number of diverged runs"
    Screen().print(table(meaning, header, rows))
    if arguments.tex is not None:
        write_table(arguments.tex, header, rows, common.command_line(), meaning)
        say(f"table: {arguments.tex}")
    say(f"runs: {arguments.csv}\nfigure: {path}, {caption(arguments.seeds)}")
    return int(any(result.error for result in results.values()))


def _unit(path: str) -> str:
    """Return the unit of an option's number; the errors of a sensor have the sensor's."""
    known = {option.path: option for option in options()}
    if path in known and (field := re.search(r"or its (\w+)", known[path].form)):
        path += f".{field[1]}"
    sensor, _, name = path.rpartition(".")
    if name in ("sigma", "bias", "quantization"):
        return "".join(re.findall(r"\[(.+)\]", known[sensor].meaning))
    return known[path].unit if path in known else ""
