"""Runs the cells that a store lacks, in processes of this machine or of a cluster.

A finished cell is in the store, which this process alone writes.
"""

import functools
import os
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.policies.isolation import CallLimits, Failed, run_parallel
from benchmarks.policies.key import PACKAGES, data_digest, digests
from benchmarks.run.cell import run_cell
from benchmarks.run.store import Result, Store
from benchmarks.run.suite import Cell
from fbl_gym.neighbours import ROOT


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
    work = functools.partial(_run_in, os.getcwd(), command, limits, code_of_process() if cluster else "")
    for cell, answer in run_parallel(work, absent, min(workers, len(absent)), cluster):
        result = Result.failure(cell, str(answer), command) if isinstance(answer, Failed) else answer
        store.save(result)
        yield "failed" if result.error else "computed", result


def _run_in(folder: str, command: str, limits: CallLimits | None, code: str, cell: Cell) -> Result:
    """Run a cell in a folder, since its policy may be named by a relative path.

    A code that is given must be that of this process.
    """
    if code and code != code_of_process():
        return Result.failure(cell, f"the worker on {platform.node()} has other code: start it again", command)
    if Path(folder).is_dir():
        os.chdir(folder)
    return run_cell(cell, command, limits)


@functools.cache
def code_of_process() -> str:
    """Return a hash of the packages' code as it was when this process first asked for it."""
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    return data_digest(digests({file.relative_to(ROOT).as_posix(): file for file in files}))
