"""Adaptive computed torque against its Lyapunov function."""

import numpy as np

from tests.controllers.passive_loop import closed_loop, wrong


def test_the_lyapunov_function_falls_by_the_damping():
    """V = (s'W s + p~' Gamma^-1 p~) / 2 falls by damping s'W s on a wrong arm without friction."""
    scenario = wrong(0.3)
    policy, real, (estimates, s, _, _) = closed_loop(
        "computed-torque-adaptive", scenario, lanes=4, damping=10.0, friction=1e-9
    )
    missing = real - estimates[..., :5]
    value = 0.5 * ((policy.stretched * s**2).sum(-1) + (missing**2 / policy.rates[:5]).sum(-1))
    fall = policy.damping * (policy.stretched * s**2).sum(-1) * scenario.control_dt
    left = value - (value[0] - np.concatenate([np.zeros((1, 4)), np.cumsum(fall, axis=0)[:-1]]))
    assert np.abs(left).max() < 0.02 * (value[0] - value[-1]).min()
    assert (value[-1] < value[0]).all()
