"""Draw the traces of the controllers' pages: `python docs/pictures/traces.py [PAGE ...]`.

A panel is one run of a class of robots, seed 0. A point is the root mean square of both joints'
errors in a hundredth of the episode. A law has its tuned gains, and is left out of a class without.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from benchmarks.report.plot import COLORS, DASHES, STYLE
from benchmarks.run.rollout import rollout_trials
from fbl_gym import scenarios

FOLDER = Path(__file__).parent
TUNED = FOLDER.parents[1] / "controllers" / "tuned"
PAGES = {
    "oracles": "nominal oracle-flm oracle-elastic",
    "composition": "lag-2 cascade-flm cascade-flm+predictor cascade-flm+springs",
    "computed-torque": "nominal",
    "computed-torque-adaptive": "model-error-2 computed-torque-adaptive",
    "computed-torque-dob": "disturbance-2 computed-torque-dob",
    "computed-torque-eso": "disturbance-2 computed-torque-eso ladrc",
    "computed-torque-gp": "friction-2 computed-torque-gp",
    "computed-torque-ilc": "nominal computed-torque-ilc",
    "computed-torque-tde": "payload-2 computed-torque-tde",
    "h-infinity": "model-error-2 h-infinity",
    "l1-adaptive": "disturbance-2 l1-adaptive",
    "lqg": "noise-2 lqg",
    "lqg-elastic": "everything-2 lqg-elastic sliding-mode+predictor sliding-mode+springs",
    "paper": "nominal pid-flm cascade-flm robust-flm adaptive-flm",
    "pid-gravity": "nominal pd-gravity pid-gravity",
    "rbf-adaptive": "friction-2 rbf-adaptive",
    "sliding-mode": "disturbance-2 sliding-mode terminal-sliding-mode",
    "slotine-li": "payload-2 slotine-li slotine-li-composite",
    "spong-robust": "model-error-2 spong-robust",
}
"""Of each page, the family that shows what its laws are for, and the laws."""


def lines(law, robot, family):
    """Yield label, times [100] s and errors [100] mrad; of a law that learns, of three trials."""
    homes = [path.parent.name for path in TUNED.glob(f"*/{law}.json")]
    if homes and robot not in homes:
        return
    policy = f"{law}@tuned" if homes else law
    shown = (1, 3, 10) if law.endswith("-ilc") else (1,)
    traces = rollout_trials(policy, scenarios.get(f"{robot}-{family}"), [0], shown[-1])
    for trial in shown:
        trace = traces[trial - 1]
        square = np.where(trace.alive[1:, 0], ((trace.reference - trace.position)[1:, 0] ** 2).mean(axis=1), np.nan)
        error = 1e3 * np.sqrt(square.reshape(100, -1).mean(axis=1))
        yield policy + f", trial {trial}" * (len(shown) > 1), trace.time[1:].reshape(100, -1).mean(axis=1), error


def draw(page):
    """Write a page's figure, transparent and with grey letters for light and dark pages."""
    family, *laws = PAGES[page].split()
    figure = Figure(figsize=(5.2, 2.1 + 0.12 * len(laws)), layout="constrained")
    drawn = {}
    for axes, robot in zip(figure.subplots(1, 3, sharey=True), ("servo", "direct", "geared"), strict=True):
        for label, time, error in (line for law in ("computed-torque", *laws) for line in lines(law, robot, family)):
            i = list(drawn).index(label) if label in drawn else len(drawn)
            style = {"color": COLORS[i - 1], "linestyle": DASHES[i - 1]} if i else {"color": "0.55", "linewidth": 0.7}
            drawn[label] = axes.semilogy(time, error, **style)[0]
        axes.set(title=f"{robot}-{family}", xlabel="time [s]")
        axes.minorticks_off()
        axes.yaxis.set_major_formatter("{x:g}")
    figure.axes[0].set_ylabel("error [mrad]")
    figure.legend(drawn.values(), drawn, loc="outside upper center", ncols=2)
    figure.savefig(FOLDER / f"trace-{page}.svg", transparent=True, metadata={"Date": None})


if __name__ == "__main__":
    grey = dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color", "axes.edgecolor"), "0.5")
    with rc_context({**grey, "svg.hashsalt": "traces"}, STYLE):
        for page in sys.argv[1:] or PAGES:
            draw(page)
