"""Training seeds and worlds told apart."""

import numpy as np

from benchmarks.report.learned import learned, learned_table
from benchmarks.rl.policy import shipped
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import scenarios


def test_learned_rows():
    task = scenarios.get("nominal").replace(duration=2.0)
    rows = learned([task], range(6))
    assert {row.policy for row in rows} == {name for name, seeds in shipped().items() if len(seeds) > 1}
    for row in rows:
        assert row.error.label == "optimistic"
        assert row.error.low <= row.error.value <= row.error.high
        assert min(row.parts.training, row.parts.world, row.parts.rest) >= 0.0
    text = learned_table(rows)
    assert len(text.splitlines()) == 2 + len(rows)
    # Each training seed is an agent of its own.
    means = [
        np.mean([row["error_pct"] for row in measure(rollout("ppo-torque", task, range(6), {"seed": seed}))])
        for seed in shipped()["ppo-torque"]
    ]
    assert len(set(means)) == len(means)
