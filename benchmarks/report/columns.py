"""The columns of the board for the page, the Markdown tables and the terminal.

`columns.toml` declares them.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.analysis.board import Board, meaning_of
from benchmarks.analysis.statistics import Estimate
from benchmarks.run.metrics import MARGINS
from fbl_gym.model.arm import Array
from fbl_gym.scenarios.files import read_toml

#: The tables that have a column; the page has all columns.
ALL, PAGE_AND_MARKDOWN, NONE = "all", "page and Markdown", "none"

DECLARED: dict[str, dict[str, Any]] = read_toml(Path(__file__).with_name("columns.toml"))


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
        values: numbers, NaN where a policy has none, or texts.
        leaders: the ranked policies with the best value; none, if all have the same.
        interval: ends of the 95 % intervals; empty without intervals.
        notes: text below each entry; empty without notes.
        best: 1 if larger is better, -1 if smaller is better, 0 if neither.
        form: function that prints a number.
        tables: that have the column: `ALL`, `PAGE_AND_MARKDOWN` or `NONE`.
        ends: the interval in a table: "" none, "interval" both ends, "upper" the upper end, "range"
            both ends in place of the value.
    """

    key: str
    title: str
    meaning: str
    values: Array | Sequence[str]
    leaders: Sequence[int]
    interval: Sequence[Array] = ()
    notes: Sequence[str] = ()
    best: int = 0
    form: Callable[[float], str] = lambda x: number(x)
    tables: str = PAGE_AND_MARKDOWN
    ends: str = ""

    @property
    def is_choice(self) -> bool:
        """True for a column of words, by which the page filters."""
        return self.key != "policy" and isinstance(self.values[0], str)

    def text(self, i: int) -> str:
        """Return the value of policy i as text, without its interval."""
        value = self.values[i]
        return value if isinstance(value, str) else "–" if np.isnan(value) else self.form(value)

    def bounds(self, i: int, between: str = "–") -> str:
        """Return the interval of policy i as text; empty without an interval."""
        return between.join(self.form(end[i]) for end in self.interval if not np.isnan(end[i]))

    def cell(self, i: int, brief: bool = False) -> str:
        """Return the entry of policy i in a table; a brief one has no interval in brackets."""
        low, _, high = (bounds := self.bounds(i)).partition("–")
        if self.ends == "range":
            return low if low == high else bounds
        both = "" if brief else f" ({bounds})"
        note = f", {self.notes[i]}" if self.notes and self.notes[i] else ""
        return self.text(i) + {"": "", "interval": both, "upper": f" (≤{high})"}[self.ends] + note


def over_all(boards: Mapping[str, Board]) -> Table:
    """Return a table of several boards: rank and error of each policy, and its lost runs if any.

    The policies come in the order of their best rank, then of the mean of their ranks.

    Args:
        boards: by name.
    """
    places: dict[str, list[float]] = defaultdict(list)
    texts: dict[str, dict[str, str]] = defaultdict(dict)
    for name, board in boards.items():
        rank, error, lost = board.rank, board.error().value, board.lost.value
        for i in board.ranked:
            ends = dict.fromkeys((whole(rank.low[i]), whole(rank.high[i])))
            parts = ["–".join(ends), f"{number(error[i])} %", *([f"{share(lost[i])} % lost"] if lost[i] else [])]
            texts[board.policies[i]][name] = " · ".join(parts)
            places[board.policies[i]].append(rank.value[i])
    order = sorted(places, key=lambda policy: (min(places[policy]), np.mean(places[policy])))
    rows = [[policy, *(texts[policy].get(name, "–") for name in boards)] for policy in order]
    return Table(["policy", *boards], rows)


def leaders(board: Board) -> Table:
    """Return a table of the policy that leads each family, with its error."""
    rows = []
    for family, some in board.families.items() if board.ranked else ():
        error = board.error(some).value
        first, *others = sorted(board.ranked, key=lambda i: error[i])[:2]
        cells = [[board.policies[i], f"{number(error[i])} %"] for i in (first, *others)]
        rows.append(
            [family, *cells[0], f"{number(board.mrad(some)[first])} mrad", *(cells[1] if others else ("–", "–"))]
        )
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


def whole(x: float) -> str:
    """Return a number without decimals."""
    return f"{x:.0f}"


def share(x: float) -> str:
    """Return a share of 1 in %, as `percent`."""
    return percent(100 * x)


FORMS: dict[str, Callable[[float], str]] = {each.__name__: each for each in (number, percent, times, whole, share)}


def _violations(board: Board) -> list[float]:
    """Return the mean of each policy's violations; NaN where no run has constraints."""
    known = [runs[~np.isnan(runs)] for runs in board.split(board.runs["violation_pct"][:, board.main])]
    return [float(np.mean(runs)) if runs.size else np.nan for runs in known]


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


def _leaders(values: Any, best: int, ranked: Sequence[int]) -> list[int]:
    """Return the ranked policies with the best of some values; none, if all have the same."""
    known = {i: best * values[i] for i in ranked if best and not np.isnan(values[i])}
    return [i for i in known if known[i] == max(known.values()) > min(known.values())]


def columns_of(board: Board, *tables: str) -> list[Column]:
    """Return the columns of some tables, by `Column.tables`, the policy's name first."""
    return sorted((each for each in columns(board) if each.tables in tables), key=lambda each: each.key != "policy")


def columns(board: Board) -> list[Column]:
    """Return the columns of a board, from left to right, without those of no value."""
    first, *others = board.tiers
    here = f"in the tier {first}" if others else "of this suite"
    every: list[Column] = []

    def add(name: str, numbers: Any, notes: Sequence[str] = (), **words: str) -> None:
        """Add a declared column with numbers or texts, and some words in its texts."""
        values, *interval = (numbers.value, numbers.low, numbers.high) if isinstance(numbers, Estimate) else (numbers,)
        if all(value != value for value in values):
            return
        fields = {"key": name, "title": name, "form": "number"} | DECLARED[name]
        fields |= {field: fields[field].format(here=here, **words) for field in ("key", "title", "meaning")}
        fields |= {"form": FORMS[fields["form"]], "leaders": _leaders(values, fields.get("best", 0), board.ranked)}
        every.append(Column(values=values, interval=interval, notes=notes, **fields))

    add("rank", board.rank)
    add("policy", board.policies, _notes(board))
    add("error", board.error())
    add("lost", board.lost)
    add("oracle", board.times_oracle())
    add("worst", board.worst)
    add("worst-family", *_worst_family(board))
    add("violation", _violations(board))
    for margin in MARGINS:
        add(margin, board.margin(margin))
    add("effort", board.effort)
    for tier in others:
        add("error-in-tier", board.error(board.tiers[tier]), tier=tier)
        add("oracle-in-tier", board.times_oracle(board.tiers[tier]), tier=tier)
    add("mrad", board.mrad())
    for family, some in board.families.items():
        name = "family" if some[0] in board.main else "family-in-tier"
        add(name, board.error(some), family=family, text=meaning_of(board.scenarios[some[0]]))
    add("access", [spec.access for spec in board.specs])
    sensors = ([name[0] for name in spec.needs] + ["r"] * (spec.preview > 0) for spec in board.specs)
    add("sensors", [" ".join(names) or "none" for names in sensors])
    add("decision", board.decision_us)
    add("tuning", [spec.tuning for spec in board.specs])
    return every
