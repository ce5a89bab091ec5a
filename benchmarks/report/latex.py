"""Tables in LaTeX, for a paper; they need the package booktabs."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks.analysis.board import Board
from benchmarks.files import write_text
from benchmarks.report.columns import ALL, columns_of

_SPECIAL = str.maketrans({
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$", ">": "$>$",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "–": "--", "≤": r"$\le$", "×": r"$\times$", "µ": r"$\mu$", "²": r"$^2$", "\N{MINUS SIGN}": "$-$",
})  # fmt: skip


def escape(text: str) -> str:
    """Return text in one line that LaTeX prints character by character, with minus signs."""
    return re.sub(r"(?<![\w-])-(?=\d)", "\N{MINUS SIGN}", " ".join(text.split())).translate(_SPECIAL)


def write_table(
    path: Path, header: Sequence[str], rows: Iterable[Sequence[str]], command: str, meaning: str = "",
    groups: Sequence[tuple[str, int]] = (),
) -> None:  # fmt: skip
    """Write a table to a file; columns of numbers are aligned to the right.

    Args:
        path: of the file.
        header: names of the columns.
        rows: texts, one for each column.
        command: which made the table, as a comment.
        meaning: of a cell, as another comment.
        groups: title and number of columns of each group of columns; empty: there are none.
    """
    rows = list(rows)
    numbers = (sum(bool(re.match(r"[-(]?\d", row[i])) for row in rows) for i in range(len(header)))
    columns = "".join("r" if 2 * count > len(rows) else "l" for count in numbers)
    lines = [" & ".join(map(escape, row)) + r" \\" for row in (header, *rows)]
    if groups:
        titles = (rf"\multicolumn{{{count}}}{{c}}{{{escape(title)}}}" for title, count in groups)
        lines.insert(0, " & ".join(titles) + r" \\")
    lines.insert(len(lines) - len(rows), r"\midrule")
    head = f"% {' '.join(command.split())}\n% \\usepackage{{booktabs}}\n" + f"% {meaning}\n" * bool(meaning)
    table = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", *lines, r"\bottomrule", r"\end{tabular}", ""]
    write_text(path, head + "\n".join(table))


def write_board(path: Path, board: Board, command: str) -> None:
    """Write the main columns of the board to a file, the best policy first."""
    selected = columns_of(board, ALL)
    rows = [[column.cell(i) or "not ranked" for column in selected] for i in board.order]
    write_table(path, [column.title for column in selected], rows, command)
