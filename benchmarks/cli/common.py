"""Runs of cells with their progress, and the command line, which several commands share."""

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.progress import track

from benchmarks.policies.isolation import CallLimits
from benchmarks.report.terminal import Screen
from benchmarks.run.cell import Cell
from benchmarks.run.runner import run
from benchmarks.run.store import Result, Store
from benchmarks.text import say


def command_line() -> str:
    """Return the command that started this process, as one could type it."""
    return shlex.join(["fbl-gym", *sys.argv[1:]])


def limits_of(arguments: argparse.Namespace) -> CallLimits | None:
    """Return the limits of a cell that the arguments give; None: those of external policies."""
    return CallLimits(arguments.cell_timeout, arguments.cell_memory) if "cell_timeout" in arguments else None


def write(path: Path | None, name: str, writer: Callable[[Path], object], about: str = "") -> None:
    """Write the file of an argument and say so; None: the argument is not given."""
    if path is not None:
        writer(path)
        say(f"{name}: {path}{about}")


def run_all(cells: Sequence[Cell], arguments: argparse.Namespace) -> dict[Cell, Result]:
    """Run the cells that the store lacks with a progress bar; return the result of each cell."""
    store, limits = Store(arguments.store), limits_of(arguments)
    runs = run(cells, store, workers=arguments.workers, command=command_line(), limits=limits)
    return {result.cell: result for _, result in track(runs, "cells", len(cells), console=Screen(stderr=True))}
