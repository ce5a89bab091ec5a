"""Print margin and error of gains on the practice of a class of robots, to adjust them by hand:

    python examples/adjust_gains.py servo lqg-elastic@tuned lqg-elastic@tuned@bandwidth=0.8x

The margins are the least of 16 arms. The error is the geometric mean of 8 seeds of six scenarios.
"""

import argparse

import numpy as np

from benchmarks.policies.spec import resolve
from benchmarks.run.linearize import margin_metrics
from benchmarks.run.metrics import counted_errors, measure
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("robot", choices=("servo", "direct", "geared"))
parser.add_argument("policies", nargs="+", metavar="POLICY")
arguments = parser.parse_args()
families = "nominal", "delay-3", "datasheet-3", "everything-1", "noise-3", "payload-3"
tasks = [scenarios.get(f"{arguments.robot}-practice-{family}") for family in families]
for policy in arguments.policies:
    rows = margin_metrics(resolve(policy), tasks[0], range(19000, 19016))
    phase, delay = (np.min([row[name] for row in rows]) for name in ("phase_deg", "delay_samples"))
    runs = [counted_errors(measure(rollout(policy, task, range(19900, 19908)))) for task in tasks]
    error = np.exp(np.mean([np.log(each).mean() for each in runs]))
    print(f"{policy}: {phase:.0f} degrees, {delay:.2f} samples, error {error:.3f} %", flush=True)
