"""The command `fbl-gym trials`: the error of policies over repeated trials of one motion."""

import argparse
import csv
import io
from pathlib import Path

import numpy as np

from benchmarks.analysis.statistics import tail_mean
from benchmarks.cli.common import add_plot, add_policies, add_scenario, add_trust, console, count, episodes, trust
from benchmarks.files import write_text
from benchmarks.policies.spec import resolve_apart
from benchmarks.report import terminal
from benchmarks.report.plot import Panel, band, caption, plot_lines
from benchmarks.run.cell import trials_apart
from benchmarks.run.metrics import counted_errors, measure
from fbl_gym import scenarios


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policies(parser)
    add_scenario(parser, "practice-nominal")
    parser.add_argument("--trials", type=count, default=10, metavar="K", help="episodes in a row (10)")
    parser.add_argument("--seeds", type=episodes, default=16, metavar="N", help="arms and motions, seeds 0 to N-1 (16)")
    add_plot(parser, "the error over the trials")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write all metrics of all runs")
    add_trust(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the errors of each policy in each trial, and write the runs and a figure."""
    trust(arguments)
    scenario = scenarios.get(arguments.scenario)
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    columns, lines = [], []
    trials = np.arange(1, arguments.trials + 1)
    for policy in arguments.policies:
        traces = trials_apart(resolve_apart(policy), scenario, range(arguments.seeds), arguments.trials)
        runs = [measure(trace) for trace in traces]
        errors, diverged = np.array(list(map(counted_errors, runs))), [int((~t.alive[-1]).sum()) for t in traces]
        worst = tail_mean(errors)
        columns.append([
            f"{np.median(error):.3g} ({tail:.3g})" + f", {lost} diverged" * (lost > 0)
            for error, tail, lost in zip(errors, worst, diverged, strict=True)
        ])  # fmt: skip
        lines.append(band(trials, errors, policy))
        if not text.getvalue():
            rows.writerow(["policy", "trial", "seed", *runs[0][0]])
        for trial, each in zip(trials, runs, strict=True):
            for seed, metrics in enumerate(each):
                rows.writerow([policy, trial, seed, *map("{:.7g}".format, metrics.values())])
    screen = console()
    title = f"error % on {scenario.name}: median (worst 5 %) of {arguments.seeds} seeds"
    screen.print(terminal.table(title, ("trial", *arguments.policies), zip(map(str, trials), *columns, strict=True)))
    if arguments.csv is not None:
        write_text(arguments.csv, text.getvalue())
        screen.print(f"runs: {arguments.csv}", markup=False)
    if arguments.plot is not None:
        panel = Panel("", "trial", "error [%]", tuple(lines), ("linear", "log"))
        plot_lines(f"Error over trials of {scenario.name}", [panel], arguments.plot, arguments.columns)
        screen.print(f"plot: {arguments.plot}, {caption(arguments.seeds)}", markup=False)
    return 0
