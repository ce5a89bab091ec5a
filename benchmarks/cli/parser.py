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
from typing import Any, NoReturn

from benchmarks.cli.arguments import COMMANDS, EXTRAS, add_arguments, trust
from benchmarks.text import say, visible
from fbl_gym import __version__


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
        if "trust" in arguments:
            trust(arguments)
        return run(arguments)
    except BrokenPipeError:  # the reader of the output, such as `head`, has stopped
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as problem:
        say(f"fbl-gym: {_reason(problem)}", sys.stderr)
        return 2
    except KeyboardInterrupt:
        kept = COMMANDS.get(given[0] if given else "", {}).get("kept")
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

        if option := re.search(r"unrecognized arguments: (-\S+)", message):
            message += nearest(option[1].partition("=")[0], self._option_string_actions)
        super().error(visible(message))


def _overview() -> argparse.ArgumentParser:
    wide = max(map(len, COMMANDS)) + 2
    parser = argparse.ArgumentParser(
        prog="fbl-gym",
        usage="fbl-gym COMMAND [--help] ...",
        description="Robust, adaptive and learned control on one uncertain two-link arm.",
        epilog="commands:\n" + "".join(f"  {name:<{wide}}{command['help']}\n" for name, command in COMMANDS.items()),
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
        description=command["help"][0].upper() + command["help"][1:] + ".",
        epilog=f"example: fbl-gym {name} {command['example']}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_arguments(parser, command["arguments"])
    return parser, module.run
