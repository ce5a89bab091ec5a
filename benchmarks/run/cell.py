"""One cell: run it, in this process or in one that no other policy shares, and store its result."""

from __future__ import annotations

import atexit
import contextlib
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.policies import external
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.run.store import Result, Store, provenance
from benchmarks.run.suite import Cell

ATTEMPTS = 2
"""How often a worker may die over one cell before the cell fails."""


@dataclass(frozen=True)
class Outcome:
    """The end of a cell in a run.

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
    """Run one cell in this process and return its result, or its error where the policy fails.

    Args:
        cell: to run.
        command: the command that was typed, for the record.
    """
    begin = time.perf_counter()
    try:
        if cell.policy.problem:
            raise ValueError(cell.policy.problem)
        with external.watch() as reads:
            trace = rollout(cell.policy, cell.scenario, cell.seeds)
        cell.policy.check(reads)
        rows, decision, error = tuple(measure(trace)), 1e6 * trace.decision_time, ""
    except (Exception, SystemExit) as problem:  # an external policy may raise anything, and other cells must not suffer
        rows, decision, error = (), float("nan"), f"{type(problem).__name__}: {problem}"
    return Result(cell, rows, decision, time.perf_counter() - begin, error, provenance(command))


def compute(cell: Cell, store: Store, command: str) -> Outcome:
    """Run a cell and write its result into the store, unless it is there.

    Args:
        cell: to run.
        store: for the result.
        command: the command that was typed, for the record.
    """
    if store.find(cell) is not None:
        return Outcome(cell.id, "found")
    with _one_thread():
        result = run_apart(cell, command) if cell.policy.external else run_cell(cell, command)
    store.save(result)
    return Outcome(cell.id, "failed" if result.error else "computed", result.wall_s, result.error)


def _one_thread() -> contextlib.AbstractContextManager[object]:
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1)


def run_apart(cell: Cell, command: str = "") -> Result:
    """Run a cell as `run_cell` does, in a process that only cells of the same policy share.

    An external policy may change anything in its process, such as `np.seterr` or a class of fbl-gym.
    """
    begin = time.perf_counter()
    for _ in range(ATTEMPTS):
        try:
            return _process(cell).ask(cell, command)
        except (EOFError, OSError, pickle.UnpicklingError):
            _close()
    error = f"its worker died {ATTEMPTS} times"
    return Result(cell, (), float("nan"), time.perf_counter() - begin, error, provenance(command))


class _Process:
    """A Python process that runs cells of one policy. It ends with its parent, when its input ends."""

    def __init__(self, cell: Cell) -> None:
        self.owner = _owner(cell)
        code = f"import sys; sys.path[:] = {sys.path!r}; from benchmarks.run.cell import serve; serve()"
        self.process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def ask(self, cell: Cell, command: str) -> Result:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        pickle.dump((cell, command), self.process.stdin)
        self.process.stdin.flush()
        result: Result = pickle.load(self.process.stdout)
        return result

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


_PROCESSES: list[_Process] = []
"""The process for external policies that this one has, if any."""


def _owner(cell: Cell) -> tuple[object, ...]:
    return os.getpid(), cell.policy.name, cell.policy.digest, sorted(cell.policy.data.items())


def _process(cell: Cell) -> _Process:
    if _PROCESSES and _PROCESSES[0].owner != _owner(cell):
        _close()
    if not _PROCESSES:
        _PROCESSES.append(_Process(cell))
    return _PROCESSES[0]


@atexit.register
def _close() -> None:
    while _PROCESSES:
        process = _PROCESSES.pop()
        if process.owner[0] == os.getpid():
            process.close()


def serve() -> None:
    """Run the cells that arrive at the standard input, and write each result to the standard output."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a policy may print
    with _one_thread():
        for cell, command in _requests():
            pickle.dump(run_cell(cell, command), replies)
            replies.flush()


def _requests() -> Iterator[tuple[Cell, str]]:
    requests = os.fdopen(os.dup(0), "rb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    while True:
        try:
            yield pickle.load(requests)
        except EOFError:
            return
