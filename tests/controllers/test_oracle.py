"""The oracle tracks far better than laws without privileged access."""

import numpy as np

import controllers
from fbl_gym import TwoLinkArmVectorEnv
from tests.controllers.closed_loop import tracking


def test_the_oracle_tracks_best():
    """The oracle tracks far better than any law without privileged access if parameters, load and friction are wrong."""
    mean = {}
    for name in ("oracle-flm", "cascade-flm", "pid-flm", "pd-gravity"):
        env = TwoLinkArmVectorEnv(8, "everything-3")
        errors, _ = tracking(controllers.make(name, env), env, 900)
        mean[name] = np.abs(errors[1:]).mean()
    assert mean["oracle-flm"] < 0.1 * min(mean[name] for name in mean if name != "oracle-flm")
