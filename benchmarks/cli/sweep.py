"""The command `fbl-gym sweep`: the error over the values of options."""

import argparse
import itertools
import math
import re
import sys
from collections import defaultdict
from typing import Any, TypeAlias

import numpy as np

from benchmarks.cli.common import command_line, run_all
from benchmarks.cli.list import options
from benchmarks.cli.parser import count
from benchmarks.report.columns import number
from benchmarks.report.export import write_runs
from benchmarks.report.latex import write_table
from benchmarks.report.plot import QUANTILES, Panel, band, caption, plot_lines
from benchmarks.report.terminal import show
from benchmarks.run.expansion import with_option
from benchmarks.run.metrics import counted_errors
from benchmarks.run.suite import Suite
from benchmarks.text import say
from fbl_gym import scenarios
from fbl_gym.records.checks import Pair

#: A value of an option: of both joints, or one for each.
Value: TypeAlias = float | Pair

#: Most cells of a sweep.
MOST_CELLS = 100_000


def over(text: str) -> tuple[str, str, list[Value], bool]:
    """Return an option's path, the scale of its axis, its values, and True if they are factors."""
    path, _, values = text.partition("=")
    factors, values = values.startswith("x"), values.removeprefix("x")
    try:
        if path in ("", "name", "description"):
            raise argparse.ArgumentTypeError(f"must name an option that `fbl-gym list options` prints, got {text!r}")
        if ":" in values:
            low, high, scale, number = values.split(":")
            ends = float(low), float(high), count(number, 10_000)
            if scale == "log" and min(ends[:2]) <= 0:
                raise argparse.ArgumentTypeError(f"must have ends above 0 for log, got {text!r}")
            space: Any = {"log": np.geomspace, "lin": np.linspace}[scale]
            points = [*map(_value, space(*ends))]
        else:
            scale, points = "lin", [_value(*([x] if factors else x.split("/"))) for x in values.split(",")]
    except (ValueError, KeyError):
        raise argparse.ArgumentTypeError(
            "must be such as noise.position=1e-4:1e-2:log:9, actuator.delay=0:0.03:lin:4, arm.m2=2,4,6, "
            f"friction.coulomb=1/2,3/4 for the two joints or friction.coulomb=x0.5:2:log:5, got {text!r}"
        ) from None
    if len(set(points)) < len(points):
        raise argparse.ArgumentTypeError(f"must have values that differ in their first six digits, got {text!r}")
    return path, scale.replace("lin", "linear"), points, factors


def _value(first: float | str, *second: float | str) -> Value:
    """Return a value with six digits, of both joints or one for each."""
    if len(second) > 1:
        raise ValueError
    value, *other = (float(f"{float(x):.6g}") for x in (first, *second))
    return (value, other[0]) if other else value


def _text(value: Value) -> str:
    return "/".join(np.format_float_positional(x, trim="-") for x in np.ravel(value))


def run(arguments: argparse.Namespace) -> int:
    """Measure each policy at each value, and write all runs and a figure."""
    names, scales, values, factors = zip(*arguments.over, strict=True)
    if any(f"{one}.".startswith(f"{other}.") for one, other in itertools.permutations(names, 2)):
        raise ValueError(f"--over must name options that are no part of each other, got {' '.join(names)}")
    if (size := math.prod(map(len, values)) * len(arguments.policies)) > MOST_CELLS:
        raise ValueError(f"--over must give at most {MOST_CELLS} cells, policies times values, got {size}")
    points = list(itertools.product(*values))
    tasks = [scenarios.get(arguments.scenario)] * len(points)
    for i, (name, factor) in enumerate(zip(names, factors, strict=True)):
        tasks = [with_option(task, name, point[i], factor=factor) for task, point in zip(tasks, points, strict=True)]
    suite = Suite("sweep", tuple(arguments.policies), tuple(tasks), arguments.seeds)
    results = run_all(suite.cells, arguments)
    curves, columns = defaultdict(list), defaultdict(list)  # errors and texts, by policy and values of further options
    runs = []
    for (point, _), cell in zip(itertools.product(points, suite.policies), suite.cells, strict=True):
        policy, result, texts = cell.policy.name, results[cell], [*map(_text, point)]
        if result.error:
            say(f"fbl-gym: {cell.id} failed: {result.error}", sys.stderr)
        errors = counted_errors(result.rows) or [np.nan] * len(cell.seeds)
        (low, mid, high), lost = np.quantile(errors, QUANTILES), sum(row["diverged"] > 0 for row in result.rows)
        text = f"{number(mid)} ({number(low)}–{number(high)})" + f", {lost} lost" * (lost > 0)
        curves[policy, *texts[1:]].append(errors)
        columns[policy, *texts[1:]].append(text)
        written = (text if isinstance(x, tuple) else x for x, text in zip(point, texts, strict=True))
        runs.append(((policy, *written), cell.seeds, result.rows))
    write_runs(arguments.csv, ("policy", *names), runs)
    first, *others = (_label(name, factor) for name, factor in zip(names, factors, strict=True))
    titles = {key: ", ".join([key[0], *map(" ".join, zip(names[1:], key[1:], strict=True))]) for key in curves}
    ticks = [_text(value) for value in values[0]]
    x = np.array(ticks if any(isinstance(value, tuple) for value in values[0]) else values[0])
    path = arguments.plot or arguments.csv.with_suffix(".png")
    lines = tuple(band(x, np.array(curves[key]), titles[key]) for key in curves)
    panel = Panel("", first, "error [%]", lines, (scales[0], "log"))
    plot_lines(f"Error on {arguments.scenario}, {arguments.seeds} seeds", [panel], path, arguments.width)
    meaning = f"median error in % (10 to 90 % of {arguments.seeds} seeds), and the number of diverged runs"
    show(meaning, (first, *titles.values()), zip(ticks, *columns.values(), strict=True))
    if arguments.tex is not None:
        groups: list[tuple[str, int]] = []
        policies = [*dict.fromkeys(key[0] for key in columns)]
        keys = sorted(columns, key=lambda key: policies.index(key[0]))
        heads = [titles[key] for key in keys]
        if len(names) == 2:  # a grid for each policy: its columns are the values of the second option
            groups = [("", 1), *((f"{policy}, {others[0]}", len(columns) // len(policies)) for policy in policies)]
            heads = [key[1] for key in keys]
        rows = zip(ticks, *map(columns.get, keys), strict=True)
        write_table(arguments.tex, (first, *heads), rows, command_line(), meaning, groups)
        say(f"table: {arguments.tex}")
    say(f"runs: {arguments.csv}\nfigure: {path}, {caption(arguments.seeds)}")
    return int(any(result.error for result in results.values()))


def _label(path: str, factor: bool) -> str:
    """Return an option with the unit of its number; the errors of a sensor have the sensor's."""
    if factor:
        return f"factor on {path}"
    known, field = {option.path: option for option in options()}, path
    if path in known and (part := re.search(r"or its (\w+)", known[path].form)):
        field += f".{part[1]}"
    sensor, _, name = field.rpartition(".")
    if name in ("sigma", "bias", "quantization"):
        unit = "".join(re.findall(r"\[(.+)\]", known[sensor].meaning))
    else:
        unit = known[field].unit if field in known else ""
    return f"{path} [{unit}]" if unit else path
