"""Print how the order of a board holds just outside its class of robots:

    python examples/outside_class.py servo

Each row changes one thing of the class's nominal scenario: the drive is a sample later than its
data sheet states; all runs at half the rate; joints have slow springs; links bend, slower than
those of the board. It shows the errors of the board's first five policies
as multiples of the least error of all, the share of their runs that diverged, and Kendall's tau
between the errors of all ranked policies and those on the board.
"""

import argparse
import dataclasses
import re
from pathlib import Path

import numpy as np
from scipy import stats

import fbl_gym
from benchmarks.run.metrics import counted_errors, measure
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios
from fbl_gym.model.arm import stretched_inertia
from fbl_gym.records.record import ends
from fbl_gym.scenarios.classes import CLASSES

SPRINGS = {"servo": (7.0, 10.0), "direct": (15.0, 20.0), "geared": (4.0, 6.0)}  # Hz
LINKS = (8.0, 12.0)  # Hz
BOARD = Path(fbl_gym.__file__).parents[1] / "docs" / "results" / "board.md"

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("robot", choices=SPRINGS)
parser.add_argument("--seeds", type=int, default=16, metavar="N", help="test seeds 0 to N-1 (16)")
parser.add_argument("--rows", type=int, metavar="N", help="only the first rows of the board (all)")
arguments = parser.parse_args()

robot = arguments.robot
table = BOARD.read_text(encoding="utf-8").partition(f"## {robot}\n")[2].partition("\n## ")[0]
ranked = re.findall(r"^\| `(\S+)`[^|]*\| [\d–]+ \| ([\d.]+) ", table, flags=re.M)[: arguments.rows]
task = scenarios.get(f"{robot}-nominal")
drive, dt, (low, high) = task.actuator, task.control_dt, SPRINGS[robot]
damping = 0.04 * 2 * np.pi * np.sqrt(low * high) * stretched_inertia(task.arm)  # 2 % of the critical one
springs = {"frequency": {"log_uniform": (low, high)}, "damping": tuple(damping), "encoder": CLASSES[robot].encoder}
links = {"frequency": {"log_uniform": LINKS}, "damping": 0.05}
stated = float(np.mean(ends(drive.delay))) + drive.delay_samples * dt + drive.jitter / 2
tasks = {
    "nothing": task,
    "the drive, a sample late": task.replace(
        actuator=dataclasses.replace(drive, delay_samples=drive.delay_samples + 1), datasheet={"delay": stated}
    ),
    "half the rate": task.replace(control_dt=2 * dt),
    f"springs of {low:g} to {high:g} Hz": task.replace(joint=springs, physics_dt=task.physics_dt / 2),
    "links of {:g} to {:g} Hz".format(*LINKS): task.replace(link=links),
}
first = [f"`{name}`" for name, _ in ranked[:5]]
print("| changed |", " | ".join(first), f"| tau of {len(ranked)} rows |\n|" + "---|" * (len(first) + 2))
for changed, each in tasks.items():
    runs = [measure(rollout(name, each, range(arguments.seeds))) for name, _ in ranked]
    errors = np.array([np.exp(np.log(counted_errors(rows)).mean()) for rows in runs])
    lost = [np.mean([row["diverged"] for row in rows]) for rows in runs]
    times = [f"{error / errors.min():.3g}" for error in errors]
    cells = [f"{x}, {share:.0%} lost" if share else x for x, share in zip(times, lost, strict=True)]
    order = stats.kendalltau(errors, [float(error) for _, error in ranked]).statistic
    print(f"| {changed} |", " | ".join(cells[: len(first)]), f"| {order:.2f} |", flush=True)
