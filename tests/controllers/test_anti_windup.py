"""Integrators pause while the torque saturates."""

import numpy as np
import pytest

import controllers
from fbl_gym import TwoLinkArmEnv
from tests.controllers.closed_loop import tracking


@pytest.mark.parametrize("name", ["pid-flm", "cascade-flm"])
def test_integrators_pause_while_the_torque_saturates(name, monkeypatch):
    """Held back by its torque limit, the arm does not store what would throw it past the reference."""
    gains = {"ki": 20.0, "kp": 30.0, "kd": 10.0} if name == "pid-flm" else {}
    options = {
        "reference": {"kind": "minimum-jerk", "points": ((-0.6, 0.0),)},
        "initial_error": (-1.0, 0.0),
        "actuator": {"torque_limit": (330.0, 120.0)},
    }

    def overshoot(**changes):
        env = TwoLinkArmEnv(**{**options, **changes}, action="torque")
        return -tracking(controllers.make(name, env, **gains), env, 900)[0][:, 0].min()

    paused, unlimited = overshoot(), overshoot(actuator=None)
    module = f"controllers.{name.split('-')[0]}.winds_up"
    monkeypatch.setattr(module, lambda *arguments: np.zeros_like(arguments[2], dtype=bool))
    wound_up = overshoot()
    assert wound_up > 1.3 * unlimited
    # Of the overshoot that the limit adds to that of an unlimited arm, three quarters and more are avoided.
    assert paused - unlimited < 0.25 * (wound_up - unlimited)
