"""The command `fbl-gym compare`."""

import argparse

from benchmarks.analysis.statistics import geometric_mean, interval, resample, wins
from benchmarks.cli.common import add_policies, console, trust
from benchmarks.cli.evaluate import add_episodes, write_files
from benchmarks.policies.spec import resolve_apart
from benchmarks.report import terminal
from benchmarks.report.plot import plot_comparison
from benchmarks.run.cell import trace_apart
from benchmarks.run.metrics import counted_errors, measure, summarize
from benchmarks.run.store import Store
from fbl_gym import scenarios


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policies(parser, use="two or more")
    add_episodes(parser, 32, "their errors over the seeds", "the first seed side by side")


def run(arguments: argparse.Namespace) -> int:
    trust(arguments)
    if len(set(arguments.policies)) < 2:
        raise ValueError(f"two policies or more can be compared, got {' '.join(arguments.policies)}")
    scenario = scenarios.get(arguments.scenario)
    specs = {policy: resolve_apart(policy) for policy in arguments.policies}
    traces = {name: trace_apart(spec, scenario, range(arguments.seeds)) for name, spec in specs.items()}
    for spec in specs.values():
        Store(arguments.store).look(spec, scenario)
    rows = {policy: measure(trace, more=arguments.metrics) for policy, trace in traces.items()}
    errors = {policy: [counted_errors(runs)] for policy, runs in rows.items()}
    first, counts = arguments.policies[0], resample(arguments.seeds, 0)
    more = [metric.name for metric in arguments.metrics]
    if scenario.constraints is not None:
        more.insert(0, "violation_pct")
    header = ("policy", "error %", "worst seed", "diverged %", "torque variation", *more, f"errs less than {first}")
    lines = []
    for policy, runs in rows.items():
        better, mean = interval(wins(errors[policy], errors[first], counts)), summarize(runs)
        error, worst = geometric_mean(errors[policy], counts)[0], max(errors[policy][0])
        numbers = (error, worst, 100 * mean["diverged"], *(mean[name] for name in ("variation", *more)))
        share = f"{100 * better.value:.0f} % ({100 * better.low:.0f}-{100 * better.high:.0f})"
        lines.append((policy, *map("{:.3g}".format, numbers), share if policy != first else ""))
    screen = console()
    screen.print(terminal.table(f"{scenario.name}, {arguments.seeds} seeds", header, lines))
    title = f"Tracking errors on {scenario.name}"
    write_files(arguments, screen, traces, lambda *place: plot_comparison(traces, title, *place))
    return 0
