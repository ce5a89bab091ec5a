"""Matplotlib figures in one style, as wide as one or two columns of a journal.

A path's ending gives the format. A figure's title is stored in the file, and drawn unless a width
is given: a journal has captions.
"""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.analysis.board import Board
from benchmarks.files import replacing
from benchmarks.run.metrics import errors
from benchmarks.run.rollout import Trace
from fbl_gym.model.arm import Array

#: Okabe and Ito's colours, which colour-blind readers tell apart.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")

MARKERS = "osD^vx+"
#: Markers and dashes tell lines apart in grey print: those of 28 lines differ.
DASHES = ("-", "--", "-.", ":")

#: Width of a figure over one or two columns of the IEEE's journals [in].
WIDTHS = {1: 3.5, 2: 7.16}

#: Matplotlib's settings for every figure, as a style sheet.
STYLE = Path(__file__).with_name("figures.mplstyle")

#: A band's lower edge, its line and its upper edge, as quantiles of the seeds.
QUANTILES = (0.1, 0.5, 0.9)


@dataclass(frozen=True)
class Line:
    """A line of a panel.

    Attributes:
        x, y: points [n].
        label: of the legend, which leaves out one that begins with "_".
        color: None for the next of `COLORS`, with the next marker.
        style: Matplotlib's line style, such as "-"; None for the next of `DASHES`.
        low, high: edges of a band [n], or None.
    """

    x: Array
    y: Array
    label: str
    color: str | None = None
    style: str | None = None
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


@contextmanager
def _figure(title: str, path: Path, size: tuple[float, float]) -> Iterator[Any]:
    """Yield a Matplotlib figure of some size [in], and write it to a path at the end."""
    from matplotlib import rc_context  # a figure alone needs it
    from matplotlib.figure import Figure

    with rc_context(fname=STYLE), replacing(path) as beside:
        figure = Figure(figsize=size, layout="constrained")
        yield figure
        figure.savefig(beside, metadata={"Title": title} | ({"Date": None} if beside.suffix == ".svg" else {}))


