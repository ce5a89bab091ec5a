"""Tables in Markdown, for the README and the documentation."""

import re
from collections.abc import Iterable, Mapping, Sequence

from benchmarks.analysis.board import Board
from benchmarks.report.columns import ALL, ALL_BUT_README, Column, columns, over_all
from benchmarks.run.suite import PAPER

BEGIN, END = "<!-- leaderboard -->", "<!-- /leaderboard -->"
"""The lines of a file between which the leaderboard is written."""

ROWS = 5
"""Number of rows of the short table, before those of the paper's laws."""


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


def leaderboard(board: Board) -> str:
    """Return the board as a table, the best policy first, and its remarks."""
    remarks = "".join(f"\n{plain(remark)}\n" for remark in board.remarks)
    return _table(board, board.order, ALL, ALL_BUT_README) + remarks


def first_rows(boards: Mapping[str, Board]) -> str:
    """Return a short table of each board, by name: the first five rows, and the paper's laws."""
    texts = []
    for name, board in boards.items():
        rows = [i for i in board.order if i in board.order[:ROWS] or board.specs[i].parsed.law in PAPER]
        gaps = "".join(f"\n{plain(gap)}\n" for gap in board.gaps)
        texts.append(f"**{plain(name)}**\n\n" * (len(boards) > 1) + _table(board, rows, ALL) + gaps)
    return "\n".join(texts)


def _table(board: Board, rows: Iterable[int], *tables: str) -> str:
    """Return the table of some rows, with the columns that belong to some tables."""
    selected = [column for column in columns(board) if column.tables in tables]
    return table(
        [plain(column.title) for column in selected], [[_cell(column, i) for column in selected] for i in rows]
    )


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


def board_page(boards: Mapping[str, Board]) -> str:
    """Return a page of the documentation with every row of some boards, by name."""
    parts = ["# All rows of the boards\n\n[The leaderboard](../reference/columns.md) explains the columns.\n"]
    if len(boards) > 1:
        header, rows = over_all(boards)
        rows = [[code(policy), *map(plain, cells)] for policy, *cells in rows]
        parts.append(f"## Over all\n\nScore, and ranks in brackets, on each board.\n\n{table(header, rows)}")
    parts += [
        f"## {plain(name)}\n\n`fbl-gym leaderboard --suite {name}`: {len(board.scenarios)} scenarios, {len(board.seeds)} seeds "
        f"each. The board is {board.version}, a hash of its policies, scenarios, seeds and code.\n\n{leaderboard(board)}"
        for name, board in boards.items()
    ]
    return "\n".join(parts)
