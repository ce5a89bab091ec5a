"""The command `fbl-gym evaluate`."""

import argparse

from benchmarks.cli.common import (
    add_metrics,
    add_plot,
    add_policy,
    add_scenario,
    add_store,
    add_trust,
    console,
    episodes,
    film,
    trace_file,
    trust,
)
from benchmarks.policies.spec import resolve
from benchmarks.report import terminal
from benchmarks.report.plot import caption, plot_trace
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.run.store import Store
from benchmarks.run.traces import export
from fbl_gym import scenarios


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policy(parser)
    add_scenario(parser)
    parser.add_argument(
        "--seeds", type=episodes, default=16, metavar="N", help="how many episodes, seeds 0 to N-1 (16)"
    )
    add_plot(parser, "the signals over the seeds")
    parser.add_argument("--video", type=film, metavar="FILE", help="film the first seed: .mp4 or .gif (extra: render)")
    parser.add_argument(
        "--trace", type=trace_file, metavar="FILE", help="write all signals of all seeds: .npz, .csv, .mat or .parquet"
    )
    add_metrics(parser)
    add_trust(parser)
    add_store(parser)


def run(arguments: argparse.Namespace) -> int:
    trust(arguments)
    scenario = scenarios.get(arguments.scenario)
    policy = resolve(arguments.policy)
    trace = rollout(policy, scenario, range(arguments.seeds))
    Store(arguments.store).look(policy, scenario)
    screen = console()
    title = f"{arguments.policy} on {scenario.name}, {arguments.seeds} seeds"
    terminal.evaluation(
        screen, title, measure(trace, more=arguments.metrics), 1e6 * trace.decision_time, arguments.metrics
    )
    screen.print(scenario.description, markup=False)
    if arguments.plot is not None:
        plot_trace(trace, title, arguments.plot, arguments.columns)
        screen.print(f"plot: {arguments.plot}, {caption(arguments.seeds)}", markup=False)
    if arguments.trace is not None:
        export(trace, arguments.trace)
        screen.print(f"trace: {arguments.trace}", markup=False)
    if arguments.video is not None:
        from benchmarks.report.video import write_video  # pygame and a codec: the extra `render`

        write_video({arguments.policy: trace}, arguments.video)
        screen.print(f"video: {arguments.video}", markup=False)
    return 0
