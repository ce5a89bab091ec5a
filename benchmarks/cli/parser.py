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
    """A command: the name of its module, one line on it, and an example of its arguments."""

    module: str
    help: str
    example: str = ""


COMMANDS: dict[str, Command] = {
    "evaluate": Command(
        "evaluate",
        "evaluate one policy on one scenario: metrics, plot, video",
        "cascade-flm --scenario everything-2 --plot trace.png",
    ),
    "compare": Command(
        "compare",
        "compare policies on one scenario and the same seeds: table, plot, video",
        "pid-flm cascade-flm --scenario payload-2 --plot errors.png",
    ),
    "leaderboard": Command(
        "leaderboard",
        "run a suite: all policies on all scenario families, with the same seeds",
        "--policies pid-flm cascade-flm zero oracle-flm --seeds 4",
    ),
    "report": Command(
        "report", "write the board as Markdown, CSV and one HTML page, from stored results", "--out board"
    ),
    "query": Command(
        "query",
        "query stored results in SQL, or write them as CSV or Parquet",
        '"SELECT policy, avg(error_pct) FROM results GROUP BY policy ORDER BY 2"',
    ),
    "transfer": Command(
        "transfer",
        "run policies on the package's arm and on MuJoCo's, and compare their orders",
        "pd-gravity computed-torque lqg@tuned --scenario everything-2 --world mujoco-bend --seeds 4",
    ),
    "margins": Command("margins", "gain, phase and delay margins of policies, by linearisation", "pid-flm@tuned lqg"),
    "verify": Command("verify", "run a stored result again and compare it bit for bit", "cascade-flm/mass-error-2"),
    "check-policy": Command("check_policy", "check that a policy keeps every promise of a policy", "my_law.py"),
    "tune": Command("tune", "tune a policy's gains on the tuning seeds", "computed-torque --trials 20"),
    "train": Command("train", "train an agent of stable-baselines3 on the uncertain arm", "ppo --minutes 2"),
    "reproduce": Command(
        "reproduce", "measure the paper's figures and claims, each with a verdict", "--only figure-2-table-1 --short"
    ),
    "speed": Command("speed", "measure steps per second beside other environments, in one interleaved run"),
    "list": Command(
        "names", "list policies, scenarios, options, gains, suites or claims, with one line each", "scenarios"
    ),
    "completion": Command(
        "completion",
        "print a script that completes commands, options and names in a shell",
        "bash > ~/.local/share/bash-completion/completions/fbl-gym",
    ),
    "warm-up": Command("warm_up", "compile everything now, so that no first step has to wait"),
    "doctor": Command(
        "doctor", "show versions, extras, compile cache and places of the packages, and run a self-check"
    ),
}


EXTRAS: dict[str, tuple[str, ...]] = {
    "bench": (
        "control",
        "duckdb",
        "joblib",
        "matplotlib",
        "optuna",
        "pandas",
        "plotly",
        "rich",
        "shtab",
        "threadpoolctl",
    ),
    "rl": ("sb3_contrib", "stable_baselines3", "torch"),
    "render": ("imageio_ffmpeg", "pygame"),
    "mpc": ("casadi",),
    "mujoco": ("mujoco",),
    "cluster": ("dask", "distributed", "ray"),
}
"""The modules that each extra installs."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status."""
    given = list(sys.argv[1:] if argv is None else argv)
    try:
        if not given or given[0].startswith("-"):
            _overview().parse_args(given or ["--help"])
            return 0
        parser, run = prepare(given[0])
        return run(parser.parse_args(given[1:]))
    except BrokenPipeError:  # the reader of the output, such as `head`, has stopped
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
    """A parser whose errors name the nearest option or choice."""

    def error(self, message: str) -> NoReturn:
        """Exit with a message.

        Args:
            message: of argparse; it quotes what was typed.
        """
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
    """Return the parser of a command's arguments and the function that runs the command.

    Args:
        name: one of `COMMANDS`.
    """
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
