"""The leaderboard as one HTML file that needs no network: `page.html` with its data and Plotly.

Its figure is plain data in Plotly's format.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.analysis.board import Board
from benchmarks.files import write_text
from benchmarks.report.columns import columns
from benchmarks.run.store import Result

#: Colours that colour-blind readers tell apart, on light and on dark paper.
COLORS = ("#2a86c8", "#dd6a20", "#1c9a74", "#c468a0", "#6d7ff0", "#b98710", "#8a8a8a")

#: Plotly's names of marks; with the colours, those of 49 policies differ.
MARKS = ("circle", "square", "diamond", "triangle-up", "x", "cross", "star")

#: Largest share of lost runs of a policy in the figure: a run that ended needs no torque.
MOST_LOST = 0.1

_TICKS = [digit * 10.0**decade for decade in range(-4, 6) for digit in (1, 2, 5)]
#: A logarithmic axis with whole numbers at 1, 2 and 5 of each decade.
LOG = {"type": "log", "tickvals": _TICKS, "ticktext": [f"{x:,.6g}" for x in _TICKS]}


def pareto(board: Board) -> dict[str, Any] | None:
    """Return error against effort of the ranked policies, and the front of the best of them.

    It has a description, and Plotly's `data` and `layout`.

    None: no policy has an effort. The name of a Plotly trace is its policy, so that the page can
    hide the policies that its filters hide.
    """
    effort, error, lost = board.effort, board.error().value, board.lost.value
    points = sorted((error[i], effort[i], i) for i in board.ranked if effort[i] > 0 and lost[i] <= MOST_LOST)
    if not points:
        return None
    front = [point for k, point in enumerate(points) if all(point[1] < other[1] for other in points[:k])]
    line = {
        "type": "scatter", "mode": "lines", "x": [x for x, _, _ in front], "y": [y for _, y, _ in front],
        "line": {"color": COLORS[-1], "width": 1.5, "dash": "dot", "shape": "hv"}, "hoverinfo": "skip",
    }  # fmt: skip
    chosen = [i for *_, i in sorted(points, key=lambda point: point not in front)]  # the front first
    row = {i: k for k, i in enumerate(board.order)}
    ends = {points[0][2]: "top right", points[-1][2]: "top left"}
    marks = [
        {
            "type": "scatter", "name": board.policies[i], "x": [error[i]], "y": [effort[i]], "mode": "markers+text",
            "text": [board.policies[i]], "textposition": ends.get(i, "top center"), "cliponaxis": False,
            "marker": {"color": COLORS[row[i] % 7], "symbol": MARKS[row[i] // 7 % 7], "size": 9},
            "hovertemplate": "%{fullData.name}: %{x:.3g}, %{y:.3g}<extra></extra>",
        }
        for i in chosen
    ]  # fmt: skip
    text = (
        "Left is a smaller error, down is less strain on the drives. No policy is better in both than those on the line. "
        "The others are named where there is room. "
        f"Policies are left out if more than {100 * MOST_LOST:g} % of their runs diverged."
    )
    axes = {"xaxis": {"title": {"text": "error [%]"}}, "yaxis": {"title": {"text": "effort [× oracle]"}}}
    return {"description": text, "data": [line, *marks], "layout": {name: axis | LOG for name, axis in axes.items()}}


def write_page(path: Path, board: Board, results: Sequence[Result], command: str) -> None:
    """Write the page of a board to a file. The template escapes every text.

    Args:
        path: of the file.
        board: of the page.
        results: those of the board's cells, for their provenance.
        command: that wrote the page.
    """
    from plotly.offline import get_plotlyjs  # the extra `analysis`

    latest = max((result.provenance for result in results), key=lambda origin: origin.get("time", ""))
    made = {"computed with": "command", "on": "machine", "at": "time", "Python": "python"}
    facts = {"board": board.version, "command": command} | {title: latest.get(key, "") for title, key in made.items()}
    facts |= latest.get("packages", {})
    figure = pareto(board)
    # In a script element only "<" could end it; JSON reads the escaped character as the same.
    data = json.dumps(figure, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    parts = {"board": board, "columns": columns(board), "facts": facts, "figure": figure, "data": data}
    write_text(path, render("page.html", **parts, plotly=get_plotlyjs()))


def render(name: str, **parts: Any) -> str:
    """Return a template of this folder with its parts, which one of HTML escapes."""
    from jinja2 import Environment, StrictUndefined  # the extra `analysis`

    environment = Environment(
        autoescape=name.endswith(".html"), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    return environment.from_string(Path(__file__).with_name(name).read_text(encoding="utf-8")).render(**parts)
