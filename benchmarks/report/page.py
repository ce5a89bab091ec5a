"""The leaderboard as one HTML file that needs no network: `page.html` with its data and Plotly."""

import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from benchmarks.analysis.board import Board
from benchmarks.files import write_text
from benchmarks.report.columns import columns
from benchmarks.report.figures import pareto
from benchmarks.run.store import Result


def write_page(path: Path, board: Board, results: Sequence[Result], command: str) -> None:
    """Write the page of a board to a file. The template escapes every text.

    Args:
        path: of the file.
        board: of the page.
        results: those of the board's cells, for their provenance.
        command: that wrote the page.
    """
    from jinja2 import Environment, StrictUndefined  # the extra `analysis`
    from plotly.offline import get_plotlyjs

    latest = max((result.provenance for result in results), key=lambda origin: origin.get("time", ""))
    made = {"computed with": "command", "on": "machine", "at": "time", "Python": "python"}
    facts = {"board": board.version, "command": command} | {title: latest.get(key, "") for title, key in made.items()}
    facts |= latest.get("packages", {})
    figure = pareto(board)
    # In a script element only "<" could end it; JSON reads the escaped character as the same.
    data = json.dumps(figure, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    template = resources.files("benchmarks.report").joinpath("page.html").read_text(encoding="utf-8")
    page = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    ).from_string(template)
    parts = {"board": board, "columns": columns(board), "facts": facts, "figure": figure, "data": data}
    write_text(path, page.render(**parts, plotly=get_plotlyjs()))
