"""The trace of one seed as a figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.rollout import Trace


def plot_trace(trace: Trace, title: str, path: Path, lane: int = 0) -> None:
    """Draw reference and motion, tracking error, torque and disturbance of both joints.

    Args:
        trace: of the rollout.
        title: above the figure.
        path: the file; its ending says the format (.png, .svg, .pdf).
        lane: which seed.
    """
    end = int(trace.alive[:, lane].sum())
    t = trace.time[:end]
    figure = Figure(figsize=(11, 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 2, sharex=True)
    limit = None if trace.scenario.actuator.torque_limit is None else np.array(trace.scenario.actuator.torque_limit)
    for joint in (0, 1):
        reference, position = trace.reference[:end, lane, joint], trace.position[:end, lane, joint]
        motion, error, torque, push = axes[:, joint]
        motion.set_title(f"joint {joint + 1}")
        motion.plot(t, reference, color="tab:blue", label="reference")
        motion.plot(t, position, color="tab:red", linestyle="--", label="motion")
        motion.set_ylabel("angle [rad]")
        error.plot(t, 1e3 * (reference - position), color="tab:purple")
        error.axhline(0.0, color="0.7", linewidth=0.8)
        error.set_ylabel("error [mrad]")
        torque.step(t, trace.torque[:end, lane, joint], color="tab:orange", where="pre")
        torque.set_ylabel("torque [N m]")
        if limit is not None and np.abs(trace.torque[:end, lane, joint]).max() > 0.8 * limit[joint]:
            for bound in (-limit[joint], limit[joint]):
                torque.axhline(bound, color="0.5", linestyle=":", linewidth=1.0)
        push.step(t, trace.disturbance[:end, lane, joint], color="tab:green", where="post")
        push.set_ylabel("disturbance [N m]")
        push.set_xlabel("time [s]")
        for axis in axes[:, joint]:
            axis.grid(alpha=0.25)
            axis.margins(x=0)
    ended = "" if end == len(trace.time) else f", diverged at {t[-1]:.2f} s"
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    figure.suptitle(f"{title}, seed {trace.seeds[lane]}{ended}", x=0.01, horizontalalignment="left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
