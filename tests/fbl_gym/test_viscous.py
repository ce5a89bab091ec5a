"""Viscous friction, and the Stribeck curve."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fbl_gym import TABLE_1, TwoLinkArmEnv
from fbl_gym.model.arm import forward_dynamics
from tests.fbl_gym.paired_runs import watch

LIGHT = {"m1": 0.05, "m2": 0.02, "L1": 0.2, "L2": 0.2}


def exact(arm, viscous, torque, start, times):
    def slope(_, x):
        return np.concatenate([x[2:], forward_dynamics(arm, x[:2], x[2:], torque - viscous * x[2:])])

    return solve_ivp(slope, (0, times[-1]), start, "Radau", times, rtol=1e-9, atol=1e-11).y[:2].T


def test_a_step_too_long_for_the_friction_is_refused_with_one_that_does():
    options = {"arm": LIGHT, "friction": {"viscous": 5.0}}
    with pytest.raises(ValueError, match=r"physics_dt=0\.001 s is too long for this friction") as error:
        TwoLinkArmEnv(**options)
    step = float(re.search(r"physics_dt=([0-9.e-]+) s would do", str(error.value)).group(1))
    env = TwoLinkArmEnv(**options, physics_dt=0.01 / round(0.01 / step), initial_velocity=10.0)
    env.reset(seed=0)
    assert not env.step((0.0, 0.0))[2]
    assert np.abs(env.truth.velocity).max() < 1.0


def test_moderate_viscous_friction_keeps_the_fourth_order():
    viscous, torque = np.array([10.0, 5.0]), np.array([40.0, 10.0])
    position, velocity = watch("position", "velocity", torque=torque, steps=300, friction={"viscous": (10.0, 5.0)})
    start = np.concatenate([position[0], velocity[0]])
    expected = exact(TABLE_1, viscous, torque, start, np.arange(301) * 1e-3)
    np.testing.assert_allclose(position, expected, atol=1e-7)


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
