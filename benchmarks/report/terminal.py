"""The leaderboard and the evaluation of one policy, as tables on a terminal."""

import math
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.segment import Segment
from rich.table import Table as Drawn
from rich.text import Text

from benchmarks.analysis.board import Board
from benchmarks.report.columns import ALL, Column, Table, columns_of, over_all
from benchmarks.run.metrics import METRICS, counted_errors
from benchmarks.text import visible

Justify: TypeAlias = Literal["left", "right"]

MEANING = (
    "rank: 95 % interval, by the error, doubled for each percent of lost runs. error: geometric mean of the mean absolute "
    "tracking error in % of the reference's amplitude. lost runs: those that diverged, with the upper bound of their share. "
    "× oracle, effort: as multiples of the best oracle, which knows the truth. In brackets: oracles, not ranked. "
    "`fbl-gym report` writes all columns."
)


class Screen(Console):
    """A console, 132 columns wide in a file, on which no name controls the terminal."""

    def __init__(self, stderr: bool = False) -> None:
        terminal = (sys.stderr if stderr else sys.stdout).isatty()
        super().__init__(stderr=stderr, width=None if terminal else 132, emoji=False)

    def render(self, *arguments: Any, **options: Any) -> Iterable[Segment]:
        """Yield the segments of an object, with control characters as escapes."""
        for segment in super().render(*arguments, **options):
            yield segment if segment.control else segment._replace(text=visible(segment.text))


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[str | Text]], justify: Justify = "right") -> Drawn:
    """Return a table whose columns after the first are aligned by `justify`; no text is cut."""
    drawn = Drawn(title=escape(title), title_style="bold", box=SIMPLE_HEAD)
    for i, name in enumerate(header):
        drawn.add_column(escape(name), justify=justify if i else "left", overflow="fold")
    for row in rows:
        drawn.add_row(*(escape(cell) if isinstance(cell, str) else cell for cell in row))
    return drawn


def show(title: str, header: Sequence[str], rows: Iterable[Sequence[str]], justify: Justify = "right") -> None:
    """Print a `table` of texts."""
    Screen().print(table(title, header, rows, justify))


def leaderboards(
    console: Console, boards: Mapping[str, Board], first: float = math.inf, also: Collection[str] = ()
) -> None:
    """Print each board, by name, and how each policy does on all of them.

    A table has the `first` rows, or all, and those of some policies.
    """
    for name, board in boards.items():
        if len(boards) > 1:
            console.print(f"\n[bold]{escape(name)}[/bold]")
        leaderboard(console, board, first, also)
    if len(boards) > 1:
        header, body = over_all(boards)
        some = [row for k, row in enumerate(body) if k < first or row[0] in also]
        console.print(table("rank and error on each board", header, some))
    console.print(escape(MEANING))


def leaderboard(console: Console, board: Board, first: float = math.inf, also: Collection[str] = ()) -> None:
    """Print one row per policy, the best first, and the board's remarks, as `leaderboards` does.

    No text is cut: the table has the first of the main columns that fit, and the others are named.
    """
    rows = [i for k, i in enumerate(board.order) if k < first or board.policies[i] in also]
    shown, hidden = columns_of(board, ALL), ""
    unlimited = console.options.update(width=10_000)
    while len(shown) > 1 and console.measure(_board(board, shown, rows), options=unlimited).maximum > console.width:
        hidden = f", {shown.pop().title}{hidden}"
    console.print(_board(board, shown, rows))
    if hidden:
        console.print(escape(f"A wider terminal also shows{hidden[1:]}."))
    for remark in board.remarks:
        console.print(escape(remark), style="red" if remark in board.gaps else "yellow")


def _board(board: Board, selected: Sequence[Column], chosen: Sequence[int]) -> Drawn:
    """Return a table with some columns and policies of a board."""
    rows = []
    for i in chosen:
        cells = [Text(column.cell(i, brief=True), "green" if i in column.leaders else "") for column in selected]
        rows.append(cells if i in board.ranked else [Text(f"({cells[0]})"), *cells[1:]])
    beside = "".join(f", {len(some)} of {tier} without a rank" for tier, some in [*board.tiers.items()][1:])
    counts = {"scenario": len(board.main), "seed": len(board.seeds)}
    title = f"{beside}, ".join(f"{n} {name}{'s' * (n != 1)}" for name, n in counts.items())
    return table(f"{title} each; board {board.version}", [column.title for column in selected], rows)


def evaluation(rows: list[dict[str, float]], decision_us: float, every: bool) -> Table:
    """Return the metrics of one policy on one scenario: mean and largest value over the seeds.

    Metrics without a value in any run have a row only with `every`.
    """
    errors = counted_errors(rows)
    mean = f"{np.exp(np.log(errors).mean()):.4g}"
    lines = [("error", mean, f"{max(errors):.4g}", "the board's error: geometric mean over the seeds [%]")]
    for name, meaning in METRICS.items():
        known = [row[name] for row in rows if not np.isnan(row[name])]
        mean, most = (f"{np.mean(known):.4g}", f"{max(known):.4g}") if known else ("-", "-")
        if known or every:
            lines.append((name, mean, most, meaning))
    lines.append(("decision_us", f"{decision_us:.3g}", "", "wall time of one decision of one lane [us]"))
    return Table(("metric", "mean", "largest", "meaning"), lines)
