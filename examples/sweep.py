"""Draw the error of two laws over a delay of the drive that their data sheet does not state.

    python examples/sweep.py

`fbl-gym sweep --over` does the same in parallel, and keeps its results.
"""

from dataclasses import replace

import matplotlib.pyplot as plt

import benchmarks
from fbl_gym import scenarios

DELAYS = (0.0, 0.005, 0.01, 0.015, 0.02)  # s

task = scenarios.get("servo-nominal")
for policy in ("computed-torque@tuned", "computed-torque-dob@tuned", "sliding-mode@tuned"):
    errors = []
    for delay in DELAYS:
        late = task.replace(actuator=replace(task.actuator, delay=delay), datasheet={"delay": task.control_dt})
        errors.append(benchmarks.evaluate(policy, late, seeds=8).error_pct.median())
    plt.plot(DELAYS, errors, label=policy)
plt.xlabel("delay [s]")
plt.ylabel("median error [%]")
plt.legend()
plt.savefig("sweep.png", bbox_inches="tight")
print("sweep.png")
