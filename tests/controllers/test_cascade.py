"""The paper's cascade against its linear error equation and a constant load."""

import numpy as np
import pytest

import controllers
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import TwoLinkArmEnv, scenarios
from tests.controllers.closed_loop import EXACT, response, tracking


def test_cascade_error_obeys_its_linear_equation():
    """Exact model: with w = Kp e + e' the inner loop is w' ... a = P w + I int(w), so e''= -P w - I int(w)."""
    kp, p, i = 10.0, 30.0, 13.0
    env = TwoLinkArmEnv(**EXACT, initial_error=(-0.2, 0.0))
    errors = tracking(controllers.make("cascade-flm", env), env, 3000)[0][:, 0]
    # x = (e, e', int w):  e'' = -P (e' + Kp e) - I int w.
    a = [[0, 1, 0], [-p * kp, -p, -i], [kp, 1, 0]]
    expected = response(a, [0.2, 0.0, 0.0], 1e-3, 3000)
    assert np.abs(errors - expected).max() < 6e-3 * 0.2


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