def plot_lines(
    title: str, panels: Sequence[Panel], path: Path, width: int | None = None, across: int | None = None
) -> None:
    """Draw panels with one legend, that of the first.

    Args:
        title: of the figure.
        panels: from left to right, row by row.
        path: of the figure.
        width: columns of the page that the figure spans, 1 or 2; None: 2, with the title drawn.
        across: panels in a row; None: as many as columns.
    """
    columns = width or 2
    across = min(across or columns, len(panels))
    rows = -(-len(panels) // across)
    labels = [line.label for line in panels[0].lines if line.label != "_"]
    in_row = min(max(1, int(WIDTHS[columns] / (0.065 * max(map(len, labels)) + 0.5))), len(labels))
    height = rows * (2.2 if rows == 1 else 1.5) + 0.16 * (-(-len(labels) // in_row) + (width is None))
    same_x = len({(panel.x, line.x[0], line.x[-1]) for panel in panels for line in panel.lines}) == 1
    with _figure(title, path, (WIDTHS[columns], height)) as figure:
        shown = title if width is None else None
        grid = figure.subplots(rows, across, squeeze=False, sharex=same_x)
        for i, (axes, panel) in enumerate(zip(grid.ravel(), panels, strict=False)):
            _draw(axes, panel)
            if not (same_x and i + across < len(panels)):
                axes.set_xlabel(panel.x)
                axes.tick_params(labelbottom=True)
        for axes in grid.ravel()[len(panels) :]:
            axes.set_visible(False)
        if len(labels) > 1:
            lines = grid[0, 0].get_legend_handles_labels()
            figure.legend(*lines, loc="outside upper center", ncols=in_row, title=shown)
        elif shown:
            figure.suptitle(shown, fontsize="medium")


def _draw(axes: Any, panel: Panel) -> None:
    axes.set(title=panel.title, ylabel=panel.y, xscale=panel.scales[0], yscale=panel.scales[1])
    for i, line in enumerate(panel.lines):
        color = line.color or COLORS[i % len(COLORS)]
        many = len(line.x) > 24
        axes.plot(
            line.x, line.y, color=color, linestyle=line.style or DASHES[i % len(DASHES)], label=_shown(line.label),
            marker=None if line.color else MARKERS[i % len(MARKERS)],
            markevery=(i * len(line.x) // 40 % (len(line.x) // 6), len(line.x) // 6) if many else None,
        )  # fmt: skip
        if line.low is not None and line.high is not None:
            axes.fill_between(line.x, line.low, line.high, color=color, alpha=0.15, linewidth=0)
    for height, label in panel.marks:
        axes.axhline(height, color="0.4", linestyle="--", linewidth=0.8)
        axes.annotate(label, (1.0, height), xycoords=("axes fraction", "data"), ha="right", va="bottom")
    if panel.bounds is not None:
        axes.set_ylim(panel.bounds)
    for axis, scale in zip((axes.xaxis, axes.yaxis), panel.scales, strict=True):
        if scale == "log":
            _label_plainly(axis)


def _shown(label: str) -> str:
    """Return a label that matplotlib shows as it is; `_` alone has no entry in the legend."""
    return " " * (label[1:] != "" and label[0] == "_") + label.replace("$", r"\$")


def _label_plainly(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers such as 0.6, fewer of them in more decades."""
    from matplotlib.ticker import LogLocator, NullFormatter  # a figure alone needs it

    low, high = axis.get_view_interval()
    decades = np.log10(high / low)
    digits = (1.0, 2.0, 3.0, 5.0) if decades < 1.5 else (1.0, 3.0) if decades < 3 else (1.0,)
    axis.set_major_locator(LogLocator(subs=digits))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def band(x: Array, signal: Array, label: str) -> Line:
    """Return the median over the seeds with its band, or the line of a single seed.

    Args:
        x: points [k].
        signal: of n seeds [k x n]; NaN where a seed has no value.
        label: of the line.
    """
    if signal.shape[-1] == 1:
        return Line(x, signal[:, 0], label)
    edges, lacks = np.empty((3, len(x))), np.isnan(signal).any(axis=-1)
    edges[:, ~lacks] = np.quantile(signal[~lacks], QUANTILES, axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no seed has a value
        edges[:, lacks] = np.nanquantile(signal[lacks], QUANTILES, axis=-1)  # 100 times as slow
    return Line(x, edges[1], label, low=edges[0], high=edges[2])


def caption(seeds: int) -> str:
    """Return the words that the caption of a figure over some seeds needs."""
    return "seed 0" if seeds == 1 else f"medians and bands from 10 to 90 % of {seeds} seeds"


def plot_trace(trace: Trace, title: str, path: Path, width: int | None = None) -> None:
    """Draw angle, tracking error, torque and disturbance over the time, over each other.

    Several seeds give medians and bands, of the runs that have not diverged. The angles are those
    of the first seed if the seeds have different references.
    """
    same = np.ptp(trace.reference, axis=1).max() < 1e-9
    signals = {
        "angle [rad]": trace.position if same else trace.position[:, :1],
        "error [mrad]": 1e3 * (trace.reference - trace.position),
        "torque [N m]": trace.torque,
    }
    if trace.disturbance.any():
        signals["disturbance [N m]"] = trace.disturbance
    reference = zip(trace.reference[:, 0].T, ("reference", "_"), strict=True)
    lines = [Line(trace.time, angle, label, "black", ":") for angle, label in reference]
    panels: list[Panel] = []
    for label, signal in signals.items():
        known = np.where(trace.alive[:, : signal.shape[1], None], signal, np.nan)
        joints = (band(trace.time, known[..., j], f"joint {j + 1}") for j in (0, 1))
        panels.append(Panel("", "time [s]", label, (*joints, *([] if panels else lines))))
    plot_lines(title, panels, path, width, across=1)


def plot_comparison(traces: Mapping[str, Trace], title: str, path: Path, width: int | None = None) -> None:
    """Draw errors, angles and torques of several policies over the time.

    Several seeds give medians and bands of the mean absolute error in each fiftieth of the episode,
    in which a diverged run has the worst error. Angles and torques are those of the first seed.
    """
    first = next(iter(traces.values()))
    single = len(first.seeds) == 1
    count = len(first.time) if single else min(50, len(first.time))
    starts = np.arange(count) * len(first.time) // count
    sizes = np.diff([*starts, len(first.time)])
    time = np.add.reduceat(first.time, starts) / sizes
    label, scale = ("error [mrad]", "linear") if single else ("mean |error| [mrad]", "log")

    def error(trace: Trace, j: int) -> Array:
        signed = np.where(trace.alive, (trace.reference - trace.position)[..., j], np.nan)
        return np.add.reduceat(1e3 * (signed if single else errors(trace)[..., j]), starts) / sizes[:, None]

    panels = []
    for j in (0, 1):
        bands = (band(time, error(trace, j), policy) for policy, trace in traces.items())
        panels.append(Panel(f"joint {j + 1}", "time [s]", label, tuple(bands), ("linear", scale)))
    here = "" if single else f", seed {first.seeds[0]}"
    for name, signal in (("position", "angle [rad]"), ("torque", "torque [N m]")):
        for j in (0, 1):
            known = {x: np.where(y.alive[:, 0], getattr(y, name)[:, 0, j], np.nan) for x, y in traces.items()}
            lines = [Line(first.time, values, policy) for policy, values in known.items()]
            if name == "position":
                lines.append(Line(first.time, first.reference[:, 0, j], "_", "black", ":"))
            panels.append(Panel("", "time [s]", signal + here, tuple(lines)))
    plot_lines(title, panels, path, width, across=2)


def plot_errors(boards: Mapping[str, Board], path: Path, rows: int = 8) -> None:
    """Draw the errors of the first policies of some boards, by name, as dots with their intervals.

    A name is without "@tuned". The boards stand below each other, as wide as a phone.
    """
    with _figure("Errors", path, (WIDTHS[1], len(boards) * (0.55 + 0.16 * rows))) as figure:
        panels = figure.subplots(len(boards), 1, squeeze=False)[:, 0]
        for axes, (name, board) in zip(panels, boards.items(), strict=True):
            first, error = [i for i in board.order if i in board.ranked][:rows], board.error()
            value, low, high = error.value[first], error.low[first], error.high[first]
            axes.errorbar(value, range(len(first)), xerr=(value - low, high - value), fmt="o", color=COLORS[0])
            axes.margins(x=0.04)
            axes.set(title=name, xlabel="error [%]", xscale="log", ylim=(rows - 0.5, -0.5))
            _label_plainly(axes.xaxis)
            labels = [board.policies[i].removesuffix("@tuned") for i in first]
            axes.set_yticks(range(len(first)), labels=labels, fontsize=7)
