"""Arguments and output that several commands share."""

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.progress import track

from benchmarks.policies.isolation import CallLimits
from benchmarks.report.terminal import Screen
from benchmarks.run.cell import Cell
from benchmarks.run.loop import LEAST_DELAY, LEAST_PHASE
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Result, Store
from benchmarks.seeds import SPLITS
from controllers.name import PolicyName
from fbl_gym import Scenario, scenarios
from fbl_gym.records.checks import check_number

# Types of arguments: functions of the text that was typed.


def count(text: str, most: int = 1_000_000, why: str = "") -> int:
    """Return a whole number, from 1 to `most`; `why` explains the latter."""
    if not text.isdecimal() or int(text[:20]) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, 1 or more, got {text!r}")
    if int(text[:20]) > most:
        raise argparse.ArgumentTypeError(f"must be at most {most}{why}, got {text!r}")
    return int(text)


episodes = partial(count, most=len(SPLITS["test"]), why=", the test seeds there are")
"""Return a number of test seeds."""


def bounded(most: float, text: str) -> float:
    """Return a number from 0 to the `most`."""
    try:
        return check_number("it", float(text), low=0.0, high=most)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number from 0 to {most:g}, got {text!r}") from None


def file_path(text: str, endings: Sequence[str]) -> Path:
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


def command_line() -> str:
    """Return the command that started this process, as one could type it."""
    return " ".join(["fbl-gym", *sys.argv[1:]])


# Arguments that several commands have.

POLICY = (
    "a name from `fbl-gym list policies`, module:factory, file.py, file.py:factory, ./folder, or model.zip; "
    "a law may end in gains: @kp=25, @kp=25,30 for the two joints, @kp=0.5x for half the tuned gain, or @gains.json"
)
CORES = os.cpu_count() or 1

ARGUMENTS: dict[str, dict[str, Any]] = {
    "policy": {"metavar": "POLICY", "help": POLICY},
    "policies": {"nargs": "+", "metavar": "POLICY", "help": "one or more, as for `fbl-gym check-policy`"},
    "--scenario": {
        "default": "nominal", "metavar": "S",
        "help": "a name from `fbl-gym list scenarios`, a .toml file, or SUITE.toml:NAME (nominal)",
    },
    "--trust": {"action": "store_true", "help": "run the code of an archive, and of policies in a file"},
    "--store": {"type": Path, "default": Path("results/board"), "metavar": "DIR", "help": "folder of results (%(default)s)"},
    "--workers": {
        "type": partial(count, most=max(64, 4 * CORES), why=", four for each core"), "default": CORES, "metavar": "N",
        "help": "processes (one per core)",
    },
    "--width": {"type": int, "choices": (1, 2), "help": "its width in columns of a journal, then without a title (2)"},
}  # fmt: skip
RUN = ("--workers", "--trust", "--store")
"""The arguments of a run of cells."""


def add(parser: argparse.ArgumentParser, *names: str, **changes: Any) -> None:
    """Add some of `ARGUMENTS`, perhaps with changes."""
    for name in names:
        parser.add_argument(name, **ARGUMENTS[name] | changes)


def add_option(
    parser: argparse.ArgumentParser, name: str, kind: Callable[[str], Any], default: Any, metavar: str, meaning: str
) -> None:
    """Add an option with a value, whose help ends in its default."""
    parser.add_argument(name, type=kind, default=default, metavar=metavar, help=f"{meaning} ({default})")


def add_file(parser: argparse.ArgumentParser, name: str, meaning: str, *endings: str) -> None:
    """Add an option that writes a file, whose help ends in the possible endings."""
    check = partial(file_path, endings=endings)
    parser.add_argument(name, type=check, metavar="FILE", help=f"{meaning}: {' or '.join(endings)}")


def add_plot(parser: argparse.ArgumentParser, subject: str) -> None:
    add_file(parser, "--plot", f"draw {subject}", ".png", ".svg", ".pdf")
    add(parser, "--width")


def add_tex(parser: argparse.ArgumentParser) -> None:
    add_file(parser, "--tex", "write the table for LaTeX (booktabs)", ".tex")


# What commands share.


def run_all(cells: Sequence[Cell], arguments: argparse.Namespace, limits: CallLimits | None = None) -> Iterator[Result]:
    """Run the cells that the store lacks, show the progress, and yield all results in any order."""
    store = Store(arguments.store)
    runs = run_cells(cells, store, workers=arguments.workers, command=command_line(), limits=limits)
    for _, result in track(runs, "cells", len(cells), console=Screen(stderr=True)):
        yield result


def results_by_id(cells: Sequence[Cell], arguments: argparse.Namespace) -> dict[str, Result]:
    """Return the results of `run_all` by the ids of their cells."""
    return {result.cell.id: result for result in run_all(cells, arguments)}


def refuse_judged(scenario: Scenario) -> None:
    """Refuse a scenario that tuning and training may not use."""
    if reason := scenarios.held_out_reason(scenario):
        raise ValueError(f"{scenario.name} is for judging alone: {reason}; change that, or use the tier practice")


def trust(arguments: argparse.Namespace) -> None:
    """Turn the texts of the policies among the arguments into names.

    With `--trust`, their code may run. A Python file or module that is typed needs no permission.
    """
    parse = partial(PolicyName.parse, trusted=arguments.trust)
    for option in ("policies", "policy"):
        if given := getattr(arguments, option, None):
            setattr(arguments, option, parse(given) if isinstance(given, str) else [*map(parse, given)])


def add_margins(parser: argparse.ArgumentParser, phase: str, delay: str) -> None:
    """Add the options for the margins that are asked for, each with its meaning."""
    add_option(parser, "--least-phase", partial(bounded, 180.0), LEAST_PHASE, "DEG", phase)
    add_option(parser, "--least-delay", partial(bounded, 1e3), LEAST_DELAY, "SAMPLES", delay)
