"""Leakage of the dynamics, equations (5) and (6)."""

import numpy as np

from fbl_gym import TABLE_1, TwoLinkArmEnv
from fbl_gym.model.arm import forward_dynamics, inertia_matrix


def test_leakage_is_the_nominal_less_the_real_acceleration():
    """Equation (5): the acceleration is a - LS, a the nominal acceleration under the applied torque."""
    env = TwoLinkArmEnv(
        action="acceleration", parameter_error={"ratio": (2.0, 0.5, 1.2, 0.9)}, friction={"viscous": 5.0}
    )
    env.reset(seed=0)
    np.testing.assert_allclose(
        env.truth.leakage, -env.truth.acceleration, atol=1e-9
    )  # the nominal arm would hold still
    for a in ((1.0, -2.0), (-3.0, 0.5)):
        env.step(a)
        truth = env.truth
        expected = forward_dynamics(TABLE_1, truth.position, truth.velocity, truth.applied_torque)
        np.testing.assert_allclose(truth.acceleration, expected - truth.leakage, rtol=1e-12)
        assert np.abs(truth.leakage).max() > 0.1


def test_leakage_of_a_disturbance_alone_is_its_acceleration():
    """Equation (6): LS = M^-1 tau_d."""
    env = TwoLinkArmEnv(disturbance={"kind": "array", "torque": [(30.0, -7.0)]})
    env.reset(seed=0)
    for _ in range(10):
        env.step((0.05, 0.01))
        truth = env.truth
        np.testing.assert_array_equal(truth.disturbance, [30.0, -7.0])
        expected = np.linalg.solve(inertia_matrix(TABLE_1, truth.position), [30.0, -7.0])
        np.testing.assert_allclose(truth.leakage, expected, rtol=1e-8)
