"""Runs the cells that a store lacks, through joblib: on this machine, or on a Ray or Dask cluster.

The worker that computed a cell writes it into the store. So nothing is lost with a worker or with the run itself: what the
store lacks is what is still to do, and a run goes on until nothing is missing or nothing gets done any more.
"""

from __future__ import annotations

import os
import random
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from benchmarks.policies import resolve
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.run.store import Result, Store, identity, provenance
from benchmarks.run.suite import Cell
from fbl_gym.checks import check_choice

BACKENDS = ("loky", "ray", "dask")

ATTEMPTS = 2
"""How often a worker may die over a cell of its own before that counts as failed."""


_ROUND = 32
"""Cells that Ray is given at a time."""


@dataclass(frozen=True)
class Outcome:
    """What became of a cell in this run.

    Args:
        id: of the cell.
        done: "computed", "found" (it was in the store), or "failed".
        wall_s: time that it took [s].
        error: why it failed.
    """

    id: str
    done: str
    wall_s: float = 0.0
    error: str = ""


def run_cell(cell: Cell, command: str = "") -> Result:
    """The result of one cell.

    Args:
        cell: which; where its policy fails, the result has the error.
        command: the line that was typed, for the record.
    """
    begin = time.perf_counter()
    known: dict[str, Any] = {}
    try:
        known = identity(cell)
        trace = rollout(cell.policy, cell.scenario, cell.seeds)
        rows, decision, error = tuple(measure(trace)), 1e6 * trace.decision_time, ""
    except Exception as problem:  # a stranger's policy may raise anything, and the other rows must not suffer
        rows, decision, error = (), float("nan"), f"{type(problem).__name__}: {problem}"
    known = known or {"policy": cell.policy, "scenario": cell.scenario.name, "seeds": list(cell.seeds)}
    return Result(cell, rows, decision, time.perf_counter() - begin, error, known, provenance(command))


def compute(cell: Cell, store: Store, command: str, trusted: Sequence[str] = ()) -> Outcome:
    """Compute a cell and write it into the store, unless it is there: what a worker does.

    Args:
        cell: which.
        store: where its result goes.
        command, trusted: as in `run`.
    """
    from threadpoolctl import threadpool_limits

    for path in trusted:
        resolve.trust(path)
    with threadpool_limits(1):
        if _finished(cell, store):
            return Outcome(cell.id, "found")
        result = run_cell(cell, command)
        store.save(result)
    return Outcome(cell.id, "failed" if result.error else "computed", result.wall_s, result.error)


def missing(cells: Sequence[Cell], store: Store) -> list[Cell]:
    """The cells that the store lacks.  cells: to look for; store: to look in."""
    return [cell for cell in cells if not _finished(cell, store)]


def _finished(cell: Cell, store: Store) -> bool:
    try:
        return store.path(cell, identity(cell)).exists()
    except Exception:  # it cannot even be made: running it says why
        return False


def run(
    cells: Sequence[Cell],
    store: Store,
    *,
    workers: int = 1,
    backend: str = "loky",
    address: str | None = None,
    command: str = "",
    trusted: Sequence[str] = (),
) -> Iterator[Outcome]:
    """Run the cells that the store lacks, in any order; yields what becomes of each.

    Args:
        cells: all that shall be in the store.
        store: where results go; on a cluster, a folder that all its machines see.
        workers: processes; -1: one per core.
        backend: "loky" for processes on this machine, "ray" or "dask" for a cluster.
        address: of the cluster's scheduler; None: one of its own on this machine.
        command: that this run was started with, for the record.
        trusted: archives that may be loaded; see `resolve.trust`.
    """
    check_choice("backend", backend, BACKENDS)
    store = Store(store.folder.resolve())
    left = missing(cells, store)
    waiting = {id(cell) for cell in left}
    for cell in cells:
        if id(cell) not in waiting:
            yield Outcome(cell.id, "found")
    # Two runs that share a store rarely want the same cell at the same time.
    random.Random(os.getpid()).shuffle(left)
    while left:
        failed: set[str] = set()
        try:
            for outcome in _pool(left, store, workers, backend, address, command, trusted):
                if outcome.done == "failed":
                    failed.add(outcome.id)
                yield outcome
        except _deaths(backend):
            pass
        after = [cell for cell in missing(left, store) if cell.id not in failed]
        if len(after) == len(left):
            # A worker died before any cell was done: find out over which, one by one, and go on without it.
            found: list[Outcome] = []
            while after and not any(outcome.error for outcome in found):
                found = list(_alone(after.pop(0), store, backend, address, command, trusted))
                yield from found
        left = after


def _alone(
    cell: Cell, store: Store, backend: str, address: str | None, command: str, trusted: Sequence[str]
) -> Iterator[Outcome]:
    """A cell in a pool of its own, so that a worker that dies is its doing."""
    for attempt in range(ATTEMPTS):
        try:
            yield from _pool([cell], store, 2, backend, address, command, trusted)
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
    trusted: Sequence[str],
) -> Iterator[Outcome]:
    """One pool of workers over the cells; ends early, with an exception, if a worker dies."""
    from joblib import Parallel, delayed

    jobs = [delayed(compute)(cell, store, command, trusted) for cell in cells]
    with _backend(backend, workers, address):
        if backend != "ray":
            yield from Parallel(return_as="generator_unordered")(jobs)
            return
        # Ray's backend returns lists only; so that progress is seen, and little is lost with a worker, they are short.
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
    """What a pool raises when a worker dies."""
    from joblib.externals.loky.process_executor import BrokenProcessPool, TerminatedWorkerError

    found: list[type[BaseException]] = [BrokenProcessPool, TerminatedWorkerError]
    if backend == "ray":
        from ray.exceptions import RayError

        found.append(RayError)
    if backend == "dask":
        from distributed.scheduler import KilledWorker

        found.append(KilledWorker)
    return tuple(found)
