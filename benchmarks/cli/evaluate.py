"""The command `fbl-gym evaluate`: one policy, several side by side, or several trials in a row."""

import argparse
import re
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from benchmarks.analysis.statistics import geometric_mean, proportion, resample, tail_mean, wins
from benchmarks.cli.common import command_line, write
from benchmarks.policies.spec import resolve
from benchmarks.report import terminal
from benchmarks.report.columns import Table, number
from benchmarks.report.export import write_runs
from benchmarks.report.latex import write_table
from benchmarks.report.plot import Panel, band, caption, plot_comparison, plot_lines, plot_trace
from benchmarks.run.metrics import counted_errors, measure
from benchmarks.run.runner import run_trials
from benchmarks.run.traces import export
from benchmarks.text import say
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import Array

Rows = list[dict[str, float]]


def run(arguments: argparse.Namespace) -> int:
    """Run the policies, print their metrics, and write the files that the arguments name."""
    names, seeds = {str(name): name for name in arguments.policies}, range(arguments.seeds)
    detailed, alone = arguments.trace is not None, len(names) == arguments.trials == 1
    if detailed and arguments.trials > 1:
        raise ValueError(f"--trace is for one trial, got --trials {arguments.trials}")
    scenario = scenarios.get(arguments.scenario)
    traces = {
        policy: run_trials(resolve(name), scenario, seeds, arguments.trials, detailed=detailed)
        for policy, name in names.items()
    }
    runs = {policy: [measure(trace) for trace in trials] for policy, trials in traces.items()}
    last = {policy: trials[-1] for policy, trials in traces.items()}
    title = f"{scenario.name}, {arguments.seeds} seeds"
    if arguments.trials > 1:
        title = f"error % on {title}: median (worst 5 %)"
        table = _trials_table(runs)
        bands = (band(np.arange(1.0, len(trials) + 1.0), _errors(trials), policy) for policy, trials in runs.items())
        panel = Panel("", "trial", "error [%]", tuple(bands), ("linear", "log"))
        draw = partial(plot_lines, f"Error over trials of {scenario.name}", [panel])
    elif not alone:
        table = _comparison({policy: rows for policy, (rows,) in runs.items()}, scenario)
        draw = partial(plot_comparison, last, f"Tracking on {scenario.name}")
    else:
        ((policy, trace),), ((rows,),) = last.items(), runs.values()
        title = f"{policy} on {title}"
        table = terminal.evaluation(rows, 1e6 * trace.decision_time, arguments.columns == "all")
        draw = partial(plot_trace, trace, title)
    terminal.show(title, *table, "left" if alone else "right")
    if alone:
        say(scenario.description)
    for policy, name in names.items():
        for path in name.gains_of_other_arms(scenario.arm):
            say(f"{policy}: {path} has the gains of another arm than that of {scenario.name}")
    width = 3 if alone else len(table.header)  # without the meaning of the metrics
    cells = table.header[:width], [row[:width] for row in table.rows], command_line()
    write(arguments.tex, "table", lambda path: write_table(path, *cells))
    write(arguments.plot, "plot", lambda path: draw(path, arguments.width), f", {caption(arguments.seeds)}")
    for policy, trace in last.items() if detailed else ():
        own = "" if alone else "-" + re.sub(r"[^\w.+@=-]", "-", policy)
        write(arguments.trace.with_stem(arguments.trace.stem + own), "trace", partial(export, trace))
    every = [((policy, i), seeds, rows) for policy, trials in runs.items() for i, rows in enumerate(trials, 1)]
    write(arguments.csv, "runs", lambda path: write_runs(path, ("policy", "trial"), every))
    return 0


def _comparison(runs: Mapping[str, Rows], scenario: Scenario) -> Table:
    """Return a table of several policies, each compared with the first."""
    errors = {policy: [counted_errors(rows)] for policy, rows in runs.items()}
    first = next(iter(runs))
    counts = resample(len(runs[first]), 0)
    names = ["violation_pct"] if scenario.constraints is not None else []
    header = ("policy", "error %", "worst seed", "diverged %", "torque variation", *names, "errs less than the first")
    lines = []
    for policy, rows in runs.items():
        n = len(rows)
        better = proportion(n * wins(errors[policy], errors[first], counts)[0], n)
        error, worst = geometric_mean(errors[policy], counts)[0], max(errors[policy][0])
        lost, *means = (np.mean([row[name] for row in rows]) for name in ("diverged", "variation", *names))
        share = f"{100 * better.value:.0f} % ({100 * better.low:.0f}–{100 * better.high:.0f})"
        lines.append((policy, *map(number, (error, worst, 100 * lost, *means)), share if policy != first else ""))
    return Table(header, lines)


def _trials_table(runs: Mapping[str, list[Rows]]) -> Table:
    """Return a table with a row for each trial and a column for each policy."""
    columns = []
    for trials in runs.values():
        errors, diverged = _errors(trials), [sum(row["diverged"] > 0 for row in rows) for rows in trials]
        columns.append([
            f"{np.median(error):.3g} ({tail:.3g})" + f", {lost} diverged" * (lost > 0)
            for error, tail, lost in zip(errors, tail_mean(errors), diverged, strict=True)
        ])  # fmt: skip
    return Table(("trial", *runs), [(str(trial), *cells) for trial, cells in enumerate(zip(*columns, strict=True), 1)])


def _errors(trials: Sequence[Rows]) -> Array:
    """Return the errors of each trial and seed [trials x seeds] in %."""
    return np.array(list(map(counted_errors, trials)), dtype=np.float64)
