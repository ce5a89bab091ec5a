"""Orders of policies in two worlds, and their agreement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from benchmarks.analysis.board import Board
from benchmarks.analysis.statistics import TAIL


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau between two orders of policies.

    Attributes:
        tau: of all pairs; NaN: there are none.
        pairs: their number.
        clear_tau: of the pairs that both sides separate; NaN: there are none.
        clear_pairs: their number.
    """

    tau: float
    pairs: int
    clear_tau: float
    clear_pairs: int


def compare_orders(first: Board, second: Board, rows: Sequence[str]) -> Agreement:
    """Return the agreement between the orders of some rows of two boards, by their errors.

    Two boards separate a pair of rows if its 95 % intervals are disjoint on both. Scenarios share
    their seeds, so each seed gives one mean over scenarios and training seeds. A row whose runs all
    diverge on both boards has no place in an order.
    """
    if not rows:
        return Agreement(np.nan, 0, np.nan, 0)
    signs, clear, lost = [], [], []
    for board in (first, second):
        chosen = [board.policies.index(row) for row in rows]
        errors, diverged = board.split(board.errors), board.split(board.runs["diverged"])
        lost.append([diverged[i].all() for i in chosen])
        logs = np.array([np.log(errors[i]).mean(axis=(0, 1)) for i in chosen])
        seeds, mean = len(board.seeds), logs.mean(axis=1)
        half = special.stdtrit(seeds - 1, 1 - TAIL) * logs.std(axis=1, ddof=1) / np.sqrt(seeds)
        differences = mean[:, None] - mean
        signs.append(np.sign(differences))
        clear.append(np.abs(differences) > half[:, None] + half)
    ordered = ~np.all(lost, axis=0)
    pairs = np.triu(np.outer(ordered, ordered), 1)
    products, both = (signs[0] * signs[1])[pairs], (clear[0] & clear[1])[pairs]
    tau, clear_tau = (float(x.mean()) if x.size else float("nan") for x in (products, products[both]))
    return Agreement(tau, len(products), clear_tau, int(both.sum()))


def compare_halves(board: Board, rows: Sequence[str]) -> Agreement:
    """Return the agreement between two halves of the seeds, the most that worlds can have."""
    return compare_orders(board.of_seeds(slice(0, None, 2)), board.of_seeds(slice(1, None, 2)), rows)
