"""The paper's cascade: its feed-forward, and what it refuses."""

import pytest

import controllers
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import TwoLinkArmEnv, scenarios


def test_feed_forward_tracks_a_moving_reference():
    scenario = scenarios.get("paper-8").replace(friction=None, duration=4.0)
    traces = (rollout("cascade-flm", scenario, [0], {"feedforward": share}) for share in (0.0, 1.0))
    without, with_it = (measure(trace)[0]["error_pct"] for trace in traces)
    assert with_it < 0.2 * without


def test_a_known_friction_that_varies_is_refused():
    env = TwoLinkArmEnv()
    with pytest.raises(ValueError, match=r"friction must have fixed numbers and no load, .* got Friction"):
        controllers.make("cascade-flm", env, friction={"coulomb": {"uniform": [1.0, 2.0]}})
    with pytest.raises(ValueError, match=r"no load, as in equation \(22\), got .*load=\(0.2"):
        controllers.make("cascade-flm", env, friction={"load": 0.2})
