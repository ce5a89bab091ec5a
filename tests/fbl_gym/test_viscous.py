"""Viscous friction of any size, and the two forms of the Stribeck curve."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fbl_gym import TABLE_1, Friction, TwoLinkArmEnv
from fbl_gym.arm import ArmParameters, forward_dynamics
from tests.fbl_gym.paired_runs import watch

LIGHT = {"m1": 0.05, "m2": 0.02, "L1": 0.2, "L2": 0.2}


def exact(arm, viscous, torque, start, times):
    def slope(_, x):
        return np.concatenate([x[2:], forward_dynamics(arm, x[:2], x[2:], torque - viscous * x[2:])])

    return solve_ivp(slope, (0, times[-1]), start, "Radau", times, rtol=1e-9, atol=1e-11).y[:2].T


@pytest.mark.parametrize("viscous", [(2.0, 1.0), (5.0, 5.0), (500.0, 300.0), (0.05, 5.0)])
def test_strong_viscous_friction_is_stable_and_near_a_stiff_solver(viscous):
    torque = np.array([0.4, -0.2])
    options = {"arm": LIGHT, "friction": {"viscous": viscous}, "initial_velocity": (3.0, -5.0)}
    position, velocity = watch("position", "velocity", torque=torque, steps=300, **options)
    start = np.concatenate([position[0], velocity[0]])
    expected = exact(ArmParameters(**LIGHT), np.array(viscous), torque, start, np.arange(301) * 1e-3)
    np.testing.assert_allclose(position, expected, atol=4e-3 if viscous == (0.05, 5.0) else 1.5e-3)
    assert np.abs(velocity).max() < 7.0


def test_an_arm_without_torque_loses_energy_under_any_viscous_friction():
    for viscous in (1.0, 5.0, 100.0, 1e6):
        env = TwoLinkArmEnv(
            arm={**LIGHT, "gravity": 0.0}, friction={"viscous": viscous}, action="torque", initial_velocity=10.0
        )
        env.reset(seed=0)
        speeds = []
        for _ in range(20):
            assert not env.step((0.0, 0.0))[2]
            speeds.append(np.abs(env.truth.velocity).max())
        assert max(speeds) < 10.0


def test_a_stiff_joint_still_sticks():
    options = {"arm": {**LIGHT, "gravity": 0.0}, "friction": {"viscous": 5.0, "coulomb": 0.5}}
    position, velocity = watch("position", "velocity", torque=(0.49, -0.49), steps=50, **options)
    np.testing.assert_array_equal(position, np.tile(position[0], (51, 1)))
    _, velocity = watch("position", "velocity", torque=(0.6, 0.0), steps=50, **options)
    assert velocity[-1, 0] > 0.0


def test_moderate_viscous_friction_keeps_the_fourth_order():
    viscous, torque = np.array([10.0, 5.0]), np.array([40.0, 10.0])
    position, velocity = watch("position", "velocity", torque=torque, steps=300, friction={"viscous": (10.0, 5.0)})
    start = np.concatenate([position[0], velocity[0]])
    expected = exact(TABLE_1, viscous, torque, start, np.arange(301) * 1e-3)
    np.testing.assert_allclose(position, expected, atol=1e-7)


@pytest.mark.parametrize("law", ["exact", "literal"])
def test_the_stribeck_curve_has_its_velocity(law):
    friction = {"coulomb": 3.0, "stiction": (4.0, 2.0), "stribeck_velocity": (0.2, 0.5)}
    velocity, torque = watch(
        "velocity", "friction_torque", torque=(100.0, 60.0), steps=200, friction={**friction, "law": law}
    )
    moving = np.abs(velocity) > 1e-9
    fade = np.exp(-((velocity / [0.2, 0.5]) ** 2))
    expected = np.sign(velocity) * (3.0 + np.array([4.0, 2.0]) * fade)
    np.testing.assert_allclose(torque[moving], expected[moving], rtol=1e-12)
    assert moving.mean() > 0.9


def test_a_stribeck_velocity_is_the_root_of_v_s():
    ours = watch("position", friction={"coulomb": 2.0, "stiction": 2.0, "stribeck_velocity": 0.5})[0]
    theirs = watch("position", friction={"coulomb": 2.0, "stiction": 2.0, "v_s": 0.25})[0]
    np.testing.assert_array_equal(ours, theirs)


def test_the_creep_of_the_printed_law_is_an_effect_of_the_step_size():
    creep = {}
    for h in (1e-3, 1e-4):
        env = TwoLinkArmEnv(
            action="torque",
            physics_dt=h,
            arm={"gravity": 0.0},
            friction={"coulomb": 10.0, "stiction": 10.0, "law": "literal"},
        )
        env.reset(seed=0)
        before = env.truth.position
        for _ in range(20):
            env.step((15.0, 0.0))
        creep[h] = abs(env.truth.position - before)[0]
    assert 0 < creep[1e-4] < 0.2 * creep[1e-3]


def test_two_widths_of_the_curve_are_an_error():
    with pytest.raises(ValueError, match="give v_s or stribeck_velocity, not both"):
        Friction(v_s=0.1, stribeck_velocity=0.1)
