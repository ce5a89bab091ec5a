"""Agreement between the orders of policies in two worlds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbl_gym.arm import Array

FLOOR_PCT = 1e-3
"""A smaller error counts as this one [%]."""

SEPARATED = 2.0
"""Two policies are separated by this many standard errors of their mean difference."""


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau between two orders of policies.

    Attributes:
        tau: share of pairs in the same order less share of pairs in the other order; NaN: no pairs.
        pairs: number of pairs that both worlds separate.
    """

    tau: float
    pairs: int


def compare_orders(first: Array, second: Array) -> Agreement:
    """Return the agreement between the orders of policies in two worlds.

    A pair of policies counts if the runs of both worlds separate it.

    Args:
        first: errors in one world [policies x runs], in %.
        second: errors of the same policies in the other world, likewise.
    """
    ways = [_ways(np.log(np.maximum(errors, FLOOR_PCT))) for errors in (first, second)]
    products = (ways[0] * ways[1])[np.triu_indices(len(first), 1)]
    pairs = int(np.count_nonzero(products))
    return Agreement(float(products.sum() / pairs) if pairs else float("nan"), pairs)


def _ways(logs: Array) -> Array:
    """Return for each pair which policy errs less: -1 the first, 1 the second, 0 not separated."""
    differences = logs[:, None] - logs[None, :]
    error = differences.std(axis=-1) / np.sqrt(logs.shape[1])
    mean = differences.mean(axis=-1)
    return np.sign(mean) * (np.abs(mean) > SEPARATED * error)
