"""The command line, `fbl-gym`: its commands and their arguments, which `commands.toml` declares."""

import argparse
import contextlib
import io
import os
import re
import signal
import sys
import tomllib
import warnings
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NoReturn

from benchmarks.seeds import SPLITS
from benchmarks.text import say, visible
from fbl_gym import __version__

COMMANDS: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("commands.toml").read_text("utf-8"))
#: The commands, the arguments that several have, and the modules that each extra installs.
SHARED, EXTRAS = COMMANDS.pop("shared"), COMMANDS.pop("extras")

CORES = os.cpu_count() or 1


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

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.IGNORECASE)  # -1e-3, too

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
    parser = Parser(
        prog=f"fbl-gym {name}",
        description=command["help"][0].upper() + command["help"][1:] + ".",
        epilog=f"example: fbl-gym {name} {command['example']}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,  # `--seed` is no `--seeds`
    )
    add_arguments(parser, command["arguments"])
    return parser, resolve_name(f"benchmarks.cli.{name.replace('-', '_')}:run")


def count(text: str, most: int = 1_000_000, why: str = "") -> int:
    """Return a whole number, from 1 to `most`; `why` explains the latter."""
    if not text.isdecimal() or int(text[:20]) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, 1 or more, got {text!r}")
    if int(text[:20]) > most:
        raise argparse.ArgumentTypeError(f"must be at most {most}{why}, got {text!r}")
    return int(text)


def bounded(most: float, text: str) -> float:
    """Return a number from 0 to the `most`."""
    with contextlib.suppress(ValueError):
        if 0.0 <= (number := float(text)) <= most:
            return number
    raise argparse.ArgumentTypeError(f"must be a number from 0 to {most:g}, got {text!r}")


def file_path(endings: Sequence[str], text: str) -> Path:
    """Return the path of a file that can be written."""
    path = Path(text)
    if path.suffix not in endings:
        raise argparse.ArgumentTypeError(f"must end in {' or '.join(endings)}, got {text!r}")
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"must be a file, got {text!r}, which is a folder")
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        raise argparse.ArgumentTypeError(f"must be a file that can be written, got {text!r}: none can be in {folder}")
    return path


TYPES: dict[str, Callable[[str], Any]] = {
    "int": int, "float": float, "Path": Path, "count": count,
    "episodes": partial(count, most=len(SPLITS["test"]), why=", the test seeds there are"),
    "processes": partial(count, most=max(64, 4 * CORES), why=", or four for each core"),
    "degrees": partial(bounded, 180.0), "samples": partial(bounded, 1e3),
}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser, entries: Mapping[str, Mapping[str, Any]]) -> None:
    """Add the arguments of a command, by name, to its parser."""
    groups: dict[str, Any] = defaultdict(parser.add_mutually_exclusive_group)
    for name, changes in entries.items():
        fields = {field: _value(field, value) for field, value in (SHARED.get(name, {}) | changes).items()}
        target = groups[fields.pop("group")] if "group" in fields else parser
        if endings := fields.pop("endings", None):
            fields |= {"type": partial(file_path, endings), "metavar": "FILE"}
            fields["help"] += f": {' or '.join(endings)}"
        target.add_argument(name, **fields)


def _value(field: str, value: Any) -> Any:
    """Return what the value of a field stands for."""
    if field == "metavar" and isinstance(value, list):
        return tuple(value)
    if field == "type" and value in TYPES:
        return TYPES[value]
    return resolve_name(value) if isinstance(value, str) and re.fullmatch(r"[\w.]+:[\w.]+", value) else value


def trust(arguments: argparse.Namespace) -> None:
    """Turn the texts of the policies among the arguments into names.

    With `--trust`, their code may run. A Python file or module that is typed needs no permission.
    A file of `VecNormalize` that lies beside an archive is named, since it changes what the agent
    sees.
    """
    from benchmarks.agents.sb3 import statistics
    from controllers.name import PolicyName  # imports NumPy, which the list of commands does without

    parse = partial(PolicyName.parse, trusted=arguments.trust)
    for option in ("policies", "policy"):
        if given := getattr(arguments, option, None):
            names = [parse(text) for text in ([given] if isinstance(given, str) else given)]
            setattr(arguments, option, names[0] if isinstance(given, str) else names)
            for archive in (Path(name.source) for name in names if name.form == "archive"):
                for file in statistics(archive):
                    say(f"fbl-gym: {file} scales the observations of {archive}", sys.stderr)
