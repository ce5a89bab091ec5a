"""Runs cells one after another; a policy that fails is a result with its error, not the end of the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from benchmarks.metrics import measure
from benchmarks.rollout import rollout
from benchmarks.suite import Cell
from fbl_gym import scenarios


@dataclass(frozen=True)
class Result:
    """What a cell gave.

    Args:
        cell: which one.
        rows: the metrics of each seed, in the seeds' order; empty where it failed.
        decision_us: the policy's wall time for one decision of one lane [us].
        wall_s: time that the cell took [s].
        error: what went wrong; empty: nothing.
    """

    cell: Cell
    rows: tuple[dict[str, float], ...]
    decision_us: float
    wall_s: float
    error: str = ""


def run_cell(cell: Cell) -> Result:
    """The result of one cell."""
    begin = time.perf_counter()
    try:
        trace = rollout(cell.policy, scenarios.get(cell.scenario), cell.seeds)
        rows, decision = tuple(measure(trace)), 1e6 * trace.decision_time
    except Exception as problem:  # a stranger's policy may raise anything, and the other rows must not suffer
        return Result(cell, (), float("nan"), time.perf_counter() - begin, f"{type(problem).__name__}: {problem}")
    return Result(cell, rows, decision, time.perf_counter() - begin)


def run(cells: Sequence[Cell], on_result: Callable[[Result], None] | None = None) -> Iterator[Result]:
    """The results of the cells, in their order."""
    for cell in cells:
        result = run_cell(cell)
        if on_result is not None:
            on_result(result)
        yield result
