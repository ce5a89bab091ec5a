"""Print how policies carry over from the practice of a class to its board, and beyond:

    python examples/generalise.py servo ppo lqg-elastic@tuned

Each cell shows the geometric mean of the error [%], and the share of lost runs [%]: in practice, on
the board, in its scenarios of surprise, and in its families at severity 3. A shipped agent counts
with all its training seeds.
"""

import argparse

import numpy as np

from benchmarks.run.expansion import members
from benchmarks.run.metrics import counted_errors, measure
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("robot", choices=("servo", "direct", "geared"))
parser.add_argument("policies", nargs="+", metavar="POLICY")
parser.add_argument("--practice", action="store_true", help="in practice alone")
parser.add_argument("--first", type=int, default=0, metavar="N", help="first seed (0)")
parser.add_argument("--seeds", type=int, default=32, metavar="N", help="number of seeds (32)")
arguments = parser.parse_args()
robot, seeds = arguments.robot, range(arguments.first, arguments.first + arguments.seeds)
tiers = {"practice": (f"{robot}-practice", [1, 3])}
if not arguments.practice:
    tiers |= {"board": (robot, [2]), "surprise": (f"{robot}-surprise", []), "severity 3": (robot, [3])}
print("| policy |", " | ".join(tiers), "|\n|" + "---|" * (len(tiers) + 1))
for name in arguments.policies:
    cells = []
    for tier, severities in tiers.values():
        tasks = [scenarios.get(each) for each in scenarios.in_tier(tier, severities)]
        runs = [measure(rollout(member.name, task, seeds)) for task in tasks for member in members([name])]
        error = np.exp(np.mean([np.log(counted_errors(each)).mean() for each in runs]))
        cells.append(f"{error:.3g}, {100 * np.mean([run['diverged'] for each in runs for run in each]):.2g}")
    print(f"| `{name}` |", " | ".join(cells), "|", flush=True)
