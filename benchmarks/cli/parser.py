"""The command line, `fbl-gym`."""

import argparse
import contextlib
import importlib
import io
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn

from benchmarks.text import say, visible
from fbl_gym import __version__


class Command(NamedTuple):
    """A command: one line of help, example arguments, and what a stopped run keeps."""

    help: str
    example: str
    kept: str = ""


COMMANDS = {
    "evaluate": Command("evaluate policies on one scenario: metrics or a comparison, plot, trials",
        "pid-flm cascade-flm --scenario payload-2 --plot errors.png"),
    "play": Command("move the target, push and load running arms in a window, with mouse and keys",
        "pid-flm cascade-flm --scenario payload-2 --seconds 10 --record play.gif"),
    "leaderboard": Command("run a suite: all policies on all scenario families, with the same seeds",
        "--policies pid-flm cascade-flm zero oracle-flm --seeds 4", "finished cells are kept"),
    "report": Command("write the board as Markdown, CSV and one HTML page, from stored results",
        "--policies pid-flm cascade-flm zero oracle-flm --seeds 4 --out board"),
    "sweep": Command("measure policies over the values of options: CSV and figure",
        "pid-flm lqg --over noise.position=1e-4:1e-2:log:5 --scenario nominal --seeds 8", "finished cells are kept"),
    "identify": Command("turn the logs of a robot into a scenario, check it against logs, plan a motion to log",
        "run-1.csv run-2.csv --start my_arm.toml --toml identified.toml"),
    "recommend": Command("name the policies to use on an arm: a scenario and conditions around it",
        "servo-nominal --policies pd-gravity computed-torque --seeds 4"),
    "margins": Command("gain, phase and delay margins of policies, by linearisation", "pid-flm@tuned lqg"),
    "verify": Command("run a stored result again and compare it bit for bit", "cascade-flm/servo-model-error-2"),
    "check-policy": Command("check that a policy keeps every promise of a policy", "my_law.py"),
    "tune": Command("tune a policy's gains on the tuning seeds", "computed-torque --trials 20", "finished trials are kept"),
    "train": Command("train an agent on the uncertain arm", "ppo --minutes 2",
        "the last checkpoint and the best agent are kept"),
    "curves": Command("compare training runs, grouped over their seeds: table and learning curves",
        "runs/ppo-torque-0 runs/ppo-torque-1 --plot curves.png"),
    "reproduce": Command("measure the paper's figures and claims, each with a verdict",
        "--only figure-3a --short", "finished claims are kept"),
    "show": Command("show a scenario: every number with its unit, and what follows from them", "geared-nominal servo-nominal"),
    "list": Command("list policies, scenarios, options, gains, suites or claims, with one line each", "scenarios"),
    "doctor": Command("show versions, extras, compile cache and folders of the packages, and run a self-check", "--compile"),
}  # fmt: skip
"""The commands; the file of each has its name, with underscores."""


EXTRAS: dict[str, tuple[str, ...]] = {
    "bench": ("filterpy", "matplotlib", "pandas", "rich", "threadpoolctl"), "analysis": ("jinja2", "optuna", "plotly"),
    "rl": ("sb3_contrib", "stable_baselines3", "torch"), "render": ("imageio_ffmpeg", "pygame"),
    "mpc": ("casadi",), "mujoco": ("mujoco",), "cuda": ("numba_cuda",),
}  # fmt: skip
"""The modules that each extra installs."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status."""
    given = list(sys.argv[1:] if argv is None else argv)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed before this process began
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "w"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a name may have any character
    plain, warnings.formatwarning = warnings.formatwarning, _warning  # type: ignore[assignment]
    try:
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
            raise ValueError("NUMBA_DISABLE_JIT must be unset: fbl-gym's compiled functions have no other form")
        if not given or given[0].startswith("-"):
            _overview().parse_args(given or ["--help"])
            return 0
        parser, run = prepare(given[0])
        arguments = parser.parse_args(given[1:])
        return run(arguments)
    except BrokenPipeError:  # the reader of the output, such as `head`, has stopped
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as problem:
        say(f"fbl-gym: {_reason(problem)}", sys.stderr)
        return 2
    except KeyboardInterrupt:
        kept = COMMANDS[given[0]].kept if given and given[0] in COMMANDS else ""
        with contextlib.suppress(OSError):  # the terminal may be closed
            print("fbl-gym: stopped" + (f"; {kept}, and the same command goes on" if kept else ""), file=sys.stderr)
        return 128 + signal.SIGINT
    finally:
        warnings.formatwarning = plain


def _warning(message: Warning | str, category: type[Warning], *place: Any) -> str:
    """Return a warning as text; without the place in the code, if it is one of fbl-gym's own."""
    own = category.__module__.startswith("fbl_gym.")
    where = "fbl-gym" if own else f"{place[0]}:{place[1]}: {category.__name__}"
    return f"{where}: {message}\n"


def _reason(problem: Exception) -> str:
    """Return the text of an error where that is enough; raise any other error.

    Others are errors of external code or of fbl-gym itself, and of a missing package that no extra
    installs.
    """
    import gymnasium  # slow to import, and an error has time

    from benchmarks.policies.isolation import Failed

    if isinstance(problem, MemoryError):
        return f"not enough memory: {problem}"
    if isinstance(problem, OSError) and problem.filename:
        return f"{problem.strerror}: {problem.filename2 or problem.filename}"
    if isinstance(problem, ModuleNotFoundError):
        package = (problem.name or "").partition(".")[0]
        extra = next((extra for extra, packages in EXTRAS.items() if package in packages), None)
        if extra is not None:
            return f"this needs {package}, which is not installed: pip install 'fbl-gym[{extra}]'"
    elif isinstance(problem, ValueError | Failed | gymnasium.error.Error | OSError | SyntaxError):
        return str(problem)
    raise problem


class Parser(argparse.ArgumentParser):
    """A parser whose errors name the nearest option."""

    def error(self, message: str) -> NoReturn:
        """Exit with a message of argparse, which quotes the wrong text."""
        from fbl_gym.records.checks import nearest  # imports NumPy, which the list of commands does without

        option = re.search(r"unrecognized arguments: (-\S+)", message)
        if option:
            message += nearest(option[1].partition("=")[0], self._option_string_actions)
        super().error(visible(message))


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
    """Return the parser of a command's arguments and the function that runs the command."""
    if name not in COMMANDS:
        from fbl_gym.records.checks import unknown

        raise unknown("command", name, COMMANDS)
    command = COMMANDS[name]
    module = importlib.import_module(f"benchmarks.cli.{name.replace('-', '_')}")
    parser = Parser(
        prog=f"fbl-gym {name}",
        description=command.help[0].upper() + command.help[1:] + ".",
        epilog=f"example: fbl-gym {name} {command.example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    return parser, module.run
