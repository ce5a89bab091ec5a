"""The C reference computes the same arm as the kernel, and the elastic arm of the textbook."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.speed.c_reference import Reference, load
from fbl_gym import TABLE_1, TwoLinkArmVectorEnv
from fbl_gym.model.arm import forward_dynamics

pytestmark = pytest.mark.skipif(load() is None, reason="no C compiler")


def _rows(values):
    """Return joint values [16 x 2] as two rows of blocks."""
    return values.T.reshape(2, 2, 8).swapaxes(0, 1)


def test_rigid_joints_move_as_in_the_kernel():
    env = TwoLinkArmVectorEnv(16, reference={"kind": "sine"}, action="torque")
    env.reset(seed=0)
    reference = Reference(TABLE_1, 16, friction=(0.0, 0.0, 1.0))
    reference.state[:, :2], reference.state[:, 2:] = _rows(env.truth.position), _rows(env.truth.velocity)
    torques = np.random.default_rng(0).normal(scale=50.0, size=(100, 16, 2))
    for torque in torques:
        env.step(torque)
        reference.torque[:] = _rows(torque)
        reference.step()
    np.testing.assert_allclose(reference.state[:, :2], _rows(env.truth.position), atol=1e-11)


def test_elastic_joints_obey_their_equations():
    stiffness, damping, rotor = 2000.0, 5.0, 0.5
    reference = Reference(TABLE_1, 8, friction=(3.0, 0.0, 1.0), joint=(stiffness, damping, rotor))
    start = np.array([-1.5, 0.2, 0.0, 0.0, -1.45, 0.22, 0.1, -0.1])
    reference.state[:] = start[:, None]
    reference.torque[:] = np.array([100.0, 20.0])[:, None]

    def slope(_, x):
        spring = stiffness * (x[4:6] - x[:2]) + damping * (x[6:] - x[2:4])
        link = forward_dynamics(TABLE_1, x[:2], x[2:4], spring)
        motor = (np.array([100.0, 20.0]) - spring - 3.0 * x[6:]) / rotor
        return np.concatenate([x[2:4], link, x[6:], motor])

    exact = solve_ivp(slope, (0.0, 0.5), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    for _ in range(50):
        reference.step()
    np.testing.assert_allclose(reference.state[0, :, 0], exact, atol=1e-5)
