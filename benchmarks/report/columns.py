"""The columns of the board, declared once for the page, the Markdown tables and the terminal."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from benchmarks.analysis.board import Board, meaning_of
from benchmarks.analysis.statistics import Estimate
from fbl_gym.model.arm import Array

Value: TypeAlias = float | str | None

ALL, PAGE_AND_MARKDOWN, NONE = "all", "page and Markdown", "none"
"""The tables that have a column; the page has all columns."""


class Table(NamedTuple):
    """A table of texts, which the terminal, Markdown and LaTeX print."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]


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
        tables: that have the column: `ALL`, `PAGE_AND_MARKDOWN` or `NONE`.
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
    tables: str = PAGE_AND_MARKDOWN
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
        ends = [self.form(x) for end in (self.low, self.high) if end and isinstance(x := end[i], float | int)]
        return between.join(ends)

    def cell(self, i: int, brief: bool = False) -> str:
        """Return the entry of policy i in a table; a brief one has no interval in brackets."""
        low, _, high = self.interval(i).partition("–")
        if self.ends == "range":
            return "" if not low else low if low == high else f"{low}–{high}"
        ends = f" (≤{high})" if self.ends == "upper" else f" ({low}–{high})" if self.ends and not brief else ""
        note = f", {self.notes[i]}" if self.notes and self.notes[i] else ""
        return self.text(i) + (ends if low else "") + note

    def leads(self, i: int, ranked: Sequence[int]) -> bool:
        """Return whether policy i has the best value of some; False where all have the same."""
        values = {self.best * x for j in ranked if isinstance(x := self.values[j], float | int)}
        value = self.values[i]
        return (
            len(values) > 1 and isinstance(value, float | int) and bool(self.best * value == np.fmax.reduce([*values]))
        )


def over_all(boards: Mapping[str, Board]) -> Table:
    """Return a table of several boards: rank and error of each policy, and its lost runs if any.

    The policies come in the order of their best rank, then of the mean of their ranks.

    Args:
        boards: by name.
    """
    places: dict[str, list[float]] = {}
    texts: dict[str, dict[str, str]] = {}
    for name, board in boards.items():
        error, lost = board.error().value, 100 * board.lost.value
        for i, value, low, high in zip(board.ranked, board.rank.value, board.rank.low, board.rank.high, strict=True):
            rank = f"{low:.0f}" if low == high else f"{low:.0f}–{high:.0f}"
            parts = [rank, f"{number(error[i])} %", *([f"{percent(lost[i])} % lost"] if lost[i] else [])]
            texts.setdefault(board.policies[i], {})[name] = " · ".join(parts)
            places.setdefault(board.policies[i], []).append(value)
    order = sorted(places, key=lambda policy: (min(places[policy]), np.mean(places[policy])))
    body = [[policy, *(texts[policy].get(name, "–") for name in boards)] for policy in order]
    return Table(["policy", *boards], body)


def leaders(board: Board) -> Table:
    """Return a table of the policy that leads each family, with its error."""
    rows = []
    for family, some in board.families.items():
        error = board.error(some).value
        first, second, *_ = sorted(board.ranked, key=lambda i: error[i])[:2] * 2
        errors, mrad = [f"{number(error[i])} %" for i in (first, second)], f"{number(board.mrad(some)[first])} mrad"
        rows.append([family, board.policies[first], errors[0], mrad, board.policies[second], errors[1]])
    return Table(["family", "first", "error", "", "second", "error"], rows)


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


def times(x: float) -> str:
    """Return a factor with two significant digits, or "> 1000"."""
    return "–" if np.isnan(x) else percent(x) if x <= 1000 else "> 1000"


def _column(
    board: Board, key: str, title: str, meaning: str, numbers: Estimate | Array | None, scale: float = 1.0, **more: Any
) -> Column:
    """Return a column of numbers times a scale, of all policies, of the ranked ones, or of none."""
    if numbers is None:
        return Column(key, title, meaning, (), **more)
    ends = (numbers.value, numbers.low, numbers.high) if isinstance(numbers, Estimate) else (numbers,)
    rows = board.ranked if len(ends[0]) == len(board.ranked) else range(len(board.policies))
    for name, end in zip(("values", "low", "high"), ends, strict=False):
        known = dict(zip(rows, (scale * end).tolist(), strict=True))
        more[name] = [known.get(i) for i in range(len(board.policies))]
    return Column(key, title, meaning, **more)


def _violations(board: Board) -> list[float | None]:
    """Return the mean of each policy's violations; None where no run has constraints."""
    known = [runs[~np.isnan(runs)] for runs in board.split(board.runs["violation_pct"][:, board.main])]
    return [float(np.mean(runs)) if runs.size else None for runs in known]


def _worst_family(board: Board) -> tuple[Array, list[str]]:
    """Return each policy's largest multiple of the least error in a family, and that family [p]."""
    families = {name: members for name, members in board.families.items() if members[0] in board.main}
    errors = np.array([board.error(members).value for members in families.values()])
    least = errors[:, board.ranked].min(axis=1, keepdims=True, initial=np.inf)
    multiples = np.where(least < np.inf, errors / least, np.nan)  # without a ranked row there is none
    return multiples.max(axis=0), [list(families)[k] for k in multiples.argmax(axis=0)]


