"""The leaderboard and the evaluation of one policy, as tables on a terminal."""

from collections.abc import Iterable, Sequence
from typing import Literal, TypeAlias

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from benchmarks.analysis.board import Board
from benchmarks.paper.claim import Claim
from benchmarks.report.columns import Column, columns
from benchmarks.run.metrics import Metric, counted_errors, describe, summarize
from benchmarks.speed.environments import Speed

Justify: TypeAlias = Literal["left", "right"]

MEANING = (
    "score: 0 for an arm that stays at its start, 100 for the best law that knows the truth. error: geometric mean of the mean "
    "absolute tracking error in % of the reference's amplitude. diverged: share of runs, with its upper bound. effort: torque "
    "variation relative to that law's. rank: 95 % interval. In brackets: privileged access, not ranked."
)


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[str | Text]], justify: Justify = "right") -> Table:
    """Return a table whose columns after the first are aligned by `justify`; no text is cut."""
    drawn = Table(title=escape(title), title_style="bold", box=SIMPLE_HEAD)
    for i, name in enumerate(header):
        drawn.add_column(escape(name), justify=justify if i else "left", overflow="fold")
    for row in rows:
        drawn.add_row(*(escape(cell) if isinstance(cell, str) else cell for cell in row))
    return drawn


def leaderboard(console: Console, board: Board) -> None:
    """Print one row per policy, the best first.

    No text is cut. A file gets lines of any length. On a narrow terminal, the columns that do not
    fit follow in further tables.
    """
    text_width = console.width
    rank, policy, *left = (column for column in columns(board) if column.place != "page")
    left = [rank, *left]
    if not console.is_terminal:
        console.width = max(console.width, _width(console, _board(board, policy, left)))
    counts = {"scenario": len(board.scenarios), "seed": len(board.seeds)}
    title: str | None = ", ".join(f"{n} {name}{'s' * (n != 1)}" for name, n in counts.items()) + " each"
    while left:
        fits = [n for n in range(len(left) + 1) if _width(console, _board(board, policy, left[:n])) <= console.width]
        n = max([*fits, 1])
        table = _board(board, policy, left[:n])
        table.title = title
        console.print(table)
        left, title = left[n:], None
    console.print(MEANING, width=min(text_width, console.width))
    for remark in board.remarks:
        style = "red" if remark in board.gaps else "yellow"
        console.print(f"[{style}]{escape(remark)}[/{style}]", width=min(text_width, console.width))


def _width(console: Console, table: Table) -> int:
    """Return the width at which no text of a table is cut."""
    return console.measure(table, options=console.options.update(width=10_000)).maximum


def _board(board: Board, policy: Column, selected: Sequence[Column]) -> Table:
    """Return a table with the policies and some columns."""
    table = Table(title_style="bold", box=SIMPLE_HEAD, padding=(0, 0, 0, 1), pad_edge=False)
    table.add_column("policy", no_wrap=True)
    for column in selected:
        head = escape(column.title.replace("-", "-\n").replace(" ", "\n").replace("/", "/\n"))
        table.add_column(head, justify="left" if column.is_choice else "right", no_wrap=True)
    leaders = [column.leader(board.ranked) for column in selected]
    for i in board.order:
        privileged = not board.specs[i].ranked
        cells = [escape(f"({policy.cell(i)})" if privileged else policy.cell(i))]
        for column, leader in zip(selected, leaders, strict=True):
            best = not privileged and leader is not None and column.values[i] == leader
            text = escape(column.cell(i, brief=True))
            cells.append(f"[green]{text}[/green]" if best else text)
        table.add_row(*cells, style="dim" if privileged else "")
    return table


def evaluation(
    console: Console, title: str, rows: list[dict[str, float]], decision_us: float, more: Sequence[Metric] = ()
) -> None:
    """Print the metrics of one policy on one scenario: mean and largest value over the seeds."""
    errors = counted_errors(rows)
    mean = f"{np.exp(np.log(errors).mean()):.4g}"
    lines = [("error", mean, f"{max(errors):.4g}", "the board's error: geometric mean over the seeds [%]")]
    for name, value, meaning in describe(summarize(rows), more):
        known = [row[name] for row in rows if not np.isnan(row[name])]
        lines.append((name, value, f"{max(known):.4g}" if known else "-", meaning))
    lines.append(("decision_us", f"{decision_us:.3g}", "", "wall time of one decision of one lane [us]"))
    console.print(table(title, ("metric", "mean", "largest", "meaning"), lines, "left"))


def claims(console: Console, measured: Sequence[Claim]) -> None:
    """Print the paper's claims: claim, measurement and verdict."""
    colour = {"reproduced": "green", "under assumptions": "yellow", "not reproduced": "red", "–": "default"}
    header = ("figure", "claim", "paper", "measured", "holds", "verdict")
    rows = [(c.figure, c.claim, c.paper, c.measured, c.holds, Text(c.verdict, colour[c.verdict])) for c in measured]
    console.print(table("The paper's claims, measured", header, rows, "left"))


def speed(console: Console, rows: Sequence[Speed]) -> None:
    """Print steps per second, and their ratio to the peer's."""
    lines = []
    for row in rows:
        spread = f"{100 * (row.high - row.low) / row.median:.0f} %"
        lines.append((row.name, f"{row.median:,.0f}", spread, f"{row.ratio:.3g}" if row.peer else ""))
    title = "Environment steps per second, one thread, median of the rounds"
    console.print(table(title, ("environment", "median", "spread", "x peer"), lines))
    console.print(
        "x peer: to Acrobot-v1 through gym.make for a single environment, to SyncVectorEnv of 256 for a batch, to the same "
        "arms in C (physics alone) for a batch of 4,096. busy: stick-slip friction, noise on every sensor and a disturbance. "
        "One step is ten Runge-Kutta steps of 1 ms."
    )
