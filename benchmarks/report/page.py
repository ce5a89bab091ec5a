"""The leaderboard as one HTML file that needs no network: `page.html` with its data and Plotly."""

import html
import json
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

from benchmarks.analysis.board import Board
from benchmarks.files import write_text
from benchmarks.report.columns import Column, Value, columns
from benchmarks.report.figures import pareto
from benchmarks.run.store import Result

_FIGURE = (
    '<section id="pareto"><h2>Error against effort</h2><p>{}</p><figure class="card"><div id="plot" role="img" '
    'aria-label="Error against effort"></div></figure></section>'
)

_POLICY = ' class="policy"'
"""The attribute of the cells that stay in place while the board scrolls sideways."""


def write_page(path: Path, board: Board, results: Sequence[Result], command: str) -> None:
    """Write the page of a board to a file.

    Args:
        path: of the file.
        board: of the page.
        results: those of the board's cells, for their provenance.
        command: that wrote the page.
    """
    from plotly.offline import get_plotlyjs  # the extra `analysis`

    latest = max((result.provenance for result in results), key=lambda made: made.get("time", ""))
    facts = {
        "board": board.version,
        "command": command,
        "computed with": latest.get("command", ""),
        "on": latest.get("machine", ""),
        "at": latest.get("time", ""),
        "Python": latest.get("python", ""),
        **latest.get("packages", {}),
    }
    entries, figure, plotly = columns(board), pareto(board), get_plotlyjs()
    parts = {
        "SUMMARY": html.escape(_summary(board)),
        "LINK": '<a href="#pareto">Error and effort</a>' if figure else "",
        "FILTERS": "".join(_filter(column) for column in entries if column.is_choice),
        "TABLE": _table(board, entries),
        "MEANINGS": _definitions({column.title: column.meaning for column in entries}),
        "FIGURE": _FIGURE.format(html.escape(figure["description"])) if figure else "",
        "FACTS": _definitions(facts),
        "PLOTLY": plotly,
        "SIZE": f"{len(plotly.encode()) / 1e6:.1f}",
        # In a script element only "<" could end it; JSON reads the escaped character as the same.
        "DATA": json.dumps(figure, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
    }
    template = resources.files("benchmarks.report").joinpath("page.html").read_text(encoding="utf-8")
    write_text(path, re.sub(r"\{\{ (\w+) \}\}", lambda match: parts[match[1]], template))


def _summary(board: Board) -> str:
    first, *others = (f"{tier} ({len(places)} scenarios)" for tier, places in board.tiers.items())
    tiers = f"Rank, score, error and effort are of the tier {first}; beside it: {', '.join(others)}. " if others else ""
    return (
        f"{len(board.policies)} policies on {len(board.scenarios)} scenarios with the same {len(board.seeds)} seeds. "
        f"{tiers}Intervals cover 95 %, by a bootstrap over the seeds, and over the training seeds of agents."
        + "".join(f" {remark.removesuffix('.')}." for remark in board.remarks)
    )


def _definitions(texts: Mapping[str, str]) -> str:
    return "".join(f"<dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd>" for name, text in texts.items())


def _table(board: Board, entries: Sequence[Column]) -> str:
    """Return the content of the board's table element; cells carry their values for sorting."""
    heads = "".join(
        f'<th scope="col"{_POLICY if column.key == "policy" else ""} aria-sort="none"><button type="button" '
        f'data-sort="{html.escape(column.key)}" data-first="{-column.best or 1}" title="{html.escape(column.meaning)}">'
        f"{html.escape(column.title)}</button></th>"
        for column in entries
    )
    best = {column.key: column.leader(board.ranked) for column in entries}
    rows = []
    for i in board.order:
        name, summary = board.policies[i], board.specs[i].summary
        choices = " ".join(f'data-{c.key}="{html.escape(str(c.values[i]))}"' for c in entries if c.is_choice)
        words = html.escape(f"{name} {summary}".lower())
        rows.append(
            f'<tr data-policy="{html.escape(name)}" data-words="{words}" {choices} '
            f'class="{"" if i in board.ranked else "unranked"}">'
            + "".join(_cell(column, i, best[column.key], summary) for column in entries)
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
