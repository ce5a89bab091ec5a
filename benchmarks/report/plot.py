"""Matplotlib figures for the commands: the trace of one seed, and panels of lines.

A path's ending gives the format.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from benchmarks.analysis.linear import LinearLoop
from benchmarks.files import replacing
from benchmarks.run.rollout import Trace
from fbl_gym.arm import Array

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
"""Okabe and Ito's colours, which colour-blind readers tell apart."""


@dataclass(frozen=True)
class Line:
    """A line of a panel.

    Attributes:
        x, y: points [n].
        color: None for the next of `COLORS`.
        style: Matplotlib's line style, such as "-", "--" or ":".
        low, high: edges of a band [n], or None.
    """

    x: Array
    y: Array
    label: str
    color: str | None = None
    style: str = "-"
    low: Array | None = None
    high: Array | None = None


@dataclass(frozen=True)
class Panel:
    """A pair of axes.

    Attributes:
        x, y: labels of the axes, with their units.
        scales: of each axis, "linear" or "log".
        bounds: of the y axis; None to fit the lines.
        marks: horizontal lines, each with its height and its label.
    """

    title: str
    x: str
    y: str
    lines: tuple[Line, ...]
    scales: tuple[str, str] = ("linear", "linear")
    bounds: tuple[float, float] | None = None
    marks: tuple[tuple[float, str], ...] = ()


def plot_lines(title: str, panels: Sequence[Panel], path: Path) -> None:
    """Draw panels side by side, two in a row, with one legend where all have the same labels."""
    rows, columns = -(-len(panels) // 2), min(len(panels), 2)
    figure = Figure(figsize=(5.5 * columns + 1, 3.6 * rows + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False)
    shared = len(panels) > 1 and len({tuple(line.label for line in panel.lines) for panel in panels}) == 1
    for axes, panel in zip(grid.ravel(), panels, strict=False):
        _draw(axes, panel)
        if not shared:
            axes.legend(fontsize="small")
    for axes in grid.ravel()[len(panels) :]:
        axes.set_visible(False)
    if shared:
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4), frameon=False)
    _save(figure, title, path)


