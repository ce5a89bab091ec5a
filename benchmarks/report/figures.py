"""The page's figures, as plain data in Plotly's format.

The `legendgroup` of a Plotly trace is its policy, so that the page can hide a policy in every
figure.
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from benchmarks.analysis import statistics
from benchmarks.analysis.board import MOST_DIVERGED, Board
from benchmarks.analysis.statistics import Estimate
from fbl_gym.model.arm import Array

Figure: TypeAlias = dict[str, Any]
"""A title, a description, and Plotly's `data` and `layout`."""

COLORS = ("#2a86c8", "#dd6a20", "#1c9a74", "#c468a0", "#6d7ff0", "#b98710", "#8a8a8a")
"""Colours that colour-blind readers tell apart, on light and on dark paper."""

MARKS = {"circle": "●", "square": "■", "diamond": "◆", "triangle-up": "▲", "x": "✖", "cross": "✚", "star": "★"}
"""Plotly's name and the character of each mark."""

DASHES = {"solid": "solid", "dash": "dashed", "dot": "dotted", "dashdot": "double"}
"""Plotly's name and CSS's nearest border style of each dash."""

_TICKS = [digit * 10.0**decade for decade in range(-4, 6) for digit in (1, 2, 5)]
LOG = {"type": "log", "tickvals": _TICKS, "ticktext": [f"{x:,.6g}" for x in _TICKS]}
"""A logarithmic axis with whole numbers at 1, 2 and 5 of each decade."""

FEW = 8
"""A curve of at most so many points has marks and bars; a longer one has a band."""


def style(row: int) -> tuple[str, str, str]:
    """Return colour, mark and dash of a row of the board, different for 28 places."""
    return COLORS[row % 7], list(MARKS)[row % 7], list(DASHES)[row // 7 % 4]


def _figure(title: str, description: str, data: list[Figure], x: str, y: str, **layout: Any) -> Figure:
    axes = {"xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}}}
    for name, more in layout.items():
        axes[name] = {**axes.get(name, {}), **more}
    return {"title": title, "description": description, "data": data, "layout": axes}


def _curves(board: Board, x: Sequence[float] | Array, estimate: Estimate) -> list[Figure]:
    """Return the curve of every policy of a board with its intervals, as bars or as a band."""
    data = []
    for row, i in enumerate(board.order):
        policy, (color, mark, dash) = board.policies[i], style(row)
        value, low, high = (np.asarray(y)[i] for y in (estimate.value, estimate.low, estimate.high))
        shared: Figure = {"type": "scatter", "legendgroup": policy, "x": list(x)}
        line = {
            **shared, "name": policy, "y": value, "line": {"color": color, "dash": dash, "width": 2},
            "marker": {"color": color, "symbol": mark, "size": 7}, "customdata": np.stack([low, high], axis=-1),
            "hovertemplate": "%{fullData.name}: %{y:.3g} (%{customdata[0]:.3g}–%{customdata[1]:.3g})<extra></extra>",
        }  # fmt: skip
        if len(x) <= FEW:
            bars = {"array": high - value, "arrayminus": value - low, "color": color, "thickness": 1.2, "width": 3}
            data.append({**line, "mode": "lines+markers", "error_y": {"type": "data", "symmetric": False, **bars}})
        else:
            edge = {**shared, "mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
            band = {**edge, "y": high, "fill": "tonexty", "fillcolor": f"{color}2b"}
            data += [{**edge, "y": low}, band, {**line, "mode": "lines"}]
    return data


def degradation(board: Board) -> list[Figure]:
    """Return error against severity, a figure for each arm and family."""
    axes = {"xaxis": {"dtick": 1}, "yaxis": LOG}
    return [
        _figure(title, text, _curves(board, severities, estimate), "severity", "tracking error [%]", **axes)
        for title, (text, severities, estimate) in board.degradation.items()
    ]


def pareto(board: Board) -> list[Figure]:
    """Return error against effort of the ranked policies, and the front of the best of them."""
    if board.effort is None:
        return []
    effort = board.effort
    ranked = [i for i in board.ranked if effort[i] > 0 and board.diverged.value[i] <= MOST_DIVERGED]
    points = sorted((board.error.value[i], effort[i], i) for i in ranked)
    front = [point for k, point in enumerate(points) if all(point[1] < other[1] for other in points[:k])]
    line = {
        "type": "scatter", "mode": "lines", "x": [x for x, _, _ in front], "y": [y for _, y, _ in front],
        "line": {"color": COLORS[-1], "width": 1.5, "dash": "dot", "shape": "hv"}, "hoverinfo": "skip",
    }  # fmt: skip
    named = [i for *_, i in sorted(points, key=lambda point: point not in front)]  # the front first
    data = [line, *(_points(board, board.error.value, effort, named) if named else [])]
    text = (
        "Left is a smaller error, down is less strain on the drives. No policy is better in both than those on the line. "
        "The others are named where there is room. "
        f"Policies are left out if more than {100 * MOST_DIVERGED:g} % of their runs diverged."
    )
    figure = _figure("Error against effort", text, data, "error [%]", "effort [of the ceiling's]", xaxis=LOG, yaxis=LOG)
    return [{**figure, "height": 520, "points": True}]


def _points(board: Board, x: Array, y: Array, chosen: Sequence[int]) -> list[Figure]:
    """Return a mark and a name for each policy; the page hides a name that overlaps another."""
    row = {i: k for k, i in enumerate(board.order)}
    ends = {int(np.argmin(x[chosen])): "top right", int(np.argmax(x[chosen])): "top left"}
    return [
        {
            "type": "scatter", "name": board.policies[i], "legendgroup": board.policies[i], "x": [x[i]], "y": [y[i]],
            "mode": "markers+text", "text": [board.policies[i]], "textposition": ends.get(k, "top center"),
            "marker": {"color": style(row[i])[0], "symbol": style(row[i])[1], "size": 9}, "cliponaxis": False,
            "hovertemplate": "%{fullData.name}: %{x:.3g}, %{y:.3g}<extra></extra>",
        }
        for k, i in enumerate(chosen)
    ]  # fmt: skip


def profiles(board: Board) -> list[Figure]:
    """Return the performance profile: the share of runs with at most some error."""
    tau = np.geomspace(0.05, 100.0, 60)
    estimate = statistics.interval(board.average(statistics.profile(board.errors, tau, board.counts)))
    data = _curves(board, tau, estimate)
    text = "Share of all runs with a tracking error of at most the value on the x axis."
    return [_figure("All scenarios", text, data, "tracking error [%]", "share of runs", xaxis=LOG)]
