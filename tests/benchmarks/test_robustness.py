"""The uncertainty radius: its scenarios, and that its search is kept in the store."""

import numpy as np
import pytest

from benchmarks.analysis.robustness import BOUND, stored_radius, task, with_radius
from benchmarks.run import cell
from benchmarks.run.store import Store
from fbl_gym import TwoLinkArmVectorEnv, scenarios


@pytest.mark.parametrize(("direction", "low", "high"), [("larger", 1, 4), ("smaller", 0.25, 1), ("both", 0.25, 4)])
def test_directions(direction, low, high):
    """Radius 3: the real parameters lie within [1, 4], [1/4, 1] and [1/4, 4] times the nominal ones, and fill them."""
    env = TwoLinkArmVectorEnv(500, with_radius(task(scenarios.get("nominal")), 3.0, direction), action="torque")
    env.reset(seed=0)
    ratios = np.hstack([env.truth.masses / [20.0, 15.0], env.truth.lengths / [0.7, 0.5]])
    assert np.all((ratios > low - 1e-9) & (ratios < high + 1e-9))
    assert ratios.min() < low * 1.05
    assert ratios.max() > high / 1.05


def test_a_search_is_kept_and_not_run_again(tmp_path, monkeypatch):
    store, here = Store(tmp_path), scenarios.get("section-2-2/noise-2").replace(control_dt=0.005)
    assert task(here).description == "section-2-2 at 200 Hz"
    found = stored_radius("cascade-flm", "larger", here, store, seeds=8, tolerance=0.3)
    assert 0.0 < found.value < found.fails
    assert len(store.files()) == len(found.tried)
    monkeypatch.setattr(cell, "run_cell", lambda *_: pytest.fail("it was run again"))
    assert stored_radius("cascade-flm", "larger", here, store, seeds=8, tolerance=0.3) == found
    for path in store.files():
        rows = store.load(path).rows
        assert store.load(path).cell.scenario.arm == here.arm
        share = np.mean([row["error_pct"] <= BOUND for row in rows])
        assert share in [s for _, s in found.tried]
