"""The option `friction`: each part and law reaches the plant, and only there."""

import math
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fbl_gym import TwoLinkArmEnv
from fbl_gym.model.arm import forward_dynamics
from tests.fbl_gym.episodes import DRY, FLAT, flat, started, watch


@pytest.mark.parametrize("v_s", [(1e-3, 2e-3), (0.5, 0.9)])
def test_the_literal_law_is_the_printed_formula(v_s):
    """A motion under equation (43) agrees with the solver to 1e-8; the larger v_s tests all of the curve."""

    def printed(v):
        """Return f_i1 v + (f_i2 + f_s exp(-v^2 / v_s)) sign(v)."""
        dry = np.array([20.0, 8.0]) + (10.0, 4.0) * np.exp(-(v**2) / np.array(v_s))
        return np.array([3.0, 1.0]) * v + dry * np.sign(v)

    turning = {"kind": "sine", "amplitude": 1.0, "phase": (0.0, math.pi)}
    friction = {**DRY, "viscous": (3.0, 1.0), "v_s": v_s, "law": "literal"}
    env = flat(reference=turning, friction=friction, physics_dt=5e-4)
    torque = np.array([40.0, -40.0])
    state = np.concatenate([env.truth.position, env.truth.velocity])
    np.testing.assert_allclose(env.truth.friction_torque, printed(state[2:]), rtol=1e-12)

    def slope(_, x):
        return np.concatenate([x[2:], forward_dynamics(FLAT, x[:2], x[2:], torque - printed(x[2:]))])

    solved = solve_ivp(slope, (0.0, 1.0), state, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
    assert solved.y[2].min() > 0.1  # joint 1 turns one way throughout, joint 2 the other
    assert solved.y[3].max() < -0.1
    for k in range(1, 101):
        env.step(torque)
        truth, right = env.truth, solved.sol(0.01 * k)
        np.testing.assert_allclose(np.concatenate([truth.position, truth.velocity]), right, rtol=0, atol=1e-8)
        np.testing.assert_allclose(truth.friction_torque, printed(truth.velocity), rtol=1e-12)


def test_the_literal_law_has_no_friction_at_rest():
    """sign(0) = 0: under any load, the arm starts with the acceleration of an arm without friction."""
    env = flat(friction={**DRY, "law": "literal"}, disturbance={"kind": "array", "torque": ((-6.0, 2.0),)})
    free = forward_dynamics(FLAT, (0.4, 0.7), (0.0, 0.0), (6.0, -2.0))
    np.testing.assert_allclose(env.truth.acceleration, free, rtol=1e-12)
    assert env.truth.friction_torque.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("law", ["exact", "literal"])
def test_a_loaded_gear_has_friction_by_its_drives_torque(law):
    torque, applied, velocity = watch(
        "friction_torque", "applied_torque", "velocity",
        torque=(120.0, 60.0), friction={"coulomb": 3.0, "load": (0.1, 0.2), "law": law},
    )  # fmt: skip
    moving = np.abs(velocity) > 1e-9
    expected = np.sign(velocity) * (3.0 + np.array([0.1, 0.2]) * np.abs(applied))
    assert moving.mean() > 0.7
    np.testing.assert_allclose(torque[moving], expected[moving], rtol=1e-9)


def test_a_loaded_elastic_joint_moves_as_one_with_that_coulomb_friction():
    """Under a held torque, 10 % of it are 12 and 6 N m more of Coulomb friction."""
    joint = {"stiffness": 5000.0, "damping": 5.0, "rotor_inertia": 0.5}
    given = [{"coulomb": 3.0, "load": 0.1}, {"coulomb": (15.0, 9.0)}]
    ours, theirs = (watch("position", "motor_position", torque=(120.0, 60.0), joint=joint, friction=f) for f in given)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


def test_a_loaded_gear_agrees_with_mujoco():
    """MuJoCo's dry friction is another model of sticking; sliding is the same."""
    pytest.importorskip("mujoco")
    friction = {"coulomb": 3.0, "load": (0.1, 0.2)}
    ours, theirs = (watch("position", torque=(160.0, 90.0), friction=friction, plant=x)[0] for x in (None, "mujoco"))
    (without,) = watch("position", torque=(160.0, 90.0), friction={"coulomb": 3.0})
    assert np.abs(ours - theirs).max() < 0.01 * np.abs(ours - without).max()


LIGHT = {"m1": 0.05, "m2": 0.02, "L1": 0.2, "L2": 0.2}


def test_a_step_too_long_for_the_friction_is_refused_with_one_that_does():
    options = {"arm": LIGHT, "friction": {"viscous": 5.0}}
    with pytest.raises(ValueError, match=r"physics_dt=0\.001 s is too long for this friction") as error:
        TwoLinkArmEnv(**options)
    step = float(re.search(r"physics_dt=([0-9.e-]+) s would do", str(error.value)).group(1))
    env = started(**options, physics_dt=0.01 / round(0.01 / step), initial_velocity=10.0)
    assert not env.step((0.0, 0.0))[2]
    assert np.abs(env.truth.velocity).max() < 1.0
