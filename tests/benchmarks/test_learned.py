"""The error of agents over their training seeds, and its parts."""

import numpy as np

from benchmarks.analysis.learned import measure_learned
from benchmarks.report.markdown import learned_table
from benchmarks.rl.policy import shipped
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.run.store import Store
from fbl_gym import scenarios


def test_learned_rows(tmp_path):
    task, store = scenarios.get("nominal").replace(duration=2.0), Store(tmp_path)
    rows = measure_learned([task], range(6), store)
    assert {row.policy for row in rows} == {name for name, seeds in shipped().items() if len(seeds) > 1}
    for row in rows:
        assert row.error.label == "optimistic"
        assert row.error.low <= row.error.value <= row.error.high
        assert min(row.parts.training, row.parts.world, row.parts.rest) >= 0.0
    text = learned_table(rows)
    assert len(text.splitlines()) == 2 + len(rows)
    # Each training seed is a cell, and a second call reads it from the store.
    assert len(store.files()) == sum(len(seeds) for seeds in shipped().values() if len(seeds) > 1)
    assert measure_learned([task], range(6), store) == rows
    means = [
        np.mean([row["error_pct"] for row in measure(rollout("ppo-torque", task, range(6), {"seed": seed}))])
        for seed in shipped()["ppo-torque"]
    ]
    assert len(set(means)) == len(means)
