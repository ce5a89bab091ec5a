"""The dynamics equals Pinocchio's and the paper's equations, and has every arm's properties."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbl_gym import SECTION_2_2, TABLE_1, ArmParameters
from fbl_gym.model import arm as rigid

pin = pytest.importorskip("pinocchio")  # Windows has none

ARMS = {
    "table-1": TABLE_1,
    "section-2-2": SECTION_2_2,
    "rods": TABLE_1.as_rods(),
    "other": ArmParameters(3.0, 7.0, 0.4, 1.3, gravity=1.62, centre=0.4, inertia=0.05),
    "unequal links with rotors": ArmParameters.from_links(
        mass=(24.0, 4.0), length=(0.45, 0.4), centre=(0.1, -0.05), inertia=(1.3, 0.09), rotor=(0.7, 0.2)
    ),
    "horizontal": ArmParameters.from_lumped((3.3, 0.2, 0.24, 0.0, 0.0), (0.4, 0.3), rotor=0.1, gravity=0.0),
}
arms = pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS.keys())


def states(n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-np.pi, np.pi, (n, 2)), rng.uniform(-5, 5, (n, 2)), rng.uniform(-300, 300, (n, 2))


@arms
@pytest.mark.parametrize("shape", [(2,), (1, 2)], ids=str)
def test_one_arm_has_the_bits_of_its_row_in_a_batch(arm, shape):
    """Alone, it is computed with floats."""
    q, v, torque = states(40)
    signals = {
        rigid.inertia_matrix: (q,), rigid.coriolis_matrix: (q, v), rigid.gravity_torque: (q,),
        rigid.inverse_dynamics: (q, v, torque), rigid.forward_dynamics: (q, v, torque),
    }  # fmt: skip
    for function, arguments in signals.items():
        batch = function(arm, *arguments)
        for i in range(len(q)):
            alone = function(arm, *(x[i].reshape(shape) for x in arguments))
            assert alone.shape == shape[:-1] + batch.shape[1:]
            assert (alone == batch[i]).all()


def pinocchio_model(arm):
    """The arm in Pinocchio: in the plane of x and y, joints about z, gravity along -y."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -arm.gravity, 0.0])
    parent, place = 0, pin.SE3.Identity()
    for i, (mass, length) in enumerate(((arm.m1, arm.L1), (arm.m2, arm.L2))):
        joint = model.addJoint(parent, pin.JointModelRZ(), place, str(i))
        about_centre = arm.inertia[i] * mass * length**2 * np.eye(3)
        inertia = pin.Inertia(mass, np.array([arm.centre[i] * length, 0.0, 0.0]), about_centre)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        parent, place = joint, pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    model.armature = np.array(arm.rotor)
    return model


@arms
def test_the_model_equals_pinocchios(arm):
    """The terms, the accelerations of random states and torques, and the points."""
    model = pinocchio_model(arm)
    tip = model.addFrame(pin.Frame("tip", 2, pin.SE3(np.eye(3), np.array([arm.L2, 0, 0])), pin.FrameType.OP_FRAME))
    data = model.createData()
    for q, v, torque in zip(*states(500), strict=True):
        acceleration = pin.aba(model, data, q, v, torque)
        scale = np.abs(acceleration).max()
        np.testing.assert_allclose(rigid.forward_dynamics(arm, q, v, torque), acceleration, rtol=0, atol=1e-11 * scale)
        inertia = pin.crba(model, data, q)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        np.testing.assert_allclose(rigid.inertia_matrix(arm, q), inertia, rtol=1e-11)
        gravity = pin.computeGeneralizedGravity(model, data, q)
        np.testing.assert_allclose(rigid.gravity_torque(arm, q), gravity, rtol=1e-9, atol=1e-10)
        coriolis = pin.computeCoriolisMatrix(model, data, q, v)
        scale = np.abs(coriolis).max()
        np.testing.assert_allclose(rigid.coriolis_matrix(arm, q, v, skew=True), coriolis, rtol=0, atol=1e-12 * scale)
        pin.framesForwardKinematics(model, data, q)
        points = [data.oMi[1].translation, data.oMi[2].translation, data.oMf[tip].translation]
        np.testing.assert_allclose(rigid.joint_positions(arm, q), np.array(points)[:, :2], atol=1e-12)


