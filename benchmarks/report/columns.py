"""The columns of the board, declared once for the page, the Markdown tables and the terminal."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from benchmarks.analysis.board import Board, meaning_of
from benchmarks.analysis.statistics import Estimate

Value: TypeAlias = float | str | None

ALL, ALL_BUT_LATEX, NONE = "all", "all but LaTeX", "none"
"""The tables that have a column; the page has all columns."""


@dataclass(frozen=True)
class Column:
    """One column of the board, with an entry for each policy [p].

    Attributes:
        key: short name, which is also the anchor that sorts by this column.
        title: head of the column.
        meaning: one sentence for the reader.
        values: number or text of each policy; None where a policy has none.
        low, high: ends of the 95 % intervals; empty without intervals.
        notes: text below the entry of each policy; empty without notes.
        best: 1 if larger is better, -1 if smaller is better, 0 if neither.
        form: function that prints a number.
        tables: that have the column: `ALL`, `ALL_BUT_LATEX` or `NONE`.
        ends: the interval in a table: "" none, "interval" both ends, "upper" the upper end, "range"
            both ends in place of the value.
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
    tables: str = ALL_BUT_LATEX
    ends: str = ""

    @property
    def is_choice(self) -> bool:
        """True for a column of words, by which the page filters."""
        return self.key != "policy" and all(isinstance(value, str) for value in self.values)

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

    def cell(self, i: int, brief: bool = False) -> str:
        """Return the entry of policy i in a table; a brief one has no interval in brackets."""
        low, _, high = self.interval(i).partition("–")
        if self.ends == "range":
            return "" if not low else low if low == high else f"{low}–{high}"
        ends = f" (≤{high})" if self.ends == "upper" else f" ({low}–{high})" if self.ends and not brief else ""
        note = f", {self.notes[i]}" if self.notes and self.notes[i] else ""
        return self.text(i) + (ends if low else "") + note

    def leader(self, ranked: Sequence[int]) -> Value:
        """Return the best value of some policies; None where no value is better than another."""
        values = [x for i in ranked if isinstance(x := self.values[i], float | int)]
        return self.best * max(self.best * x for x in values) if self.best and len(set(values)) > 1 else None


def over_all(boards: Mapping[str, Board], rows: Sequence[str] = ()) -> tuple[list[str], list[list[str]]]:
    """Return a table of several boards: header, and rows with rank, score and error of a policy.

    The policies come in the order of their best rank, then of the mean of their scores.

    Args:
        boards: by name.
        rows: names of policies; empty: all that are ranked.
    """
    texts: dict[str, dict[str, str]] = {}
    scores: dict[str, float] = {}
    best: dict[str, float] = {}
    for name, board in boards.items():
        for place, i in enumerate(board.ranked):
            score = math.nan if board.score is None else float(board.score.value[i])
            low, high = (f"{end[place]:.0f}" for end in (board.rank.low, board.rank.high))
            rank = low if low == high else f"{low}–{high}"
            texts.setdefault(board.policies[i], {})[name] = f"{rank} · {score:.1f} · {number(board.error.value[i])} %"
            scores[board.policies[i]] = scores.get(board.policies[i], 0.0) + score / len(boards)
            best[board.policies[i]] = min(board.rank.value[place], best.get(board.policies[i], math.inf))
    order = sorted(rows or texts, key=lambda policy: (best[policy], -scores[policy]))
    body = [
        [policy, *(texts[policy].get(name, "–").replace("nan", "–") for name in boards),
         f"{scores[policy]:.1f}" if len(texts[policy]) == len(boards) else "–"]
        for policy in order
    ]  # fmt: skip
    return ["policy", *boards, "mean score"], body


def leaders(board: Board) -> tuple[list[str], list[list[str]]]:
    """Return a table of the policy that leads each family: header, and rows with its error."""
    rows = []
    for family, estimate in board.family_errors.items():
        first, second, *_ = sorted(board.ranked, key=lambda i: estimate.value[i])[:2] * 2
        rows.append([
            family, board.policies[first], f"{number(estimate.value[first])} %",
            f"{number(board.mrad(board.families[family])[first])} mrad", board.policies[second],
            f"{number(estimate.value[second])} %",
        ])  # fmt: skip
    return ["family", "first", "error", "", "second", "error"], rows


def number(x: float) -> str:
    """Return a number with three significant digits, without an exponent down to 1e-6."""
    if np.isnan(x):
        return "–"
    if x == 0 or abs(x) < 1e-6:
        return f"{x:.2g}"
    return f"{x:.{max(0, 2 - math.floor(math.log10(abs(x))))}f}"


def percent(x: float) -> str:
    """Return a share in % with two significant digits, or "100"."""
    return f"{x:.2g}" if x < 99.5 else f"{x:.0f}"


def _estimated(key: str, title: str, meaning: str, estimate: Estimate, scale: float = 1.0, **more: Any) -> Column:
    """Return a column of numbers with intervals, times a scale."""
    value, low, high = ((scale * np.asarray(x)).tolist() for x in (estimate.value, estimate.low, estimate.high))
    return Column(key, title, meaning, value, low, high, **more)


