"""Runs the cells that a store lacks, in processes of this machine.

A finished cell is in the store, so nothing is lost with a process. Machines that share a store
divide the cells: each takes them in its own order and skips those that are stored.
"""

import os
import platform
import random
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from typing import Any

from benchmarks.policies.apart import at_once
from benchmarks.run.cell import Outcome, compute, run_apart
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from benchmarks.run.traces import load_trace, trace_path


def missing(cells: Sequence[Cell], store: Store) -> list[Cell]:
    """Return the cells that a store lacks."""
    return [cell for cell in cells if store.find(cell) is None]


def run(
    cells: Sequence[Cell], store: Store, *, workers: int = 1, command: str = "", traced: Collection[str] = ()
) -> Iterator[Outcome]:
    """Run the cells that the store lacks, in any order, and yield the outcome of each.

    Args:
        cells: all cells that the store shall have.
        store: for the results.
        workers: number of processes.
        command: the command that was typed, for the record.
        traced: names of the scenarios of which a trace of the first seed is stored, too.
    """
    left = missing(cells, store)
    keys = {cell.key for cell in left}
    for cell in cells:
        if cell.key not in keys:
            yield Outcome(cell.id, "found")
    # Two runs that share a store rarely want the same cell at the same time.
    random.Random(f"{platform.node()} {os.getpid()}").shuffle(left)
    workers = min(workers, len(left))
    jobs = [partial(compute, cell, store, command, workers, cell.scenario.name in traced) for cell in left]
    yield from at_once(jobs, workers)


def traces(cells: Sequence[Cell], store: Store, workers: int = 1) -> dict[str, dict[str, Any]]:
    """Return the trace of each cell's first seed, from `load_trace`, by the cell's id.

    Cells whose trace the store lacks are run.

    Raises:
        ValueError: a policy fails.
    """
    absent = list({cell.id: cell for cell in cells if not trace_path(cell, store).exists()}.values())
    for result in at_once([partial(run_apart, cell, "", store) for cell in absent], min(workers, len(absent))):
        if result.error:
            raise ValueError(f"{result.cell.id} has a result but no trace, since it fails now: {result.error}")
    return {cell.id: load_trace(cell, store) for cell in cells}
