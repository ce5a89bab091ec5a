"""The command line, `fbl-gym`."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

import gymnasium

from fbl_gym import __version__
from fbl_gym.checks import nearest, unknown


@dataclass(frozen=True)
class Command:
    """A command: its file in `commands`, a line on what it does, and an example of its arguments."""

    module: str
    help: str
    example: str = ""


COMMANDS: dict[str, Command] = {
    "evaluate": Command(
        "evaluate",
        "the metrics of one policy on one scenario, and a plot",
        "cascade-flm --scenario everything-2 --plot trace.png",
    ),
    "compare": Command(
        "compare",
        "several policies on one scenario and the same seeds: table, plot, video",
        "pid-flm cascade-flm --scenario payload-2 --plot errors.png",
    ),
    "leaderboard": Command(
        "leaderboard",
        "run a suite: all policies on all scenario families, with the same seeds",
        "--policies pid-flm cascade-flm zero oracle-flm --seeds 4",
    ),
    "report": Command("report", "the board as Markdown, CSV and one HTML page, from stored results", "--out board"),
    "query": Command(
        "query",
        "ask stored results in SQL, or write them as CSV or Parquet",
        '"SELECT policy, avg(error_pct) FROM results GROUP BY policy ORDER BY 2"',
    ),
    "transfer": Command(
        "transfer",
        "run policies on the package's arm and on MuJoCo's, and compare their orders",
        "pd-gravity computed-torque lqg@tuned --scenario everything-2 --world mujoco-bend --seeds 4",
    ),
    "verify": Command("verify", "run a published row again and say whether it holds", "cascade-flm/mass-error-2"),
    "check-policy": Command("check_policy", "whether a policy keeps what policies promise", "my_law.py"),
    "tune": Command("tune", "tune a policy's gains on the tuning seeds", "computed-torque --trials 20"),
    "train": Command("train", "train an agent of stable-baselines3 on the uncertain arm", "ppo --minutes 2"),
    "reproduce": Command(
        "reproduce", "the paper's figures and claims, measured, each with a verdict", "--only figure-2-table-1 --short"
    ),
    "speed": Command("speed", "steps per second beside other environments, in one interleaved run"),
    "list": Command(
        "names", "the names of policies, scenarios, suites or the paper's claims, with a line each", "scenarios"
    ),
    "completion": Command(
        "completion",
        "a script that lets a shell complete commands, options and names",
        "bash > ~/.local/share/bash-completion/completions/fbl-gym",
    ),
    "doctor": Command("doctor", "versions, extras, compile cache and a self-check"),
}


EXTRAS: dict[str, tuple[str, ...]] = {
    "bench": ("duckdb", "joblib", "matplotlib", "optuna", "pandas", "plotly", "rich", "shtab", "threadpoolctl"),
    "rl": ("sb3_contrib", "stable_baselines3", "torch"),
    "render": ("imageio_ffmpeg", "pygame"),
    "mpc": ("casadi",),
    "mujoco": ("mujoco",),
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
    except OSError as problem:
        reason = f"{problem.strerror}: {problem.filename}" if problem.filename else problem
        print(f"fbl-gym: {reason}", file=sys.stderr)
        return 2
    except (ValueError, gymnasium.error.Error) as problem:
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


class Parser(argparse.ArgumentParser):
    """A parser whose errors name the option or the choice that is nearest to what was typed."""

    def error(self, message: str) -> NoReturn:
        """Leave with a message.  message: argparse's own, which quotes what was typed."""
        option = re.search(r"unrecognized arguments: (-\S+)", message)
        choice = re.search(r"argument (\S+): invalid choice: '([^']*)'", message)
        if option:
            message += nearest(option[1].partition("=")[0], self._option_string_actions)
        elif choice:
            action = next(a for a in self._actions if choice[1] in ("/".join(a.option_strings), a.metavar, a.dest))
            message += nearest(choice[2], action.choices or ())
        super().error(message)


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
    module = importlib.import_module(f"benchmarks.cli.{command.module}")
    parser = Parser(
        prog=f"fbl-gym {name}",
        description=command.help[0].upper() + command.help[1:] + ".",
        epilog=f"example: fbl-gym {name} {command.example}" if command.example else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    return parser, module.run


if __name__ == "__main__":
    sys.exit(main())
