"""Keep a law within bounds that its reference leaves, by a safety filter.

    python examples/constraints.py

The environment counts each step outside the bounds in `info["cost"]`, as Safety-Gymnasium does.
"""

import benchmarks
from fbl_gym import scenarios

box = scenarios.get("servo-nominal").replace(
    name="box",
    reference={"kind": "minimum-jerk", "points": [(-1.6, 0.0), (-0.8, 0.8), (-2.3, -0.8), (-0.8, -0.8), (-2.3, 0.8)]},
    constraints={"low": (-2.2, -0.7), "high": (-0.9, 0.7), "velocity": 2.5},  # rad, rad/s
)
for policy in ("computed-torque", "computed-torque+barrier", "computed-torque+barrier@barrier_margin=0.03"):
    runs = benchmarks.evaluate(policy, box, seeds=16)
    print(f"{policy}: outside for {runs.violation_pct.mean():.1f} % of the time, error {runs.error_pct.median():.2f} %")
