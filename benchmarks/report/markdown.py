"""Tables in Markdown, for the README and the documentation."""

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from benchmarks.analysis.board import Board
from benchmarks.report.columns import ALL, PAGE_AND_MARKDOWN, Column, columns_of, leaders, number, over_all, percent
from benchmarks.report.page import render
from fbl_gym.scenarios.classes import CLASSES

#: The lines of a file between which the leaderboard is written.
BEGIN, END = "<!-- leaderboard -->", "<!-- /leaderboard -->"

#: Number of first rows of each board in the README.
ROWS = 5


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

    A short one has the main columns alone.
    """
    selected = columns_of(board, ALL, *([] if short else [PAGE_AND_MARKDOWN]))
    rows = [[_cell(column, i) for column in selected] for i in board.order]
    remarks = "".join(f"\n{plain(remark)}\n" for remark in board.remarks)
    return table([plain(column.title) for column in selected], rows) + remarks


def first_rows(boards: Mapping[str, Board]) -> str:
    """Return a table of the first rows of some boards, by name.

    A cell has the error, and the delay margin in samples, if the board has margins.
    """
    columns = []
    for board in boards.values():
        error, delay = board.error().value, board.margin("delay_samples")
        margin = ["" if np.isnan(x) else f" · {percent(x)}" for x in delay]
        first = [i for i in board.order if i in board.ranked][:ROWS]
        columns.append([f"{code(board.policies[i])} {number(error[i])} %{margin[i]}" for i in first])
    rows = ([str(rank), *cells] for rank, cells in enumerate(itertools.zip_longest(*columns, fillvalue=""), 1))
    return table(["rank", *boards], rows) + _gaps(boards)


def _gaps(boards: Mapping[str, Board]) -> str:
    return "".join(f"\n{plain(name)}: {plain(gap)}\n" for name, board in boards.items() for gap in board.gaps)


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

    def unbroken(cell: str) -> str:
        """Return a cell whose numbers stay in one line, on a phone too."""
        return plain(cell).replace(" ", "\u00a0").replace("–", "–\u2060" if len(cell) > 1 else "–")

    header, rows = over_all(boards)
    over = table(header, [[code(policy), *map(unbroken, cells)] for policy, *cells in rows]) + _gaps(boards)
    leading = {name: leaders(board) for name, board in boards.items()}
    first = {name: table(header, [[*map(plain, row)] for row in rows]) for name, (header, rows) in leading.items()}
    parts = {"boards": boards, "over": over, "leaders": first, "classes": CLASSES}
    return render("board.md.jinja", **parts, leaderboard=leaderboard, plain=plain)
