"""The command `fbl-gym compare`."""

from __future__ import annotations

import argparse

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from benchmarks.analysis.statistics import estimate, resample, wins
from benchmarks.cli.common import (
    add_metrics,
    add_plot,
    add_scenario,
    add_store,
    add_trust,
    console,
    episodes,
    film,
    policy_name,
    trust,
)
from benchmarks.policies.spec import resolve_apart
from benchmarks.report.plot import caption, plot_comparison
from benchmarks.run.cell import trace_apart
from benchmarks.run.metrics import counted_errors, measure, summarize
from benchmarks.run.store import Store
from fbl_gym import scenarios


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "policies", nargs="+", type=policy_name, metavar="POLICY", help="two or more, as for `fbl-gym evaluate`"
    )
    add_scenario(parser)
    parser.add_argument(
        "--seeds", type=episodes, default=32, metavar="N", help="how many episodes, seeds 0 to N-1 (32)"
    )
    add_plot(parser, "their errors over the seeds")
    parser.add_argument("--video", type=film, metavar="FILE", help="film the first seed side by side: .mp4 or .gif")
    add_metrics(parser)
    add_trust(parser)
    add_store(parser)


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
    table = Table(title=escape(f"{scenario.name}, {arguments.seeds} seeds"), title_style="bold", box=SIMPLE_HEAD)
    table.add_column("policy")
    more = [metric.name for metric in arguments.metrics]
    for name in ("error %", "worst seed", "diverged %", "torque variation", *more, f"errs less than {first}"):
        table.add_column(escape(name), justify="right")
    for policy, runs in rows.items():
        better, mean = wins(errors[policy], errors[first], counts), summarize(runs)
        table.add_row(
            escape(policy),
            f"{estimate(errors[policy], counts).value:.3g}",
            f"{max(errors[policy][0]):.3g}",
            f"{100 * mean['diverged']:.2g}",
            *(f"{mean[name]:.3g}" for name in ("variation", *more)),
            "" if policy == first else f"{100 * better.value:.0f} % ({100 * better.low:.0f}-{100 * better.high:.0f})",
        )
    screen = console()
    screen.print(table)
    if arguments.plot is not None:
        plot_comparison(traces, f"Tracking errors on {scenario.name}", arguments.plot, arguments.columns)
        screen.print(f"plot: {arguments.plot}, {caption(arguments.seeds)}", markup=False)
    if arguments.video is not None:
        from benchmarks.report.video import write_video  # pygame and a codec: the extra `render`

        write_video(traces, arguments.video)
        screen.print(f"video: {arguments.video}", markup=False)
    return 0