def _notes(board: Board) -> list[str]:
    """Return the number of training seeds of each policy, and of the scenarios where it failed."""
    seeds = [f"{size} training seeds" if size > 1 else "" for size in board.sizes]
    failures = [len(board.failed.get(policy, ())) for policy in board.policies]
    failed = [f"motionless in {n} of {len(board.scenarios)}" if n else "" for n in failures]
    return [", ".join(filter(None, pair)) for pair in zip(seeds, failed, strict=True)]


def columns_of(board: Board, *tables: str) -> list[Column]:
    """Return the columns of some tables, by `Column.tables`, the policy's name first."""
    return sorted((each for each in columns(board) if each.tables in tables), key=lambda each: each.key != "policy")


def columns(board: Board) -> list[Column]:
    """Return the columns of a board, from left to right, without those of no value."""
    first, *others = board.tiers
    here = f"in the tier {first}" if others else "of this suite"
    numbers, (multiples, worst) = partial(_column, board), _worst_family(board)

    def of_oracle(tier: str, some: Sequence[int]) -> Column:
        return numbers(
            f"oracle-{tier}".strip("-"), f"{tier} × oracle".strip(), "Error, doubled for each percent of lost runs, as a "
            "multiple of that of the best oracle.", board.times_oracle(some), best=-1, form=times,
            tables=PAGE_AND_MARKDOWN if tier else ALL,
        )  # fmt: skip

    every = [
        numbers("rank", "rank", "Rank by the error, doubled for each percent of lost runs. Median and interval over the "
                "bootstrap. An oracle has no rank.", board.rank, form="{:.0f}".format, tables=ALL,
                ends="range"),
        Column(
            "policy", "policy", "Name of the policy. The row of an agent is the mean over its training seeds. Where a policy "
            "failed, it counts as the motionless baseline.", board.policies, notes=_notes(board), tables=ALL,
        ),
        numbers(
            "error", "error %", f"Geometric mean, over all runs {here}, of the mean absolute tracking error in % of the "
            "reference's amplitude, half its range.", board.error(), best=-1, tables=ALL, ends="interval",
        ),
        numbers("lost", "lost runs %", f"Share of the runs {here} that diverged, with the upper end of its exact interval. "
                "They count in every error.", board.lost, 100.0, best=-1, form=percent, tables=ALL, ends="upper"),
        of_oracle("", board.main),
        numbers("worst", "worst 5 %", f"Mean error % of the worst 5 % of the runs {here}.", board.worst, best=-1, tables=ALL),
        numbers("worst-family", "worst family", "Largest multiple of the least error of a ranked row in a family, and that "
                "family.", multiples, best=-1, form=times, notes=worst, tables=ALL),
        Column("violation", "violation %", f"Share of samples beyond the constraints, mean of the runs {here}.",
               _violations(board), best=-1, form=percent, tables=ALL),
        *(
            numbers(name, title, f"{meaning} at rest, without dry friction: of the nominal scenario's first arms, linearised.",
                    board.margin(name), best=best, form=times)
            for name, title, meaning, best in (
                ("phase_deg", "phase margin °", "Least phase margin", 1),
                ("delay_samples", "delay margin, samples", "Least delay margin", 1),
                ("gain_margin", "gain margin", "Least upper gain margin", 1),
                ("sensitivity", "peak of S", "Largest peak of the sensitivity", -1),
            )
        ),
        numbers("effort", "effort", "Torque variation as a multiple of that of the best oracle, median "
                "of the scenarios.", board.effort, tables=ALL),
        *(
            column for tier in others for column in (
                numbers(f"error-{tier}", f"{tier} error %", f"The error in the tier {tier}.", board.error(board.tiers[tier]),
                        best=-1, ends="interval"),
                of_oracle(tier, board.tiers[tier]),
            )
        ),
        numbers("mrad", "mrad", f"Geometric mean, over all runs {here}, of the mean absolute tracking error of both joints "
                "[mrad].", board.mrad(), best=-1),
        *(
            numbers(f"family-{family}", family, f"Error % over one family: {meaning_of(board.scenarios[members[0]])}.",
                    board.error(members), best=-1, tables=PAGE_AND_MARKDOWN if members[0] in board.main else NONE)
            for family, members in board.families.items()
        ),
        Column("access", "access", "Knowledge of the arm: none, the nominal model, or oracle (the real arm).",
               [spec.access for spec in board.specs]),
        Column("sensors", "sensors", "What the policy reads: p position, v velocity, a acceleration, r the coming reference.",
               [" ".join([name[0] for name in spec.needs] + ["r"] * (spec.preview > 0)) or "none" for spec in board.specs]),
        numbers("decision", "µs/decision", "Wall time of one decision of one lane of a batch [µs].", board.decision_us),
        Column("tuning", "gains", "Origin of the gains.", [spec.tuning for spec in board.specs], tables=NONE),
    ]  # fmt: skip
    return [column for column in every if any(value is not None and value == value for value in column.values)]
