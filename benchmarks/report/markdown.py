"""Tables in Markdown, for the README and the documentation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from benchmarks.analysis.board import UNSCORED, Board
from benchmarks.analysis.generalization import RangeErrors
from benchmarks.analysis.statistics import Estimate
from benchmarks.paper.claim import Claim


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table, one line a row."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def claims(found: Iterable[Claim]) -> str:
    """The paper's claims: what it says, what was measured under which choices, and the verdict."""
    header = ("figure", "claim", "paper", "measured", "verdict", "under which choices", "seeds")
    rows = ((c.figure, c.claim, c.paper, c.measured, c.verdict, c.reading, c.seed) for c in found)
    return table(header, rows)


BEGIN, END = "<!-- leaderboard -->", "<!-- /leaderboard -->"
"""Between these lines of a file stands the leaderboard."""


def leaderboard(
    board: Board, splits: Mapping[str, RangeErrors] = MappingProxyType({}), *, families: bool = True
) -> str:
    """The board, best first, with the intervals of score and rank.

    Args:
        board: what the table says.
        splits: of the uncertainty radius: a column each, the error with its interval and what diverged, if anything did.
        families: whether each family of scenarios has a column with its error.
    """
    shown = board.families if families else ()
    header = ["policy", "told", "rank", "score", "error %", "failed %", "us/decision", *shown, *splits]
    errors = [board.family_errors[family].value for family in shown]
    ranks = dict(zip(board.ranked, zip(board.rank.low, board.rank.high, strict=True), strict=True))
    rows = []
    for i in board.order:
        rank = "{:.0f}–{:.0f}".format(*ranks[i]) if i in ranks else "not ranked"
        score = "" if board.score is None else f"{_with_interval(board.score, i, 1)}"
        rows.append(
            [
                f"`{board.policies[i]}`", board.specs[i].access, rank, score, _with_interval(board.error, i, 2),
                f"{100 * board.failures.value[i]:.2g}", f"{board.decision_us[i]:.2g}", *(f"{x[i]:.3g}" for x in errors),
                *(_in_split(found, i) for found in splits.values()),
            ]
        )  # fmt: skip
    return table(header, rows) + (f"\n{UNSCORED}\n" if board.score is None else "")


def _with_interval(estimate: Estimate, i: int, digits: int) -> str:
    value, low, high = estimate.value[i], estimate.low[i], estimate.high[i]
    return f"{value:.{digits}f} ({low:.{digits}f}–{high:.{digits}f})"


def _in_split(split: RangeErrors, i: int) -> str:
    share = split.diverged[i]
    return _with_interval(split.error, i, 3) + (f", {100 * share:.2g} % diverged" if share else "")


def replace_between(text: str, table: str) -> str:
    """A file's text with another leaderboard between its markers."""
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the file must have the lines {BEGIN} and {END}, between which the table stands")
    return f"{head}{BEGIN}\n{table}{END}{tail}"
