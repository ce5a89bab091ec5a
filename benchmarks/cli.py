"""The command line, `fbl-gym`."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import controllers
from fbl_gym import __version__, scenarios


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    arguments = _parser().parse_args(argv)
    try:
        return arguments.run(arguments)
    except BrokenPipeError:  # whoever read our output, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, MissingExtra, OSError) as problem:
        print(f"fbl-gym: {problem}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("fbl-gym: stopped", file=sys.stderr)
        return 130


SAVE_EVERY = 5.0
"""A leaderboard's results are written this often while it runs [s], so that a killed run leaves what it had."""


class MissingExtra(ImportError):
    """A package of an extra is not installed."""


def _need(*packages: str, extra: str) -> None:
    for package in packages:
        try:
            __import__(package)
        except ImportError as problem:
            raise MissingExtra(
                f"this command needs {package}, which is not installed: pip install 'fbl-gym[{extra}]' ({problem})"
            ) from problem


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="fbl-gym",
        description="Robust, adaptive and learned control on one uncertain two-link arm.",
    )
    parser.add_argument("--version", action="version", version=f"fbl-gym {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    evaluate = commands.add_parser("evaluate", help="the metrics of one policy on one scenario")
    evaluate.add_argument("policy", metavar="POLICY", help="a name that `fbl-gym list policies` shows")
    evaluate.add_argument("--scenario", default="nominal", metavar="S", help="a name from `fbl-gym list scenarios`")
    evaluate.add_argument(
        "--seeds", type=_count, default=16, metavar="N", help="how many episodes, with seeds 0 to N-1 (16)"
    )
    evaluate.add_argument("--plot", type=Path, metavar="FILE", help="draw the first seed: .png, .svg or .pdf")
    evaluate.set_defaults(run=_evaluate)

    board = commands.add_parser(
        "leaderboard", help="all policies on all scenario families and severities, with the same seeds"
    )
    board.add_argument("--policies", nargs="+", default=(), metavar="P", help="only these")
    board.add_argument("--scenarios", nargs="+", default=(), metavar="S", help="only these scenarios, or families")
    board.add_argument(
        "--seeds", type=_count, default=32, metavar="N", help="episodes per cell, with seeds 0 to N-1 (32)"
    )
    board.add_argument("--out", type=Path, default=Path("results"), metavar="DIR", help="where to write (results)")
    board.set_defaults(run=_leaderboard)

    listing = commands.add_parser("list", help="the names of policies or scenarios, with a line each")
    listing.add_argument("what", choices=("policies", "scenarios"))
    listing.set_defaults(run=_list)

    paper = commands.add_parser("reproduce", help="the paper's figures and claims, measured, each with a verdict")
    paper.add_argument(
        "--out", type=Path, default=Path("results/paper"), metavar="DIR", help="where to write (results/paper)"
    )
    paper.set_defaults(run=_reproduce)

    speed = commands.add_parser("speed", help="steps per second beside Acrobot-v1, in one interleaved run")
    speed.add_argument("--rounds", type=_count, default=7, metavar="N", help="how often each has its turn (7)")
    speed.set_defaults(run=_speed)
    return parser


def _count(text: str) -> int:
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, 1 or more, got {text!r}")
    return int(text)


def _evaluate(arguments: argparse.Namespace) -> int:
    _need("rich", extra="bench")
    if arguments.plot is not None:
        _need("matplotlib", extra="bench")
    from rich.console import Console

    from benchmarks.metrics import measure
    from benchmarks.report import terminal
    from benchmarks.rollout import rollout

    scenario = scenarios.get(arguments.scenario)
    trace = rollout(arguments.policy, scenario, range(arguments.seeds))
    console = Console()
    title = f"{arguments.policy} on {scenario.name}, {arguments.seeds} seeds"
    terminal.evaluation(console, title, measure(trace), 1e6 * trace.decision_time)
    console.print(scenario.description)
    if arguments.plot is not None:
        from benchmarks.report.plot import plot_trace

        plot_trace(trace, f"{arguments.policy} on {scenario.name}", arguments.plot)
        console.print(f"plot: {arguments.plot}")
    return 0


def _leaderboard(arguments: argparse.Namespace) -> int:
    _need("rich", extra="bench")
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from benchmarks import results
    from benchmarks.report import terminal
    from benchmarks.runner import Result, run
    from benchmarks.suite import leaderboard

    cells = leaderboard(arguments.policies, arguments.scenarios, range(arguments.seeds))
    console = Console(width=None if sys.stdout.isatty() else 120)  # a file has no width of its own
    done: list[Result] = []
    columns = (
        TextColumn("{task.description:<40}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    stopped = False
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("starting", total=len(cells))
        try:
            written = time.monotonic()
            for result in run(cells):
                done.append(result)
                if time.monotonic() - written > SAVE_EVERY:
                    results.write(arguments.out, done, results.command_line())
                    written = time.monotonic()
                progress.update(task, advance=1, description=result.cell.id)
        except KeyboardInterrupt:
            stopped = True
    if done:
        terminal.leaderboard(console, done)
        results.write(arguments.out, done, results.command_line())
        console.print(f"results: {arguments.out / 'leaderboard.csv'} and {arguments.out / 'leaderboard.json'}")
    if stopped:
        print(f"fbl-gym: stopped after {len(done)} of {len(cells)} cells", file=sys.stderr)
        return 130
    return 1 if any(result.error for result in done) else 0


def _reproduce(arguments: argparse.Namespace) -> int:
    _need("rich", "matplotlib", extra="bench")
    from rich.console import Console
    from rich.progress import Progress

    from benchmarks import results
    from benchmarks.paper import CLAIMS, Claim, measure_claims
    from benchmarks.report import terminal
    from benchmarks.report.plot import plot_trace

    found: list[Claim] = []
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("measuring", total=len(CLAIMS))
        for name, claim, trace in measure_claims():
            found.append(claim)
            for ending in ("png", "svg"):
                plot_trace(trace, f"figure {claim.figure}: {claim.claim}", arguments.out / f"{name}.{ending}")
            progress.update(task, advance=1, description=name)
    terminal.claims(Console(), found)
    results.write_claims(arguments.out, found)
    print(f"claims and plots: {arguments.out}")
    return 0


def _speed(arguments: argparse.Namespace) -> int:
    _need("rich", extra="bench")
    from rich.console import Console

    from benchmarks.report import terminal
    from benchmarks.speed import measure_speed

    terminal.speed(Console(), measure_speed(arguments.rounds))
    return 0


def _list(arguments: argparse.Namespace) -> int:
    if arguments.what == "policies":
        for name in controllers.names():
            print(f"{name:<14} {controllers.summary(name)}  [told: {controllers.tier(name)}]")
    else:
        for name in scenarios.names():
            print(f"{name:<30} {scenarios.get(name).description}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
