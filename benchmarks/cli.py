"""The command line, `fbl-gym`."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gymnasium

from fbl_gym import __version__
from fbl_gym.records import unknown


@dataclass(frozen=True)
class Command:
    """A command: its file in `commands`, and a line on what it does."""

    module: str
    help: str


COMMANDS: dict[str, Command] = {
    "evaluate": Command("evaluate", "the metrics of one policy on one scenario, and a plot"),
    "compare": Command("compare", "several policies on one scenario and the same seeds: table, plot, video"),
    "leaderboard": Command("leaderboard", "run a suite: all policies on all scenario families, with the same seeds"),
    "report": Command("report", "the board as Markdown, CSV and one HTML page, from stored results"),
    "query": Command("query", "ask stored results in SQL, or write them as CSV or Parquet"),
    "verify": Command("verify", "run a published row again and say whether it holds"),
    "check-policy": Command("check_policy", "whether a policy keeps what policies promise"),
    "tune": Command("tune", "tune a policy's gains on the tuning seeds"),
    "train": Command("train", "train an agent of stable-baselines3 on the uncertain arm"),
    "reproduce": Command("reproduce", "the paper's figures and claims, measured, each with a verdict"),
    "speed": Command("speed", "steps per second beside other environments, in one interleaved run"),
    "list": Command("names", "the names of policies, scenarios or suites, with a line each"),
    "completion": Command("completion", "a script that lets a shell complete commands, options and names"),
    "doctor": Command("doctor", "versions, extras, compile cache and a self-check"),
}


EXTRAS: dict[str, tuple[str, ...]] = {
    "bench": ("duckdb", "joblib", "matplotlib", "optuna", "pandas", "plotly", "rich", "shtab", "threadpoolctl"),
    "rl": ("sb3_contrib", "stable_baselines3", "torch"),
    "render": ("imageio_ffmpeg", "pygame"),
    "mpc": ("casadi",),
    "cluster": ("dask", "distributed", "ray"),
}
"""What each extra brings, by the names that are imported."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    given = list(sys.argv[1:] if argv is None else argv)
    try:
        if not given or given[0].startswith("-"):
            _overview().parse_args(given or ["--help"])
            return 0
        parser, run = prepare(given[0])
        return run(parser.parse_args(given[1:]))
    except BrokenPipeError:  # whoever read our output, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, OSError, gymnasium.error.Error) as problem:
        print(f"fbl-gym: {problem}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as problem:
        package = (problem.name or "").partition(".")[0]
        extra = next((extra for extra, packages in EXTRAS.items() if package in packages), None)
        if extra is None:
            raise
        print(f"fbl-gym: this needs {package}, which is not installed: pip install 'fbl-gym[{extra}]'", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("fbl-gym: stopped", file=sys.stderr)
        return 130


def _overview() -> argparse.ArgumentParser:
    wide = max(map(len, COMMANDS)) + 2
    parser = argparse.ArgumentParser(
        prog="fbl-gym",
        usage="fbl-gym COMMAND [--help] ...",
        description="Robust, adaptive and learned control on one uncertain two-link arm.",
        epilog="commands:\n" + "".join(f"  {name:<{wide}}{command.help}\n" for name, command in COMMANDS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"fbl-gym {__version__}")
    return parser


def prepare(name: str) -> tuple[argparse.ArgumentParser, Callable[[argparse.Namespace], int]]:
    """The parser of a command's arguments, and what runs it.  name: one of `COMMANDS`."""
    if name not in COMMANDS:
        raise unknown("command", name, COMMANDS)
    command = COMMANDS[name]
    module = importlib.import_module(f"benchmarks.commands.{command.module}")
    parser = argparse.ArgumentParser(
        prog=f"fbl-gym {name}", description=command.help[0].upper() + command.help[1:] + "."
    )
    module.add_arguments(parser)
    return parser, module.run


if __name__ == "__main__":
    sys.exit(main())
