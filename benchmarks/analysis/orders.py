"""Other orders of the board: by how much does its order depend on what is counted?

`python -m benchmarks.analysis.orders` prints Kendall's tau between the order of the board, which
must be in the store, and its order by other numbers: for all ranked rows, and for the first ten.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.analysis.board import TOP, Board, assemble
from benchmarks.run.store import Store
from benchmarks.run.suite import load
from fbl_gym.model.arm import Array


def numbers(board: Board) -> dict[str, Array]:
    """Return what each ranked row could be ordered by, the smallest number first, by its name."""
    rms = board.average(np.log(board.runs["rms_mrad"][:, board.main]).mean(axis=(1, 2))[None])[0]
    given = {
        "error": board.error.value,
        "diverged runs": board.diverged.value,
        "worst 5 %": board.worst,
        "RMS": rms,
        **{f"error in {family}": estimate.value for family, estimate in board.family_errors.items()},
    }
    if board.effort is not None:
        given["error x effort"] = board.error.value * board.effort
        given["error x square root of effort"] = board.error.value * np.sqrt(board.effort)
    return {name: values[board.ranked] for name, values in given.items()}


def main(argv: Sequence[str] | None = None) -> None:
    """Print tau for each other order."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.analysis.orders", description=__doc__)
    parser.add_argument("--suite", default="servo", metavar="S", help="name or file of a suite (servo)")
    parser.add_argument("--policies", nargs="+", default=(), metavar="P", help="only these (the suite's)")
    parser.add_argument("--seeds", type=int, metavar="N", help="test seeds (the suite's)")
    parser.add_argument("--store", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    arguments = parser.parse_args(argv)
    store = Store(arguments.store)
    cells = load(arguments.suite).build(arguments.policies, (), arguments.seeds).cells
    board = assemble([result for cell in cells if (result := store.find(cell))], cells)
    rows = [i for i in board.order if i in board.ranked]
    place = np.array([rows.index(i) for i in board.ranked])
    print(f"tau with the order of {len(rows)} rows, and of the first {TOP}")
    for name, values in numbers(board).items():
        first = place < TOP
        every, some = (stats.kendalltau(place[of], values[of]).statistic for of in (place >= 0, first))
        print(f"{every:6.2f} {some:6.2f}  {name}")


if __name__ == "__main__":
    main()
