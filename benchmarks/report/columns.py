"""The board's columns: the page prints all of them, `markdown.py` those that it names.

`terminal.py` has a table with fewer columns, which uses the same format of numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from benchmarks.analysis.board import Board
from benchmarks.analysis.generalization import MEANING, RangeErrors
from benchmarks.analysis.statistics import Estimate
from fbl_gym import scenarios

Value: TypeAlias = float | str | None


@dataclass(frozen=True)
class Column:
    """One column of the board, with an entry for each policy [p].

    Attributes:
        key: short name, which is also the anchor that sorts by this column.
        title: head of the column.
        meaning: one sentence for the reader.
        values: number or text of each policy; None where a policy has none.
        low, high: ends of the 95 % intervals; empty without intervals.
        notes: text below the number of each policy; empty without notes.
        best: 1 if larger is better, -1 if smaller is better, 0 if neither.
        form: function that prints a number.
    """

    key: str
    title: str
    meaning: str
    values: Sequence[Value]
    low: Sequence[Value] = ()
    high: Sequence[Value] = ()
    notes: Sequence[str] = ()
    best: int = 0
    form: Callable[[float], str] = lambda x: number(x)

    def text(self, i: int) -> str:
        """Return the value of policy i as text, without its interval."""
        value = self.values[i]
        return "–" if value is None else value if isinstance(value, str) else self.form(value)

    def interval(self, i: int, between: str = "–") -> str:
        """Return the interval of policy i as text; empty without an interval."""
        low, high = (self.low[i], self.high[i]) if self.low else (None, None)
        if not isinstance(low, float | int) or not isinstance(high, float | int):
            return ""
        return f"{self.form(low)}{between}{self.form(high)}"


def number(x: float) -> str:
    """Return a number with three significant digits, without an exponent down to 1e-6."""
    if np.isnan(x):
        return "–"
    if x == 0 or abs(x) < 1e-6:
        return f"{x:.2g}"
    return f"{x:.{max(0, 2 - math.floor(math.log10(abs(x))))}f}"


def columns(board: Board, ranges: Mapping[str, RangeErrors]) -> list[Column]:
    """Return the columns of a board, from left to right, one for each generalization range."""
    policies = board.policies
    rank: list[Value] = [None] * len(policies)
    ends: list[list[Value]] = [rank[:], rank[:]]
    for place, i in enumerate(board.ranked):
        rank[i] = float(board.rank.value[place])
        ends[0][i], ends[1][i] = float(board.rank.low[place]), float(board.rank.high[place])

    def estimated(key: str, title: str, meaning: str, estimate: Estimate, scale: float = 1.0, **more: object) -> Column:
        value, low, high = ((scale * np.asarray(x)).tolist() for x in (estimate.value, estimate.low, estimate.high))
        return Column(key, title, meaning, value, low, high, **more)  # type: ignore[arg-type]

    known = scenarios.families()
    return [
        Column(
            "rank", "rank", "Median rank over the bootstrap. A policy with privileged access has no rank.",
            rank, low=ends[0], high=ends[1], form="{:.0f}".format,
        ),
        Column("policy", "policy", "Name of the policy.", policies),
        *(
            [] if board.score is None else [estimated(
                "score", "score", "Mean of the runs' scores: 0 is an arm that stays at its start, 100 is the oracle, −100 a "
                "run that diverged.", board.score, best=1, form="{:.1f}".format,
            )]
        ),
        estimated(
            "error", "error %", "Interquartile mean, over all scenarios, of the mean absolute tracking error in % of the "
            "reference's amplitude.", board.error, best=-1,
        ),
        estimated(
            "diverged", "diverged %", "Share of runs that diverged, with Clopper and Pearson's interval. These runs count in "
            "every error.", board.diverged, 100.0, best=-1, form="{:.2g}".format,
        ),
        Column(
            "variation", "torque variation kN m/s",
            "Total variation of the torque per second, both joints, median of the runs.",
            (np.median(board.runs["variation"], axis=(1, 2)) / 1e3).tolist(),
        ),
        *(
            estimated(f"family-{family}", family, f"Error % over one family: {known.get(family, 'of this suite')}.",
                      board.family_errors[family], best=-1)
            for family in board.families
        ),
        *(
            estimated(
                f"range-{name}", name, f"Error % on {MEANING[name]}, and the share of runs that diverged. An agent counts "
                "with all its training seeds.", errors.error, best=-1, form="{:.3f}".format,
                notes=[f"{100 * share:.2g} % diverged" if share else "" for share in errors.diverged],
            )
            for name, errors in ranges.items()
        ),
        Column(
            "decision", "µs/decision", "Wall time of one decision of one lane of a batch [µs].",
            board.decision_us.tolist(),
        ),
        Column(
            "access", "access", "Knowledge of the arm: none, the nominal model, or privileged (the real arm).",
            [spec.access for spec in board.specs],
        ),
        Column("sensors", "sensors", "Sensors that the policy needs.", [", ".join(spec.needs) for spec in board.specs]),
        Column(
            "preview", "preview", "Part of the reference's future that the policy reads.",
            [f"{spec.preview:.2g} s" if spec.preview else "none" for spec in board.specs],
        ),
        Column("tuning", "gains", "Origin of the gains.", [spec.tuning for spec in board.specs]),
    ]  # fmt: skip
