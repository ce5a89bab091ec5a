"""The observation: the sensors of the scenario, and the preview of the reference."""

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.paired_runs import PLANT, WAYS, plain, play, same


def test_perfect_sensors_read_the_truth():
    layout, seen, truths = plain()
    for name in WAYS:
        assert np.array_equal(seen[..., layout[name]], [getattr(truth, name) for truth in truths])
    assert np.array_equal(truths[-1].motor_position, truths[-1].position)  # a rigid arm's motor is its link


SENSED = [("position",), ("position", "velocity"), ("position", "acceleration"), ("acceleration", "position")]


@pytest.mark.parametrize("sensors", SENSED, ids=str)
def test_sensors_in_any_order_fill_their_slots_and_the_missing_have_none(sensors):
    (layout, seen, truths), (usual_layout, usual, usual_truths) = play(sensors=sensors), plain()
    assert same(truths, usual_truths, *PLANT)
    assert [slot.name for slot in layout.slots][: len(sensors)] == [name for name in WAYS if name in sensors]
    assert layout.size == len(layout.names) == seen.shape[-1] == 2 * len(sensors) + 6
    for name in (*sensors, "reference_velocity"):
        np.testing.assert_array_equal(seen[..., layout[name]], usual[..., usual_layout[name]])
    for name in set(WAYS).difference(sensors):
        assert name not in layout
        with pytest.raises(ValueError, match=f"unknown slot of the observation '{name}'"):
            layout[name]


def test_the_first_observation_of_a_heavy_unlimited_arm_lies_in_its_space():
    """The torque that holds it, the previous action, exceeds the box of a torque action."""
    env = TwoLinkArmEnv(arm={"m1": 1e5, "L1": 50.0}, action="torque", actuator={"torque_limit": None, "delay": 0.01})
    assert all(env.reset(seed=seed)[0] in env.observation_space for seed in range(10))