@pytest.mark.parametrize("arm", [TABLE_1, SECTION_2_2])
def test_the_model_equals_the_papers_equations_as_printed(arm):
    """Equations (2), (3) and (4), copied from the paper."""
    m1, m2, L1, L2, g = arm.m1, arm.m2, arm.L1, arm.L2, arm.gravity
    for (t1, t2), (w1, w2), _ in zip(*states(50), strict=True):
        c2, s2 = np.cos(t2), np.sin(t2)
        m12 = m2 * L2**2 + m2 * L1 * L2 * c2
        m11 = m1 * L1**2 + m2 * L2**2 + m2 * L1**2 + 2 * m2 * L1 * L2 * c2
        np.testing.assert_allclose(rigid.inertia_matrix(arm, (t1, t2)), [[m11, m12], [m12, m2 * L2**2]], rtol=1e-13)
        h = m2 * L1 * L2 * s2
        printed = np.array([[-2 * w2 * h, -w2 * h], [w1 * h, 0.0]])
        np.testing.assert_allclose(rigid.coriolis_matrix(arm, (t1, t2), (w1, w2)), printed, rtol=1e-13)
        g2 = m2 * L2 * g * np.cos(t1 + t2)
        g1 = m1 * L1 * g * np.cos(t1) + m2 * L1 * g * np.cos(t1) + g2
        np.testing.assert_allclose(rigid.gravity_torque(arm, (t1, t2)), [g1, g2], rtol=1e-12, atol=1e-10)


def two(low, high):
    return st.tuples(st.floats(low, high), st.floats(low, high))


number, angles = st.floats(0.05, 50.0), two(-10, 10)
anyone = st.builds(ArmParameters, *[number] * 4, st.floats(0, 20), two(0.1, 1.0), two(0, 1), two(0, 1))


@settings(deadline=None)
@given(anyone, angles, angles, angles)
def test_inertia_is_positive_definite_and_inverse_and_forward_dynamics_and_regressor_agree(arm, q, v, a):
    """For links that differ up to a thousandfold."""
    m = rigid.inertia_matrix(arm, q)
    assert m[0, 1] == m[1, 0]
    assert m[0, 0] > 0
    assert m[0, 0] * m[1, 1] - m[0, 1] ** 2 > 0
    torque = rigid.inverse_dynamics(arm, q, v, a)
    scale = np.abs(torque).max() + 1e-9
    linear = rigid.regressor(q, v, a) @ arm.lumped + np.array(arm.rotor) * a
    np.testing.assert_allclose(linear, torque, rtol=1e-10, atol=1e-11 * scale)
    tolerance = 1e-13 * np.linalg.cond(m) * (np.abs(a).max() + scale / np.abs(m).max())
    np.testing.assert_allclose(rigid.forward_dynamics(arm, q, v, torque), a, rtol=0, atol=tolerance + 1e-12)


def test_links_in_absolute_numbers():
    """The numbers of a data sheet, in the formulas of a textbook; rods are such links."""
    (m1, m2), (L1, L2), (c1, c2), (i1, i2) = (24.0, 4.0), (0.45, 0.4), (0.1, 0.05), (1.3, 0.09)
    arm = ArmParameters.from_links((m1, m2), (L1, L2), (c1, c2), (i1, i2))
    g = arm.gravity
    textbook = [m1 * c1**2 + i1 + m2 * L1**2, m2 * c2**2 + i2, m2 * L1 * c2, (m1 * c1 + m2 * L1) * g, m2 * c2 * g]
    np.testing.assert_allclose(arm.lumped, textbook, rtol=1e-14)
    rods = ArmParameters.from_links((m1, m2), (L1, L2), (L1 / 2, L2 / 2), (m1 * L1**2 / 12, m2 * L2**2 / 12))
    np.testing.assert_allclose(rods.lumped, ArmParameters(m1, m2, L1, L2).as_rods().lumped, rtol=1e-14)


@arms
def test_lumped_parameters_make_an_arm_that_has_them(arm):
    """A counterweight too; where only the rotor has inertia, p3 is 0."""
    again = ArmParameters.from_lumped(arm.lumped, (arm.L1, arm.L2), arm.rotor, arm.gravity)
    np.testing.assert_allclose(again.lumped, arm.lumped, rtol=1e-12)
    assert (abs(again.centre[0]) <= 1.0, ArmParameters(centre=(1.0, 0.0), rotor=0.1).lumped[2]) == (True, 0.0)


BALANCED = ArmParameters(m1=3.0, m2=2.0, L1=0.4, L2=0.3, centre=(0.5, 0.0), inertia=1 / 12)


@pytest.mark.parametrize(("make", "message"), [
    (lambda: ArmParameters(centre=(1.0, 0.0)), "inertia about both joints"),
    (lambda: ArmParameters.from_lumped((1.0, 1.0, 2.0, 0.0, 0.0), (1.0, 1.0), gravity=0.0), "p1 p2 > p3"),
    (lambda: ArmParameters.from_lumped((3.0, 1.0, 1.0, 20.0, 20.0), (1.0, 1.0)), "p3 g = p5 L1"),
    (lambda: ArmParameters.from_lumped(BALANCED.lumped, (0.4, 0.3)), "neither link balanced"),
    (lambda: ArmParameters.from_links((0.0, 1.0), (1.0, 1.0), (0.5, 0.5), (0.1, 0.1)), r"mass\[0\] .* 0, got 0.0"),
], ids=["centre", "inertia", "gravity", "balanced", "mass"])  # fmt: skip
def test_an_arm_that_cannot_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
