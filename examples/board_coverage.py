"""Check of the board's intervals: how often do they hold the numbers of other seeds?

`python examples/board_coverage.py 512 --policies lqg@tuned l1-adaptive@tuned` runs the board's
cells with 512 test seeds, makes a board of each 32 of them, and counts how many of its intervals
hold the numbers of all the others. 95 % of them should.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from benchmarks.analysis.board import Board
from benchmarks.analysis.statistics import Estimate
from benchmarks.cli.common import run_all
from benchmarks.cli.leaderboard import boards_of, suites_of
from benchmarks.cli.parser import add_arguments, trust
from fbl_gym.model.arm import Array

ARGUMENTS = "--policies --policy --scenarios --cell-timeout --cell-memory --workers --trust --store"


def coverage(board: Board, seeds: int) -> dict[str, Array]:
    """Return the share of small boards whose interval holds the number of the other seeds.

    Args:
        board: with many seeds.
        seeds: of each small board.

    Returns:
        for error, lost runs and rank, an entry for each ranked policy.
    """
    held: dict[str, list[Array]] = {}
    for k in range(len(board.seeds) // seeds):
        some = np.arange(len(board.seeds)) // seeds == k
        small, others = board.of_seeds(some), board.of_seeds(~some)
        for name, numbers in (("error", Board.error), ("lost", lambda x: x.lost), ("rank", lambda x: x.rank)):
            held.setdefault(name, []).append(_holds(numbers(small), numbers(others))[board.ranked])
    return {name: np.mean(rows, axis=0) for name, rows in held.items()}


def _holds(interval: Estimate, truth: Estimate) -> Array:
    return np.asarray((interval.low <= truth.value) & (truth.value <= interval.high), dtype=float)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the coverage of each quantity, by policy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("number", type=int, metavar="N", help="number of test seeds in all")
    parser.add_argument("--of", type=int, default=32, metavar="N", help="seeds of a small board (32)")
    parser.add_argument("--suite", default="servo", metavar="SUITE", help="as for `fbl-gym leaderboard`, one (servo)")
    add_arguments(parser, {name: {} for name in ARGUMENTS.split()})
    arguments = parser.parse_args(argv)
    trust(arguments)
    if arguments.number < 2 * arguments.of:
        parser.error(f"N must be at least twice --of {arguments.of}, got {arguments.number}")
    arguments.suite, arguments.seeds, arguments.short = [arguments.suite], arguments.number, False
    (suite,) = suites_of(arguments)
    board = boards_of([suite], run_all(suite.cells, arguments))[suite.name]
    shares = coverage(board, arguments.of)
    print(f"{arguments.number // arguments.of} boards of {arguments.of} seeds: intervals that hold, in %")
    print(*(f"{name.replace('_', ' '):>14}" for name in shares), " policy")
    for k, i in enumerate(board.ranked):
        print(*(f"{100 * x[k]:>14.0f}" for x in shares.values()), f" {board.policies[i]}")
    print(*(f"{100 * x.mean():>14.0f}" for x in shares.values()), " all")


if __name__ == "__main__":
    main()