def plot_maps(
    title: str,
    names: Sequence[str],
    values: Sequence[Sequence[float]],
    maps: Mapping[str, Array],
    path: Path,
) -> None:
    """Draw numbers over two options as maps with one colour scale, two in a row.

    Args:
        title: of the figure.
        names: of the options, on the x and the y axis.
        values: of each option.
        maps: the numbers [number of x values, number of y values], by the title of each map.
        path: of the figure.
    """
    rows, columns = -(-len(maps) // 2), min(len(maps), 2)
    figure = Figure(figsize=(5.0 * columns + 1, 3.8 * rows + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False)
    norm = LogNorm(*np.nanquantile(np.array(list(maps.values())), (0.0, 1.0)))
    for axes, (label, numbers) in zip(grid.ravel(), maps.items(), strict=False):
        image = axes.imshow(numbers.T, origin="lower", norm=norm, cmap="cividis", aspect="auto")
        axes.set(title=label, xlabel=names[0], ylabel=names[1])
        axes.set_xticks(range(len(values[0])), [f"{value:g}" for value in values[0]], rotation=45)
        axes.set_yticks(range(len(values[1])), [f"{value:g}" for value in values[1]])
    for axes in grid.ravel()[len(maps) :]:
        axes.set_visible(False)
    figure.colorbar(image, ax=grid, label="error [%]")
    _save(figure, title, path)


def _draw(axes: Axes, panel: Panel) -> None:
    for i, line in enumerate(panel.lines):
        color = line.color or COLORS[i % len(COLORS)]
        axes.plot(line.x, line.y, color=color, linestyle=line.style, label=line.label)
        if line.low is not None and line.high is not None:
            axes.fill_between(line.x, line.low, line.high, color=color, alpha=0.15, linewidth=0)
    for height, label in panel.marks:
        axes.axhline(height, color="0.4", linestyle="--", linewidth=1.0)
        axes.annotate(
            label, (1.0, height), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize="small"
        )
    axes.set(title=panel.title, xlabel=panel.x, ylabel=panel.y, xscale=panel.scales[0], yscale=panel.scales[1])
    if panel.bounds is not None:
        axes.set_ylim(panel.bounds)
    axes.margins(x=0)
    axes.grid(alpha=0.25)


def plot_trace(trace: Trace, title: str, path: Path, lane: int = 0) -> None:
    """Draw reference and motion, tracking error, torque and disturbance of both joints."""
    end = int(trace.alive[:, lane].sum())
    t = trace.time[:end]
    figure = Figure(figsize=(11, 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 2, sharex=True)
    limit = None if trace.scenario.actuator.torque_limit is None else np.array(trace.scenario.actuator.torque_limit)
    signals = (trace.reference, trace.position, trace.torque, trace.disturbance)
    for joint in (0, 1):
        reference, position, torque, disturbance = (signal[:end, lane, joint] for signal in signals)
        first, second, third, fourth = axes[:, joint]
        first.set(title=f"joint {joint + 1}", ylabel="angle [rad]")
        first.plot(t, reference, color="tab:blue", label="reference")
        first.plot(t, position, color="tab:red", linestyle="--", label="motion")
        second.set(ylabel="error [mrad]")
        second.plot(t, 1e3 * (reference - position), color="tab:purple")
        second.axhline(0.0, color="0.7", linewidth=0.8)
        third.set(ylabel="torque [N m]")
        third.step(t, torque, color="tab:orange", where="pre")
        if limit is not None and np.abs(torque).max() > 0.8 * limit[joint]:
            for bound in (-limit[joint], limit[joint]):
                third.axhline(bound, color="0.5", linestyle=":", linewidth=1.0)
        fourth.set(ylabel="disturbance [N m]", xlabel="time [s]")
        fourth.step(t, disturbance, color="tab:green", where="post")
        for axis in axes[:, joint]:
            axis.grid(alpha=0.25)
            axis.margins(x=0)
    ended = "" if end == len(trace.time) else f", diverged at {t[-1]:.2f} s"
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    _save(figure, f"{title}, seed {trace.seeds[lane]}{ended}", path)


def plot_comparison(traces: Mapping[str, Trace], title: str, path: Path, lane: int = 0) -> None:
    """Draw the reference and the tracking errors of several policies on one seed."""
    first = next(iter(traces.values()))

    def errors(joint: int) -> tuple[Line, ...]:
        lines = []
        for policy, trace in traces.items():
            error = 1e3 * (trace.reference[:, lane, joint] - trace.position[:, lane, joint])
            lines.append(Line(trace.time, np.where(trace.alive[:, lane], error, np.nan), policy))
        return tuple(lines)

    panels = tuple(Panel(f"joint {joint + 1}", "time [s]", "tracking error [mrad]", errors(joint)) for joint in (0, 1))
    plot_lines(f"{title}, seed {first.seeds[lane]}", panels, path)


def _save(figure: Figure, title: str, path: Path) -> None:
    figure.suptitle(title, x=0.01, horizontalalignment="left")
    # TrueType fonts in a PDF: text stays text, and publishers accept it.
    with rc_context({"pdf.fonttype": 42}), replacing(path) as beside:
        figure.savefig(beside, dpi=100)


def plot_loops(loops: Mapping[str, LinearLoop], title: str, path: Path) -> None:
    """Draw |L| and |S| of each joint over the frequency, for loops by their labels."""
    responses = [{name: loop.response(joint) for name, loop in loops.items()} for joint in (0, 1)]
    panels = []
    for label, size in (("loop transfer |L|", lambda x: np.abs(x)), ("sensitivity |S|", lambda x: np.abs(1 / (1 + x)))):
        for joint in (0, 1):
            lines = tuple(Line(w, size(transfer), name) for name, (w, transfer) in responses[joint].items())
            panels.append(
                Panel(f"joint {joint + 1}", "frequency [rad/s]", label, lines, ("log", "log"), marks=((1.0, ""),))
            )
    plot_lines(title, panels, path)
