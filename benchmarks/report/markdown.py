"""Tables in Markdown, for the README and the documentation."""

import re
from collections.abc import Iterable, Sequence

from benchmarks.analysis.board import Board
from benchmarks.report.columns import ALL, ALL_BUT_README, Column, columns

BEGIN, END = "<!-- leaderboard -->", "<!-- /leaderboard -->"
"""The lines of a file between which the leaderboard is written."""

ROWS = 5
"""Number of rows of the short table."""


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table, one line a row."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def code(text: str) -> str:
    """Return text that Markdown shows character by character, in one line."""
    text = " ".join(text.split())
    fence = "`" * (1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence} {text} {fence}" if "`" in text else f"`{text}`"


def plain(text: str) -> str:
    """Return text, such as a name, in which Markdown and HTML find no markup, in one line."""
    return re.sub(r"([\\`*\[\]<>&]|(?<!\w)_|_(?!\w))", r"\\\1", " ".join(text.split()))


def leaderboard(board: Board, *, short: bool = False) -> str:
    """Return the board as a table, the best policy first, and its remarks.

    A short one has the best five rows with the main columns, and no remarks on a complete board.
    """
    tables = (ALL,) if short else (ALL, ALL_BUT_README)
    selected = [column for column in columns(board) if column.tables in tables]
    rows = [[_cell(column, i) for column in selected] for i in (board.order[:ROWS] if short else board.order)]
    remarks = "".join(f"\n{plain(remark)}\n" for remark in (board.gaps if short else board.remarks))
    return table([plain(column.title) for column in selected], rows) + remarks


def _cell(column: Column, i: int) -> str:
    if column.key == "policy":
        return code(column.text(i)) + (f", {column.notes[i]}" if column.notes[i] else "")
    return plain(column.cell(i)) or "not ranked"


def replace_between(text: str, table: str) -> str:
    """Return a file's text with a new table between its markers, which it must have."""
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the file must have the lines {BEGIN} and {END}; the table goes between them")
    return f"{head}{BEGIN}\n{table}{END}{tail}"


def board_page(board: Board, command: str) -> str:
    """Return a page of the documentation with every row of the board."""
    return (
        f"# All rows of the board\n\nHow do all policies do? `{command}`: {len(board.scenarios)} scenarios, "
        f"{len(board.seeds)} seeds each. This is the board {board.version}, a hash of its policies, scenarios, seeds and "
        "code.\n[The leaderboard](../reference/columns.md) explains the columns.\n\n" + leaderboard(board)
    )
