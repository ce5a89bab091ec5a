"""Runs the cells that a store lacks, in processes of this machine.

The worker that computed a cell writes it into the store, so nothing is lost with a worker or with
the run itself. A run goes on until no cell is missing or no further cell gets done. Machines that
share a store divide the cells: each takes them in its own order and skips those that are stored.
"""

import os
import platform
import random
from collections.abc import Iterator, Sequence

from benchmarks.policies.apart import ATTEMPTS, Limits, limits, parent_decides
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
    store = Store(store.folder.resolve())
    left = missing(cells, store)
    keys = {cell.key for cell in left}
    for cell in cells:
        if cell.key not in keys:
            yield Outcome(cell.id, "found")
    # Two runs that share a store rarely want the same cell at the same time.
    random.Random(f"{platform.node()} {os.getpid()}").shuffle(left)
    while left:
        failed: set[str] = set()
        try:
            for outcome in _pool(left, store, workers, command):
                if outcome.done == "failed":
                    failed.add(outcome.id)
                yield outcome
        except _deaths():
            pass
        after = [cell for cell in missing(left, store) if cell.id not in failed]
        if len(after) == len(left):
            # A worker died before any cell was done: try the cells one by one, and go on without
            # the one to blame.
            outcomes: list[Outcome] = []
            while after and not any(outcome.error for outcome in outcomes):
                outcomes = list(_alone(after.pop(0), store, command))
                yield from outcomes
        left = after


def _alone(cell: Cell, store: Store, command: str) -> Iterator[Outcome]:
    """Run a cell in a pool without other cells, so that it is to blame if the worker dies."""
    for attempt in range(ATTEMPTS):
        try:
            yield from _pool([cell], store, 2, command)
            return
        except _deaths() as death:
            if attempt == ATTEMPTS - 1:
                yield Outcome(cell.id, "failed", error=f"its worker died {ATTEMPTS} times ({type(death).__name__})")


def _pool(cells: Sequence[Cell], store: Store, workers: int, command: str) -> Iterator[Outcome]:
    """Run cells in one pool of workers. It ends early, with an exception, if a worker dies."""
    from joblib import Parallel, delayed, parallel_config

    jobs = [delayed(_compute_in)(os.getcwd(), cell, store, command, limits()) for cell in cells]
    with parallel_config(backend="loky", n_jobs=workers, inner_max_num_threads=1):
        with parent_decides():
            outcomes = Parallel(return_as="generator_unordered")(jobs)
        yield from outcomes


def _compute_in(folder: str, cell: Cell, store: Store, command: str, limited: Limits) -> Outcome:
    """Compute a cell in a folder: a worker outlives a run, and a policy's path may be relative."""
    os.chdir(folder)
    return compute(cell, store, command, limited)


def _deaths() -> tuple[type[BaseException], ...]:
    """Return the exceptions of a pool when a worker dies."""
    from joblib.externals.loky.process_executor import BrokenProcessPool, TerminatedWorkerError

    return BrokenProcessPool, TerminatedWorkerError
