"""PD with gravity compensation at rest."""

import numpy as np

import controllers
from fbl_gym import TwoLinkArmEnv
from tests.controllers.closed_loop import tracking

STILL = {"kind": "minimum-jerk", "points": ((-1.0, 0.5),)}


def test_gravity_compensation_holds_still():
    """PD with the exact gravity torque keeps a resting arm at its reference."""
    env = TwoLinkArmEnv(reference=STILL)
    assert np.abs(tracking(controllers.make("pd-gravity", env), env, 500)[0]).max() < 1e-9
