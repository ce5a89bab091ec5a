"""Runs the cells that a store lacks, in processes of this machine or of a cluster.

A finished cell is in the store, which this process alone writes. Nothing is lost with a worker.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.policies.isolation import CallLimits, Failed, run_parallel
from benchmarks.run.cell import run_cell
from benchmarks.run.store import Result, Store
from benchmarks.run.suite import Cell


@dataclass(frozen=True)
class Outcome:
    """The end of a cell in a run.

    Args:
        id: of the cell.
        done: "computed", "found" (it was in the store), or "failed".
        error: why it failed.
    """

    id: str
    done: str
    error: str = ""


def run(
    cells: Sequence[Cell],
    store: Store,
    *,
    workers: int = 1,
    command: str = "",
    limits: CallLimits | None = None,
    cluster: str = "",
) -> Iterator[Outcome]:
    """Run the cells that the store lacks, in any order, and yield the outcome of each.

    Args:
        cells: all cells that the store shall have.
        store: for the results.
        workers: number of processes.
        command: the command that was typed, for the record.
        limits: of the time and memory of a cell; None: those of external policies.
        cluster: address of a Dask scheduler, whose workers run the cells; empty: this machine.
    """
    store.clean()
    absent = []
    for cell in cells:
        if store.find(cell) is None:
            absent.append(cell)
        else:
            yield Outcome(cell.id, "found")
    work = partial(_run_in, os.getcwd(), command, limits)
    for cell, answer in run_parallel(work, absent, min(workers, len(absent)), cluster):
        result = Result.failure(cell, str(answer), command=command) if isinstance(answer, Failed) else answer
        store.save(result)
        yield Outcome(cell.id, "failed" if result.error else "computed", result.error)


def _run_in(folder: str, command: str, limits: CallLimits | None, cell: Cell) -> Result:
    """Run a cell in a folder, since its policy may be named by a relative path."""
    if Path(folder).is_dir():
        os.chdir(folder)
    return run_cell(cell, command, limits)
