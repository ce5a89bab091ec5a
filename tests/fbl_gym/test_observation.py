"""The observation: the sensors of the scenario, and the preview of the reference."""

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.paired_runs import PLANT, WAYS, plain, play, same


def test_perfect_sensors_read_the_truth():
    layout, seen, truths = plain()
    for name in WAYS:
        assert np.array_equal(seen[..., layout[name]], [getattr(truth, name) for truth in truths])


def test_a_sensor_that_is_missing_leaves_its_slot_out():
    layout, seen, truths = play(sensors=("position",))
    assert same(truths, plain()[2], *PLANT)
    assert "velocity" not in layout
    assert "acceleration" not in layout
    assert layout.size == 8
    assert np.array_equal(seen[..., layout["position"]], plain()[1][..., plain()[0]["position"]])
    assert np.array_equal(seen[..., layout["reference_velocity"]], plain()[1][..., plain()[0]["reference_velocity"]])
    with pytest.raises(ValueError, match="unknown slot of the observation 'velocity'"):
        layout["velocity"]


@pytest.mark.parametrize(
    "sensors", [("position", "velocity"), ("position", "acceleration"), ("acceleration", "position")]
)
def test_sensors_in_any_order_fill_their_slots(sensors):
    layout, seen, truths = play(sensors=sensors)
    assert same(truths, plain()[2], *PLANT)
    for name in WAYS:
        assert (name in layout) == (name in sensors)
        if name in sensors:
            assert np.array_equal(seen[..., layout[name]], plain()[1][..., plain()[0][name]])
    assert [slot.name for slot in layout.slots][: len(sensors)] == [name for name in WAYS if name in sensors]


def test_the_first_observation_of_a_heavy_unlimited_arm_lies_in_its_space():
    """The torque that holds it, the previous action, exceeds the box of a torque action."""
    env = TwoLinkArmEnv(arm={"m1": 1e5, "L1": 50.0}, action="torque", actuator={"torque_limit": None, "delay": 0.01})
    assert all(env.reset(seed=seed)[0] in env.observation_space for seed in range(10))
