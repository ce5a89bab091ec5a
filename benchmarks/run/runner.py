"""Runs the cells that a store lacks, in processes of this machine or of a cluster.

A finished cell is in the store, which this process alone writes.
"""

import os
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from benchmarks.policies.isolation import CallLimits, Failed, run_parallel
from benchmarks.run.cell import run_cell
from benchmarks.run.store import Result, Store
from benchmarks.run.suite import Cell


def run(
    cells: Sequence[Cell], store: Store, *, workers: int = 1, command: str = "", limits: CallLimits | None = None,
    cluster: str = "",
) -> Iterator[tuple[str, Result]]:  # fmt: skip
    """Run the cells that the store lacks, in any order, and yield each result with its origin.

    The origin is "computed", "found" (it was in the store), or "failed".

    Args:
        cells: all cells that the store shall have.
        store: for the results.
        workers: number of processes.
        command: the command that was typed, for the record.
        limits: of the time and memory of a cell; None: those of external policies.
        cluster: address of a Dask scheduler, whose workers run the cells; empty: this machine.
    """
    absent = []
    for cell in cells:
        if (stored := store.find(cell)) is None:
            absent.append(cell)
        else:
            yield "found", stored
    work = partial(_run_in, os.getcwd(), command, limits)
    for cell, answer in run_parallel(work, absent, min(workers, len(absent)), cluster):
        result = Result.failure(cell, str(answer), command) if isinstance(answer, Failed) else answer
        store.save(result)
        yield "failed" if result.error else "computed", result


def _run_in(folder: str, command: str, limits: CallLimits | None, cell: Cell) -> Result:
    """Run a cell in a folder, since its policy may be named by a relative path."""
    if Path(folder).is_dir():
        os.chdir(folder)
    return run_cell(cell, command, limits)
