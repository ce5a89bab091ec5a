"""The leaderboard as one HTML file that needs no network: `page.html` with its data and Plotly.

`contents` returns the page's content as plain data, and `write_page` writes it.
"""

import html
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.analysis.board import Board
from benchmarks.files import write_text
from benchmarks.report import figures
from benchmarks.report.columns import Column, Value, columns
from benchmarks.report.figures import DASHES, MARKS, style
from benchmarks.run.store import Result

DIGITS = 5
"""Significant digits of the numbers in the figures."""

_SECTIONS: dict[str, tuple[Callable[[Board], list[figures.Figure]], str, str]] = {
    "pareto": (figures.pareto, "Error and effort", ""),
    "degradation": (
        figures.degradation, "Degradation",
        "Error against severity, one family of uncertainty each. Severity 0 is the nominal arm. Bars are intervals.",
    ),
    "profiles": (
        figures.profiles, "Performance profiles",
        "The share of runs with at most some error: a better policy is further up and left. Bands are pointwise intervals.",
    ),
}  # fmt: skip
"""The figures of each section, its title, and the text below the title."""


_POLICY = ' class="policy"'
"""The attribute of the cells that stay in place while the board scrolls sideways."""


def contents(board: Board, results: Sequence[Result], command: str) -> Any:
    """Return the page's content, by name.

    `policies` and `summaries` are in the order of the columns' entries, `order` has the best policy
    first, and `ranked` has the policies with a rank. `figures` has a list for each section.

    Args:
        board: of the page.
        results: those of the board's cells, for their provenance.
        command: that wrote the page.
    """
    latest = max(results, key=lambda result: result.provenance.get("time", ""))
    return {
        "title": "fbl-gym leaderboard",
        "summary": (
            f"{len(board.policies)} policies on {len(board.scenarios)} scenarios with the same {len(board.seeds)} seeds. "
            f"{_tiers(board)}"
            "Intervals cover 95 %, by a bootstrap over the seeds, and over the training seeds of agents."
            + "".join(f" {remark.removesuffix('.')}." for remark in board.remarks)
        ),
        "facts": {
            "board": board.version,
            "command": command,
            "computed with": latest.provenance.get("command", ""),
            "on": latest.provenance.get("machine", ""),
            "at": latest.provenance.get("time", ""),
            "Python": latest.provenance.get("python", ""),
            **latest.provenance.get("packages", {}),
        },
        "policies": list(board.policies),
        "summaries": [spec.summary for spec in board.specs],
        "order": [board.policies[i] for i in board.order],
        "ranked": [board.policies[i] for i in board.ranked],
        "columns": columns(board),
        "figures": {name: draw(board) for name, (draw, _, _) in _SECTIONS.items()},
    }


def _tiers(board: Board) -> str:
    first, *others = (f"{tier} ({len(places)} scenarios)" for tier, places in board.tiers.items())
    return f"Rank, score, error and effort are of the tier {first}; beside it: {', '.join(others)}. " if others else ""


def write_page(path: Path, page: Mapping[str, Any]) -> None:
    """Write the page of some contents to a file; a section without figures is left out."""
    from plotly.offline import get_plotlyjs  # the extra `analysis`

    text = html.escape
    drawn = {name: part for name, part in page["figures"].items() if part}
    parts = {
        "TITLE": text(page["title"]),
        "SUMMARY": text(page["summary"]),
        "LINKS": "".join(f'<a href="#{name}">{_SECTIONS[name][1]}</a>' for name in drawn),
        "FILTERS": "".join(_filter(column) for column in page["columns"] if column.is_choice),
        "TABLE": _table(page),
        "MEANINGS": "".join(f"<dt>{text(c.title)}</dt><dd>{text(c.meaning)}</dd>" for c in page["columns"]),
        "CHIPS": "".join(_chip(name, row) for row, name in enumerate(page["order"])),
        "SECTIONS": "".join(
            f'<section id="{name}"><h2>{_SECTIONS[name][1]}</h2><p>{_SECTIONS[name][2]}</p><div class="grid"></div></section>'
            for name in drawn
        ),
        "FACTS": "".join(f"<dt>{text(name)}</dt><dd>{text(str(value))}</dd>" for name, value in page["facts"].items()),
        "PLOTLY": get_plotlyjs(),
        # In a script element only "<" could end it; JSON reads the escaped character as the same.
        "DATA": json.dumps(_plain(drawn), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
    }
    template = resources.files("benchmarks.report").joinpath("page.html").read_text(encoding="utf-8")
    write_text(path, re.sub(r"\{\{ (\w+) \}\}", lambda match: parts[match[1]], template))


def _table(page: Mapping[str, Any]) -> str:
    """Return the content of the board's table element; cells carry their values for sorting."""
    heads = "".join(
        f'<th scope="col"{_POLICY if column.key == "policy" else ""} aria-sort="none"><button type="button" '
        f'data-sort="{html.escape(column.key)}" data-first="{-column.best or 1}" title="{html.escape(column.meaning)}">'
        f"{html.escape(column.title)}</button></th>"
        for column in page["columns"]
    )
    ranked = [page["policies"].index(name) for name in page["ranked"]]
    best = {column.key: column.leader(ranked) for column in page["columns"]}
    rows = []
    for name in page["order"]:
        i = page["policies"].index(name)
        choices = " ".join(f'data-{c.key}="{html.escape(str(c.values[i]))}"' for c in page["columns"] if c.is_choice)
        words = html.escape(f"{name} {page['summaries'][i]}".lower())
        rows.append(
            f'<tr data-policy="{html.escape(name)}" data-words="{words}" {choices} '
            f'class="{"" if name in page["ranked"] else "unranked"}">'
            + "".join(_cell(column, i, best[column.key], page["summaries"][i]) for column in page["columns"])
            + "</tr>"
        )
    return f"<thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody>"


def _cell(column: Column, i: int, best: Value, summary: str) -> str:
    value = column.values[i]
    small = [column.interval(i, " … "), column.notes[i] if column.notes else ""]
    notes = "".join(f"<small>{html.escape(note)}</small>" for note in small if note)
    if column.key == "policy":
        breaking = re.sub(r"([+@])", r"<wbr>\1", html.escape(column.text(i)))
        return f'<th scope="row"{_POLICY} title="{html.escape(summary)}">{breaking}{notes}</th>'
    kind = "best" if best is not None and value == best else "text" if isinstance(value, str) else ""
    stored = "" if value is None else html.escape(str(value))
    return f'<td data-value="{stored}" class="{kind}">{html.escape(column.text(i))}{notes}</td>'


def _filter(column: Column) -> str:
    values = list(dict.fromkeys(str(value) for value in column.values))
    options = "".join(f"<option>{html.escape(value)}</option>" for value in ["any", *values])
    hidden = " hidden" if len(values) < 2 else ""
    return f'<label{hidden}>{html.escape(column.title)}<select id="filter-{column.key}">{options}</select></label>'


def _chip(name: str, row: int) -> str:
    color, mark, dash = style(row)
    return (
        f'<label style="border-bottom: 3px {DASHES[dash]} {color}"><input type="checkbox" checked '
        f'data-chip="{html.escape(name)}"><span style="color: {color}">{MARKS[mark]}</span>{html.escape(name)}</label>'
    )


def _plain(value: Any) -> Any:
    """Return JSON's types, with few digits; NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
