"""Arms of laboratories: their numbers against those of their sources, and their scenarios."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from fbl_gym import Scenario
from fbl_gym.model.arm import forward_dynamics, gravity_torque, inertia_matrix, inverse_dynamics
from fbl_gym.model.real_arms import REAL_ARMS
from fbl_gym.scenarios import get

STATES = np.random.default_rng(0).uniform(-3, 3, (50, 2))


DFKI = {  # m1, m2, l1, r1, r2, I1, I2, Ir of the files of parameters
    "dfki-c1": (
        0.5234602302310271, 0.6255677234174437, 0.2, 0.2, 0.25569305436052964,
        0.031887199591513114, 0.05086984812807257, 6.287203962819607e-05,
    ),
    "dfki-a0": (
        0.5593806151425046, 0.6043459469186889, 0.3, 0.3, 0.18377686083653508,
        0.053470810264216295, 0.02392374528789766, 7.659297952841183e-05,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DFKI)
def test_dfkis_arm_has_the_accelerations_of_its_plant_file(name):
    """`plant.py` written out: the matrices with the rotors' coupling, angles from hanging, inertia about the joint."""
    (m1, m2, l1, r1, r2, I1, I2, Ir), gr, g = DFKI[name], 6.0, 9.81
    for x, (v1, v2), u in zip(STATES, 3 * STATES[::-1], STATES**2, strict=True):
        q1, q2 = x
        m22, m12 = I2 + gr**2 * Ir, I2 + m2 * l1 * r2 * math.cos(q2) - gr * Ir
        m11 = I1 + I2 + m2 * l1**2 + 2 * m2 * l1 * r2 * math.cos(q2) + (gr**2 + 1) * Ir
        h = m2 * l1 * r2 * math.sin(q2)
        coriolis = np.array([[-2 * h * v2, -h * v2], [h * v1, 0.0]]) @ (v1, v2)
        down2 = m2 * g * r2 * math.sin(q1 + q2)
        gravity = np.array([m1 * g * r1 * math.sin(q1) + m2 * g * l1 * math.sin(q1) + down2, down2])
        theirs = np.linalg.solve([[m11, m12], [m12, m22]], u - coriolis - gravity)
        ours = forward_dynamics(REAL_ARMS[name], (q1 - math.pi / 2, q2), (v1, v2), u)
        np.testing.assert_allclose(ours, theirs, rtol=1e-11)


def test_the_direct_drive_arm_has_the_matrices_of_its_second_source():
    for q in STATES:
        c = math.cos(q[1])
        theirs = [[2.351 + 0.1676 * c, 0.102 + 0.0838 * c], [0.102 + 0.0838 * c, 0.102]]
        np.testing.assert_allclose(inertia_matrix(REAL_ARMS["cicese"], q), theirs, atol=1e-3)
        s1, s12 = math.sin(q[0]), math.sin(q.sum())
        gravity = gravity_torque(REAL_ARMS["cicese"], (q[0] - math.pi / 2, q[1]))
        np.testing.assert_allclose(gravity, [9.81 * (3.9211 * s1 + 0.1862 * s12), 9.81 * 0.1862 * s12], atol=2e-3)


def test_the_pelicans_largest_gravity_torque():
    assert gravity_torque(REAL_ARMS["pelican"], (0.0, 0.0))[0] == pytest.approx(11.967, abs=1e-3)


@pytest.mark.parametrize("name", REAL_ARMS)
def test_every_arm_is_known_by_name_and_physical(name):
    arm = REAL_ARMS[name]
    assert Scenario(arm=name).arm == arm
    assert min(*arm.inertia, *arm.centre) > 0.0
    assert max(arm.centre) <= (1.0 if "identified" not in name else 1.1)


def test_identified_arms_have_the_numbers_of_the_page():
    """p1 with the first rotor, p2, p4 and p5, as docs/reference/arms.md has them."""
    page = (Path(__file__).parents[2] / "docs" / "reference" / "arms.md").read_text(encoding="utf-8")
    for i, name in enumerate(("dfki-c1-identified", "dfki-a0-identified")):
        arm = REAL_ARMS[name]
        p1, p2, _, p4, p5 = arm.lumped
        for label, number in (("p1", p1 + arm.rotor[0]), ("p2", p2), ("p4", p4), ("p5", p5), ("rotor 2", arm.rotor[1])):
            (row,) = [line for line in page.splitlines() if line.startswith(f"| {label} [")]
            assert float(row.split("|")[3 + 2 * i].split()[0]) == pytest.approx(number, rel=1e-9), label


@pytest.mark.parametrize("name", ["dfki-c1", "dfki-a0", "cicese"])
def test_the_reference_stays_within_the_torque_limits(name):
    """With friction, two thirds of the limit are enough between the corners of its box, and 70 % within it."""
    scenario = get(name)
    reference, friction = scenario.reference, scenario.friction
    inside = np.random.default_rng(0).uniform(reference.low, reference.high, (30, 2))
    corners = [*itertools.product(*zip(reference.low, reference.high, strict=True))]
    moves = [(move, 2 / 3) for move in itertools.product(corners, repeat=2)]
    moves += [(move, 0.7) for move in itertools.product([*corners, *inside], repeat=2)]
    s, T = np.linspace(0.0, 1.0, 41)[:, None], reference.move_time
    shape = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2 / T, 60 * s * (1 - s) * (1 - 2 * s) / T**2
    for (first, last), share in moves:
        path, v, a = (part * np.subtract(last, first) for part in shape)
        torque = np.abs(inverse_dynamics(scenario.arm, first + path, v, a)) + friction.viscous * np.abs(v)
        assert np.all(torque + friction.coulomb < np.multiply(share, scenario.actuator.torque_limit))
