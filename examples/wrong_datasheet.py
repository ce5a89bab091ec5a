"""Print how much more laws err where one number of their data sheet is wrong:

    python examples/wrong_datasheet.py servo lqg-elastic@tuned sliding-mode+predictor@tuned

The arms are those of a class's nominal scenario. Each cell shows the geometric mean of the error
[%] over 16 seeds. The delay is wrong by half a sample.
"""

import argparse

import numpy as np

from benchmarks.run.metrics import counted_errors, measure
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios
from fbl_gym.records.record import ends

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("robot", choices=("servo", "direct", "geared"))
parser.add_argument("policies", nargs="+", metavar="POLICY")
arguments = parser.parse_args()
task, seeds = scenarios.get(f"{arguments.robot}-nominal"), 16
drive, h = task.actuator, task.control_dt


def middle(distribution):
    """Return the geometric mean of the ends of a range."""
    return float(np.sqrt(np.prod(ends(distribution))))


delay, lag = np.mean(ends(drive.delay)) + drive.delay_samples * h + drive.jitter / 2, middle(drive.lag)
told = {
    "right": {},
    "delay - 1/2": {"delay": delay - h / 2}, "delay + 1/2": {"delay": delay + h / 2},
    "lag / 1.4": {"lag": lag / 1.4}, "lag x 1.4": {"lag": lag * 1.4},
}  # fmt: skip
if task.joint is not None:
    springs = np.array([middle(k) for k in task.joint.stiffness])
    told |= {"springs / 1.4": {"stiffness": springs / 1.4}, "springs x 1.4": {"stiffness": springs * 1.4}}
print("| policy |", " | ".join(told), "|\n|" + "---|" * (len(told) + 1))
for policy in arguments.policies:
    errors = []
    for sheet in told.values():
        runs = measure(rollout(policy, task.replace(datasheet=sheet), range(7000, 7000 + seeds)))
        errors.append(np.exp(np.log(counted_errors(runs)).mean()))
    print(f"| `{policy}` |", " | ".join(f"{error:.3g}" for error in errors), "|", flush=True)
