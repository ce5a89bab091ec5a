"""The option `friction`: each part and law reaches the plant, and only there."""

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.twins import PLAIN, play, same


@pytest.mark.parametrize("law", ["exact", "literal"])
def test_each_part_of_friction(law):
    for part, expected in (
        ({"viscous": (4.0, 2.0)}, lambda v: np.array([4.0, 2.0]) * v),
        ({"coulomb": (4.0, 2.0)}, lambda v: np.array([4.0, 2.0]) * np.sign(v)),
        (
            {"stiction": (4.0, 2.0), "v_s": (0.1, 0.5)},
            lambda v: np.array([4.0, 2.0]) * np.exp(-(v**2) / [0.1, 0.5]) * np.sign(v),
        ),
    ):
        _, _, truths = play(friction={**part, "law": law})
        assert same(truths, PLAIN[2], "reference", "applied_torque", "lumped", "disturbance")
        assert not same(truths[5:], PLAIN[2][5:], "position")
        for truth in truths[1:]:
            moving = truth.velocity != 0.0
            np.testing.assert_allclose(
                truth.friction_torque[moving], expected(truth.velocity)[moving], rtol=1e-9, atol=1e-12
            )


def test_friction_of_one_joint_is_of_that_joint():
    for joint in (0, 1):
        level = [0.0, 0.0]
        level[joint] = 6.0
        for part in ("viscous", "coulomb", "stiction"):
            _, _, truths = play(steps=30, friction={part: level, "v_s": 100.0})
            friction = np.array([truth.friction_torque for truth in truths])
            assert not friction[..., 1 - joint].any()
            assert np.any(friction[5:, :, joint] != 0.0)


def test_the_laws_of_friction_differ_at_rest_only_in_what_sticks():
    """A joint at rest is held by the exact law, and feels nothing by the printed one."""
    rest = {"arm": {"gravity": 0.0}, "reference": {"kind": "minimum-jerk", "points": [(0.0, 0.0)]}, "action": "torque"}
    moved = {}
    for law in ("exact", "literal"):
        env = TwoLinkArmEnv(friction={"coulomb": 20.0, "law": law}, **rest)
        env.reset(seed=0)
        env.step((5.0, 0.0))
        moved[law] = env.truth.position
    np.testing.assert_array_equal(moved["exact"], 0.0)
    assert np.abs(moved["literal"]).max() > 0.0


def test_a_joint_that_keeps_moving_has_the_same_friction_by_both_laws():
    """The laws differ at rest; in motion both are the printed curve, so that a swing agrees as closely as the step allows."""
    swings = []
    for law in ("exact", "literal", None):
        friction = law and {"viscous": 1.0, "coulomb": (6.0, 3.0), "stiction": 2.0, "v_s": 4.0, "law": law}
        env = TwoLinkArmEnv(action="acceleration", friction=friction, physics_dt=1e-4)
        env.reset(seed=0)
        for _ in range(40):
            env.step((4.0, 6.0))
            assert np.all(env.truth.velocity > 0.0)
        swings.append(env.truth.position)
    np.testing.assert_allclose(swings[1], swings[0], rtol=0, atol=1e-4)
    assert np.abs(swings[2] - swings[0]).max() > 1e-2
