"""Draw error against phase margin: `python docs/pictures/front.py`, some five minutes.

Each point is a law with gains drawn from the ranges of its search, on `servo-nominal`: the least
phase margin of four arms, and the median error of eight runs.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from benchmarks.policies.spec import resolve
from benchmarks.report.plot import COLORS, MARKERS, STYLE, WIDTHS, _label_plainly
from benchmarks.run.linearize import margin_metrics
from benchmarks.run.metrics import counted_errors, measure
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios
from fbl_gym.records.record import tuning_ranges

LAWS = ("lqg-elastic", "sliding-mode+predictor", "computed-torque-dob+predictor")
DRAWS = int(sys.argv[1]) if sys.argv[1:] else 60
TASK = scenarios.get("servo-nominal")


def point(law, gains):
    """Return the least phase margin [degrees] and the median error [%] of a law."""
    rows = margin_metrics(resolve(law), TASK, range(4), gains)
    errors = counted_errors(measure(rollout(law, TASK, range(8), gains)))
    return min(row["phase_deg"] for row in rows), np.median(errors)


random, points = np.random.default_rng(0), {}
for law in LAWS:
    low, high = np.log(list(tuning_ranges(resolve(law).factory()).values())).T
    names = list(tuning_ranges(resolve(law).factory()))
    draws = [dict(zip(names, np.exp(random.uniform(low, high)), strict=True)) for _ in range(DRAWS)]
    points[law] = np.array([point(law, gains) for gains in draws])

with rc_context(fname=STYLE):
    figure = Figure(figsize=(WIDTHS[1] * 1.4, 3.0), layout="constrained")
    axes = figure.subplots()
    for i, (law, each) in enumerate(points.items()):
        good = each[np.isfinite(each).all(axis=1) & (each[:, 1] < 3.0)]
        axes.plot(*good.T, MARKERS[i], color=COLORS[i], label=law, markersize=3.5, linestyle="none")
        best = [p for p in good if not ((good[:, 0] >= p[0]) & (good[:, 1] < p[1])).any()]
        axes.plot(*np.array(sorted(map(tuple, best))).T, "-", color=COLORS[i], linewidth=0.8)
    axes.set(xlabel="phase margin without dry friction [degrees]", ylabel="error [%]", yscale="log")
    _label_plainly(axes.yaxis)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.3), frameon=False)
    figure.savefig(Path(__file__).with_name("front.svg"), metadata={"Date": None})
for law, each in points.items():
    for least in (0.0, 10.0, 20.0, 30.0):
        print(f"{law}, {least:g} degrees or more: {each[each[:, 0] >= least, 1].min():.3f} %")