def _ranked(board: Board, key: str, title: str, meaning: str, ranks: Estimate) -> Column:
    """Return a column of ranks, which only ranked policies have."""
    value, low, high = (
        [dict(zip(board.ranked, bound.tolist(), strict=True)).get(i) for i in range(len(board.policies))]
        for bound in (ranks.value, ranks.low, ranks.high)
    )
    meaning += " Median and interval over the bootstrap. A policy with privileged access has no rank."
    return Column(key, title, meaning, value, low, high, form="{:.0f}".format, tables=ALL, ends="range")


def _violations(board: Board) -> list[float | None]:
    """Return the mean of each policy's violations; None where no run has constraints."""
    known = [runs[~np.isnan(runs)] for runs in board.split(board.runs["violation_pct"][:, board.main])]
    return [float(np.mean(runs)) if runs.size else None for runs in known]


def _notes(board: Board) -> list[str]:
    """Return the number of training seeds of each policy, and of the scenarios where it failed."""
    seeds = [f"{size} training seeds" if size > 1 else "" for size in board.sizes]
    failures = [sum(j == i for j, _ in board.failed) for i in range(len(board.policies))]
    failed = [f"motionless in {n} of {len(board.scenarios)}" if n else "" for n in failures]
    return [", ".join(filter(None, pair)) for pair in zip(seeds, failed, strict=True)]


def columns_of(board: Board, *tables: str) -> list[Column]:
    """Return the columns of some tables, by `Column.tables`, the policy's name first."""
    return sorted((each for each in columns(board) if each.tables in tables), key=lambda each: each.key != "policy")


def columns(board: Board) -> list[Column]:
    """Return the columns of a board, from left to right, without those of no value."""
    first, *others = board.tiers
    here = f"in the tier {first}" if others else "of this suite"
    every = [
        _ranked(board, "rank", "rank", "Rank by the score, or by the error where there is no score.", board.rank),
        Column(
            "policy", "policy", "Name of the policy. The row of an agent is the mean over its training seeds. Where a policy "
            "failed, it counts as the motionless baseline.", board.policies, notes=_notes(board), tables=ALL,
        ),
        *(
            _estimated(
                f"score-{tier}" if tier != first else "score", "score" if tier == first else f"{tier} score",
                "0 is the motionless baseline, 100 the ceiling: the law with the least error that knows the truth. "
                f"Logarithmic in the error; each percent of diverged runs counts as twice the error. Mean of the scenarios "
                f"in the tier {tier}.",
                score, best=1, form="{:.1f}".format, tables=ALL if tier == first else ALL_BUT_LATEX, ends="interval",
            )
            for tier, score in board.scores.items()
        ),
        _estimated(
            "error", "error %", f"Geometric mean, over all runs {here}, of the mean absolute tracking error in % of the "
            "reference's amplitude, half its range.", board.error, best=-1, tables=ALL, ends="interval",
        ),
        _estimated(
            "diverged", "diverged %", f"Share of runs that diverged {here}, with the upper end of its posterior's interval. "
            "These runs count in every error.", board.diverged, 100.0, best=-1, form=percent, tables=ALL, ends="upper",
        ),
        Column(
            "violation", "violation %", f"Share of samples beyond the constraints, mean of the runs {here}.",
            _violations(board), best=-1, form=percent, tables=ALL,
        ),
        Column(
            "effort", "effort", "Torque variation relative to that of the ceiling, median of the scenarios.",
            [] if board.effort is None else board.effort.tolist(), tables=ALL,
        ),
        Column(
            "worst", "worst 5 %", f"Mean error % of the worst 5 % of the runs {here}.", board.worst.tolist(), best=-1,
            tables=ALL,
        ),
        _ranked(board, "error-rank", "error rank", "Rank by the error.", board.error_rank),
        _ranked(board, "diverged-rank", "diverged rank", "Rank by the share of runs that diverge.", board.diverged_rank),
        Column(
            "mrad", "mrad", f"Geometric mean, over all runs {here}, of the mean absolute tracking error of both joints [mrad].",
            board.mrad(board.main).tolist(), best=-1,
        ),
        *(
            _estimated(f"family-{family}", family, f"Error % over one family: {meaning_of(board.scenarios[members[0]])}.",
                      board.family_errors[family], best=-1, tables=ALL_BUT_LATEX if members[0] in board.main else NONE)
            for family, members in board.families.items()
        ),
        Column(
            "access", "access", "Knowledge of the arm: none, the nominal model, or privileged (the real arm).",
            [spec.access for spec in board.specs],
        ),
        Column(
            "sensors", "sensors", "What the policy reads: p position, v velocity, a acceleration, r the coming reference.",
            [" ".join([name[0] for name in spec.needs] + ["r"] * (spec.preview > 0)) or "none" for spec in board.specs],
        ),
        Column(
            "decision", "µs/decision", "Wall time of one decision of one lane of a batch [µs].",
            board.decision_us.tolist(),
        ),
        Column("tuning", "gains", "Origin of the gains.", [spec.tuning for spec in board.specs], tables=NONE),
    ]  # fmt: skip
    return [column for column in every if any(value is not None for value in column.values)]
