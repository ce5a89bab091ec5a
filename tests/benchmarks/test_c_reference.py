"""The C reference computes the same arms as the kernel."""

import numpy as np
import pytest

from benchmarks.speed.c_reference import Reference, SameWork, load
from fbl_gym import TABLE_1, TwoLinkArmVectorEnv

pytestmark = pytest.mark.skipif(load() is None, reason="no C compiler")


def _rows(values):
    """Return joint values [16 x 2] as two rows of blocks."""
    return values.T.reshape(2, 2, 8).swapaxes(0, 1)


def test_rigid_joints_move_as_in_the_kernel():
    env = TwoLinkArmVectorEnv(16, reference={"kind": "sine"}, action="torque")
    env.reset(seed=0)
    reference = Reference(load(), TABLE_1, 16, friction=(0.0, 0.0, 1.0))
    reference.state[:, :2], reference.state[:, 2:] = _rows(env.truth.position), _rows(env.truth.velocity)
    torques = np.random.default_rng(0).normal(scale=50.0, size=(100, 16, 2))
    for torque in torques:
        env.step(torque)
        reference.torque[:] = _rows(torque)
        reference.step()
    np.testing.assert_allclose(reference.state[:, :2], _rows(env.truth.position), atol=1e-11)


STICKING = {"friction": {"viscous": 1.0, "coulomb": 10.0, "stiction": 10.0}, "parameter_error": {"radius": 0.2}}
SPRINGS = {
    "scenario": "servo-elastic-2",
    "joint": {"stiffness": 100.0, "damping": 0.1, "backlash": 0.01, "encoder": "link"},
}


@pytest.mark.parametrize("options", [STICKING, {"scenario": "servo-elastic-2"}, SPRINGS])
def test_the_same_work_moves_the_arms_as_the_kernel(options):
    env = TwoLinkArmVectorEnv(16, action="torque", **options)
    env.reset(seed=0)
    reference = SameWork(load(), env)
    torques = np.random.default_rng(0).uniform(-0.3, 0.3, size=(40, 16, 2)) * env.interface.action_limit
    for torque in torques:
        readings = env.step(torque)[0]
        reference.command[:] = _rows(torque)
        reference.step()
    truth = env.truth
    motion = truth.position, truth.velocity, truth.motor_position, truth.motor_velocity
    for i, values in enumerate(motion if "scenario" in options else motion[:2]):
        np.testing.assert_allclose(reference.state[:, 2 * i : 2 * i + 2], _rows(values), rtol=0, atol=1e-10)
    shown = reference.readings[:, : 6 if "acceleration" in env.layout else 4]
    np.testing.assert_allclose(shown[:, :2], _rows(readings[:, :2]), rtol=0, atol=1e-10)
    np.testing.assert_allclose(shown[:, 2:4], _rows(readings[:, 2:4]), rtol=0, atol=1e-8)
    if "scenario" not in options:
        np.testing.assert_allclose(shown[:, 4:], _rows(readings[:, 4:6]), rtol=0, atol=1e-8)
