"""Joints that stick and slide, against mechanics."""

import numpy as np
import pytest

from fbl_gym.model.arm import gravity_torque, inverse_dynamics
from tests.fbl_gym.dry_arm import BREAKAWAY, DRY, STILL, flat
from tests.fbl_gym.episodes import started, started_batch, truths_of


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("load", [(0.999, 0.999), (-0.999, 0.5), (0.0, -0.999), (0.7, -0.999)])
def test_below_breakaway_not_one_bit_moves(h, load):
    env = flat(control_dt=h, physics_dt=h)
    before = env.truth.position
    for _ in range(200):
        env.step(np.array(load) * BREAKAWAY)
        truth = env.truth
        assert np.array_equal(truth.position, before)
        assert np.array_equal(truth.velocity, [0.0, 0.0])
        assert np.array_equal(truth.acceleration, [0.0, 0.0])
        np.testing.assert_allclose(truth.friction_torque, np.array(load) * BREAKAWAY, rtol=1e-12)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
def test_a_changing_load_below_breakaway_moves_nothing(h):
    """Torques that swing to 99 % of breakaway and back, of either sign."""
    disturbance = {"kind": "sine", "amplitude": tuple(0.99 * BREAKAWAY), "frequency": (1.0, 1.7), "phase": (0.0, 1.0)}
    env = flat(disturbance=disturbance, control_dt=max(h, 1e-2), physics_dt=h)
    before = env.truth.position
    largest = np.zeros(2)
    for _ in range(round(2.0 / env.interface.control_dt)):
        env.step((0.0, 0.0))
        largest = np.maximum(largest, np.abs(env.truth.friction_torque))
        np.testing.assert_allclose(env.truth.friction_torque, -env.truth.disturbance, rtol=1e-12)
    assert np.array_equal(env.truth.position, before)
    assert np.all(largest > 0.9 * BREAKAWAY)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_a_load_just_above_breakaway_moves_a_joint(h, joint, direction):
    """A load 1e-4 above breakaway moves the joint in its direction, at any step size."""
    env = flat(control_dt=h, physics_dt=h)
    before = env.truth.position
    load = np.zeros(2)
    load[joint] = direction * 1.0001 * BREAKAWAY[joint]
    env.step(load)
    assert direction * (env.truth.position - before)[joint] > 0.0
    assert direction * env.truth.velocity[joint] > 0.0


def test_friction_holds_a_load_with_gravity():
    """With gravity the static load is the torque less G(q); within breakaway the arm does not move for 10 s."""
    env = started(action="torque", reference=STILL, friction=DRY)
    before = env.truth.position
    load = gravity_torque(env.interface.nominal, before) + np.array([25.0, -11.0])
    truths_of(env, [load] * 999)
    assert np.array_equal(env.truth.position, before)
    np.testing.assert_allclose(env.truth.friction_torque, (25.0, -11.0), rtol=1e-10)


def test_friction_balances_equation_1():
    """M a + C v + G + F + tau_d = tau at every sample, with both joints sliding, both stuck, or one of each.

    Friction never adds power.
    """
    disturbance = {"kind": "sine", "amplitude": (30.0, 10.0)}
    env = started_batch(64, "stiction-2", action="torque", disturbance=disturbance)
    rng, seen = np.random.default_rng(0), set()
    for _ in range(300):
        env.step(rng.normal(size=(64, 2)) * (100.0, 30.0))
        truth = env.truth
        motion = inverse_dynamics(truth.lumped, truth.position, truth.velocity, truth.acceleration)
        np.testing.assert_allclose(truth.friction_torque, truth.applied_torque - truth.disturbance - motion, atol=1e-9)
        assert np.all(truth.friction_torque * truth.velocity >= 0.0)
        held = (truth.velocity == 0.0) & (truth.acceleration == 0.0)
        seen |= {tuple(lane) for lane in held.tolist()}
    assert len(seen) == 4
