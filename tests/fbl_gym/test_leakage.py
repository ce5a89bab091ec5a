"""Leakage of the dynamics, equations (5) and (6)."""

import numpy as np

from fbl_gym import TABLE_1, TwoLinkArmEnv
from fbl_gym.model.arm import forward_dynamics, inertia_matrix


def test_leakage_of_a_disturbance_alone_is_its_acceleration():
    """Equation (6): LS = M^-1 tau_d. By (5), LS is the nominal model's acceleration less the real one."""
    env = TwoLinkArmEnv(disturbance={"kind": "array", "torque": [(30.0, -7.0)]})
    env.reset(seed=0)
    for _ in range(10):
        env.step((0.05, 0.01))
        truth = env.truth
        np.testing.assert_array_equal(truth.disturbance, [30.0, -7.0])
        expected = np.linalg.solve(inertia_matrix(TABLE_1, truth.position), [30.0, -7.0])
        a = forward_dynamics(TABLE_1, truth.position, truth.velocity, truth.applied_torque)
        np.testing.assert_allclose(a - truth.acceleration, expected, rtol=1e-8)
