"""The C reference computes the same arm as the kernel."""

import numpy as np
import pytest

from benchmarks.speed.c_reference import Reference, load
from fbl_gym import TABLE_1, TwoLinkArmVectorEnv

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
