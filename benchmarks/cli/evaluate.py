"""The command `fbl-gym evaluate`."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from rich.console import Console

from benchmarks.cli import common
from benchmarks.policies.spec import resolve
from benchmarks.report import terminal
from benchmarks.report.plot import caption, plot_trace
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import Trace, rollout
from benchmarks.run.store import Store
from benchmarks.run.traces import export
from fbl_gym import scenarios


def add_episodes(parser: argparse.ArgumentParser, seeds: int, plot: str, video: str) -> None:
    """Add the arguments of `evaluate` and `compare`: the episodes, and the files of them."""
    common.add_scenario(parser)
    parser.add_argument(
        "--seeds", type=common.episodes, default=seeds, metavar="N", help=f"how many episodes, seeds 0 to N-1 ({seeds})"
    )
    common.add_plot(parser, plot)
    parser.add_argument("--video", type=common.film, metavar="FILE", help=f"film {video}: .mp4 or .gif (extra: render)")
    common.add_metrics(parser)
    common.add_trust(parser)
    common.add_store(parser)


def write_files(
    arguments: argparse.Namespace, screen: Console, traces: Mapping[str, Trace], plot: Callable[[Path, int], None]
) -> None:
    """Write the plot and the film that the arguments name."""
    if arguments.plot is not None:
        plot(arguments.plot, arguments.columns)
        screen.print(f"plot: {arguments.plot}, {caption(arguments.seeds)}", markup=False)
    if arguments.video is not None:
        from benchmarks.report.video import write_video  # pygame and a codec: the extra `render`

        write_video(traces, arguments.video)
        screen.print(f"video: {arguments.video}", markup=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    common.add_policy(parser)
    add_episodes(parser, 16, "the signals over the seeds", "the first seed")
    parser.add_argument(
        "--trace", type=common.trace_file, metavar="FILE",
        help="write all signals of all seeds: .npz, .csv, .mat or .parquet",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    common.trust(arguments)
    scenario = scenarios.get(arguments.scenario)
    policy = resolve(arguments.policy)
    trace = rollout(policy, scenario, range(arguments.seeds))
    Store(arguments.store).look(policy, scenario)
    screen, more = common.console(), arguments.metrics
    title = f"{arguments.policy} on {scenario.name}, {arguments.seeds} seeds"
    terminal.evaluation(screen, title, measure(trace, more=more), 1e6 * trace.decision_time, more)
    screen.print(scenario.description, markup=False)
    write_files(arguments, screen, {arguments.policy: trace}, lambda *place: plot_trace(trace, title, *place))
    if arguments.trace is not None:
        export(trace, arguments.trace)
        screen.print(f"trace: {arguments.trace}", markup=False)
    return 0
