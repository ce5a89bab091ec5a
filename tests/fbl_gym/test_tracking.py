"""`fbl_gym/TwoLinkArmTracking-v0`: the observation of learning agents. `test_lanes.py` compares batches with single arms."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv, TwoLinkArmVectorEnv
from fbl_gym.envs.error_scales import ErrorScales
from tests.fbl_gym.episodes import ID, TRACKING


@pytest.mark.parametrize("scenario", ["nominal", "everything-2", "servo-nominal"])
def test_the_observation_is_that_of_the_error_coordinates_with_the_previous_action(scenario):
    env = gym.make(TRACKING, scenario=scenario)
    twin = TwoLinkArmEnv(scenario, past_actions=1)
    errors = ErrorScales(twin.interface)
    assert env.observation_space == errors.space
    assert env.observation_space.dtype == np.float32
    observation = env.reset(seed=3)[0]
    np.testing.assert_array_equal(observation, errors.single_precision(twin.reset(seed=3)[0]))
    for k in range(5):
        action = np.array([0.1 * k, -0.3], dtype=np.float32)
        observation = env.step(action)[0]
        np.testing.assert_array_equal(observation, errors.single_precision(twin.step(action)[0]))
        np.testing.assert_array_equal(observation[10:12], action)
        assert env.observation_space.contains(observation)


def test_the_shape_is_the_same_with_and_without_an_acceleration_sensor():
    assert gym.make(TRACKING).observation_space.shape == (12,)
    assert gym.make(TRACKING, sensors=("position", "velocity")).observation_space.shape == (12,)
    assert gym.make(TRACKING, sensors=("position",)).reset(seed=0)[0].shape == (8,)


@pytest.mark.parametrize("name", [ID, TRACKING])
def test_the_spec_has_the_episodes_length_and_survives_json(name):
    assert gym.make(name).spec.max_episode_steps == 1000
    env = gym.make(name, duration=0.3, control_dt=0.005)
    assert env.spec.max_episode_steps == 60
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert (again.spec.max_episode_steps, again.unwrapped.scenario) == (60, env.unwrapped.scenario)
    batch = gym.make_vec(name, 2, "vector_entry_point", duration=0.3, max_episode_steps=20)
    assert batch.spec.max_episode_steps == 20
    assert [gym.make(name, max_episode_steps=n).spec.max_episode_steps for n in (50, 5000)] == [50, 1000]
    assert EnvSpec.from_json(gym.make(name, max_episode_steps=5000).spec.to_json()).max_episode_steps == 1000


def test_a_batch_has_gymnasiums_class_among_its_direct_bases():
    """There skrl's `wrap_env` looks for it."""
    for batch in (TwoLinkArmVectorEnv, TwoLinkArmTrackingVectorEnv):
        assert gym.vector.VectorEnv in batch.__bases__


OPTIONS = {"scenario": "everything-2", "duration": 0.5, "preview": 2, "actuator": {"delay": 0.01}}


def test_error_coordinates_are_the_documented_ones():
    plain, tracking = TwoLinkArmEnv(**OPTIONS), TwoLinkArmTrackingEnv(**OPTIONS)
    a, b = plain.reset(seed=1)[0], tracking.reset(seed=1)[0]
    for _ in range(20):
        at = plain.layout
        expected = [
            (a[at["reference_position"]] - a[at["position"]]) / 0.1,
            a[at["reference_velocity"]] - a[at["velocity"]],
            a[at["position"]] + [np.pi / 2, 0.0],
            a[at["velocity"]],
            a[at["reference_acceleration"]] / 10.0,
        ]
        now = np.concatenate([a[at[f"reference_{name}"]] for name in ("position", "velocity", "acceleration")])
        scale = np.array([0.1, 0.1, 1.0, 1.0, 10.0, 10.0])
        expected += [(sample - now) / scale for sample in a[at["preview"]].reshape(2, 6)]
        expected.append(a[at["previous_actions"]])
        np.testing.assert_allclose(b, np.clip(np.concatenate(expected), -10, 10), rtol=1e-6, atol=1e-6)
        a, b = plain.step((0.1, -0.2))[0], tracking.step((0.1, -0.2))[0]
