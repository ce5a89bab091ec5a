"""Check of the board's intervals: how often do they hold the numbers of other seeds?

`python -m tests.board_coverage 512 --policies lqg@tuned l1-adaptive@tuned` runs the
board's cells with 512 test seeds, makes a board of each 32 of them, and counts how many of its
intervals hold the numbers of all the others. 95 % of them should.
"""

import argparse
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.analysis.board import Board, assemble
from benchmarks.analysis.statistics import Estimate
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Store
from benchmarks.run.suite import load
from fbl_gym.model.arm import Array


def coverage(board: Board, seeds: int) -> dict[str, Array]:
    """Return the share of small boards whose interval holds the number of the other seeds.

    Args:
        board: with many seeds.
        seeds: of each small board.

    Returns:
        for error, lost runs and rank, an entry for each ranked policy.
    """
    count = len(board.seeds) // seeds
    held: dict[str, list[Array]] = {}
    for k in range(count):
        some = np.arange(len(board.seeds)) // seeds == k
        small, others = _of(board, some), _of(board, ~some)
        for name, numbers in (("error", Board.error), ("lost", lambda x: x.lost), ("rank", lambda x: x.rank)):
            of_ranked = slice(None) if name == "rank" else board.ranked
            held.setdefault(name, []).append(_holds(numbers(small), numbers(others))[of_ranked])
    return {name: np.mean(rows, axis=0) for name, rows in held.items()}


def _of(board: Board, some: Array) -> Board:
    """Return the board of some of the seeds [n], which a mask chooses."""
    runs = {name: values[..., some] for name, values in board.runs.items()}
    return dataclasses.replace(board, seeds=tuple(np.array(board.seeds)[some].tolist()), runs=runs)


def _holds(interval: Estimate, truth: Estimate) -> Array:
    return np.asarray((interval.low <= truth.value) & (truth.value <= interval.high), dtype=float)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the coverage of each quantity, by policy."""
    parser = argparse.ArgumentParser(prog="python -m tests.board_coverage", description=__doc__)
    parser.add_argument("seeds", type=int, metavar="N", help="number of test seeds in all")
    parser.add_argument("--of", type=int, default=32, metavar="N", help="seeds of a small board (32)")
    parser.add_argument("--suite", default="servo", metavar="S", help="name or file of a suite (servo)")
    parser.add_argument("--policies", nargs="+", default=(), metavar="P", help="only these (the suite's)")
    parser.add_argument("--scenarios", nargs="+", default=(), metavar="S", help="only these (the suite's)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    parser.add_argument("--store", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    arguments = parser.parse_args(argv)
    if arguments.seeds < 2 * arguments.of:
        parser.error(f"N must be at least twice --of {arguments.of}, got {arguments.seeds}")
    store = Store(arguments.store)
    cells = load(arguments.suite).build(arguments.policies, arguments.scenarios, arguments.seeds).cells
    for _ in run_cells(cells, store, workers=arguments.workers):
        pass
    board = assemble([result for cell in cells if (result := store.find(cell))], cells)
    shares = coverage(board, arguments.of)
    print(f"{arguments.seeds // arguments.of} boards of {arguments.of} seeds: intervals that hold, in %")
    print(*(f"{name.replace('_', ' '):>14}" for name in shares), " policy")
    for k, i in enumerate(board.ranked):
        print(*(f"{100 * x[k]:>14.0f}" for x in shares.values()), f" {board.policies[i]}")
    print(*(f"{100 * x.mean():>14.0f}" for x in shares.values()), " all")


if __name__ == "__main__":
    main()
