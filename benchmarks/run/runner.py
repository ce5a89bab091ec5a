"""Runs the cells that a store lacks, through joblib: on this machine, or on a Ray or Dask cluster.

The worker that computed a cell writes it into the store, so nothing is lost with a worker or with
the run itself. A run goes on until no cell is missing or no further cell gets done.
"""

from __future__ import annotations

import os
import random
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any

from benchmarks.policies.apart import ATTEMPTS, limits, parent_decides
from benchmarks.run.cell import Outcome, compute
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from fbl_gym.checks import check_choice

BACKENDS = ("loky", "ray", "dask")

_ROUND = 32
"""Cells that Ray gets at a time."""


def missing(cells: Sequence[Cell], store: Store) -> list[Cell]:
    """Return the cells that a store lacks."""
    return [cell for cell in cells if store.find(cell) is None]


def run(
    cells: Sequence[Cell],
    store: Store,
    *,
    workers: int = 1,
    backend: str = "loky",
    address: str | None = None,
    command: str = "",
) -> Iterator[Outcome]:
    """Run the cells that the store lacks, in any order, and yield the outcome of each.

    Args:
        cells: all cells that the store shall have.
        store: for the results; on a cluster, a folder that all its machines see.
        workers: number of processes.
        backend: "loky" for processes on this machine, "ray" or "dask" for a cluster.
        address: of the cluster's scheduler; None: a new cluster on this machine.
        command: the command that was typed, for the record.
    """
    check_choice("backend", backend, BACKENDS)
    store = Store(store.folder.resolve())
    left = missing(cells, store)
    keys = {cell.key for cell in left}
    for cell in cells:
        if cell.key not in keys:
            yield Outcome(cell.id, "found")
    # Two runs that share a store rarely want the same cell at the same time.
    random.Random(os.getpid()).shuffle(left)
    while left:
        failed: set[str] = set()
        try:
            for outcome in _pool(left, store, workers, backend, address, command):
                if outcome.done == "failed":
                    failed.add(outcome.id)
                yield outcome
        except _deaths(backend):
            pass
        after = [cell for cell in missing(left, store) if cell.id not in failed]
        if len(after) == len(left):
            # A worker died before any cell was done: try the cells one by one, and go on without
            # the one to blame.
            outcomes: list[Outcome] = []
            while after and not any(outcome.error for outcome in outcomes):
                outcomes = list(_alone(after.pop(0), store, backend, address, command))
                yield from outcomes
        left = after


def _alone(cell: Cell, store: Store, backend: str, address: str | None, command: str) -> Iterator[Outcome]:
    """Run a cell in a pool without other cells, so that it is to blame if the worker dies."""
    for attempt in range(ATTEMPTS):
        try:
            yield from _pool([cell], store, 2, backend, address, command)
            return
        except _deaths(backend) as death:
            if attempt == ATTEMPTS - 1:
                yield Outcome(cell.id, "failed", error=f"its worker died {ATTEMPTS} times ({type(death).__name__})")


def _pool(
    cells: Sequence[Cell],
    store: Store,
    workers: int,
    backend: str,
    address: str | None,
    command: str,
) -> Iterator[Outcome]:
    """Run cells in one pool of workers. It ends early, with an exception, if a worker dies."""
    from joblib import Parallel, delayed

    jobs = [delayed(compute)(cell, store, command, limits()) for cell in cells]
    with _backend(backend, workers, address):
        if backend != "ray":
            with parent_decides():
                outcomes = Parallel(return_as="generator_unordered")(jobs)
            yield from outcomes
            return
        # Ray's backend returns lists only. Short ones show progress, and little is lost with a
        # worker.
        for first in range(0, len(jobs), _ROUND):
            yield from Parallel()(jobs[first : first + _ROUND])


def _backend(backend: str, workers: int, address: str | None) -> AbstractContextManager[Any]:
    from joblib import parallel_config

    if backend == "loky":
        return parallel_config(backend="loky", n_jobs=workers, inner_max_num_threads=1)
    if backend == "ray":
        import ray
        from ray.util.joblib import register_ray

        if not ray.is_initialized():
            ray.init(address=address, num_cpus=None if address else max(workers, 1), log_to_driver=False)
        register_ray()
        return parallel_config(backend="ray", n_jobs=workers)
    from distributed import Client, get_client

    try:
        client = get_client()
    except ValueError:
        client = Client(address) if address else Client(n_workers=max(workers, 1), threads_per_worker=1)
    return parallel_config(backend="dask", n_jobs=workers, client=client)


def _deaths(backend: str) -> tuple[type[BaseException], ...]:
    """Return the exceptions of a pool when a worker dies."""
    from joblib.externals.loky.process_executor import BrokenProcessPool, TerminatedWorkerError

    deaths: list[type[BaseException]] = [BrokenProcessPool, TerminatedWorkerError]
    if backend == "ray":
        from ray.exceptions import RayError

        deaths.append(RayError)
    if backend == "dask":
        from distributed.scheduler import KilledWorker

        deaths.append(KilledWorker)
    return tuple(deaths)
