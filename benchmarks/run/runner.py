"""Runs the cells that a store lacks, in processes of this machine.

A finished cell is in the store, so nothing is lost with a process. Machines that share a store
divide the cells: each takes them in its own order and skips those that are stored.
"""

import os
import platform
import random
from collections.abc import Iterator, Sequence
from functools import partial

from benchmarks.policies.apart import at_once
from benchmarks.run.cell import Outcome, compute
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell


def missing(cells: Sequence[Cell], store: Store) -> list[Cell]:
    """Return the cells that a store lacks."""
    return [cell for cell in cells if store.find(cell) is None]


def run(cells: Sequence[Cell], store: Store, *, workers: int = 1, command: str = "") -> Iterator[Outcome]:
    """Run the cells that the store lacks, in any order, and yield the outcome of each.

    Args:
        cells: all cells that the store shall have.
        store: for the results.
        workers: number of processes.
        command: the command that was typed, for the record.
    """
    left = missing(cells, store)
    keys = {cell.key for cell in left}
    for cell in cells:
        if cell.key not in keys:
            yield Outcome(cell.id, "found")
    # Two runs that share a store rarely want the same cell at the same time.
    random.Random(f"{platform.node()} {os.getpid()}").shuffle(left)
    workers = min(workers, len(left))
    yield from at_once([partial(compute, cell, store, command, workers) for cell in left], workers)
