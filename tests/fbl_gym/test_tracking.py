"""`fbl_gym/TwoLinkArmTracking-v0`: the observation of agents. `test_vector_env.py` compares batches with single arms."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv, TwoLinkArmVectorEnv
from fbl_gym.envs.error_scales import ErrorScales
from tests.fbl_gym.episodes import ID, TRACKING


def test_the_shape_is_the_same_with_and_without_an_acceleration_sensor():
    sensors = ("position", "velocity", "acceleration")
    for number, size in ((3, 12), (2, 12), (1, 8)):
        assert gym.make(TRACKING, sensors=sensors[:number]).reset(seed=0)[0].shape == (size,)


@pytest.mark.parametrize("name", [ID, TRACKING])
def test_the_spec_has_the_episodes_length_and_survives_json(name):
    with np.printoptions(legacy="1.13"):  # which shortens texts of numbers
        third = gym.make(name, initial_error=np.float64(1 / 3)).unwrapped.scenario.initial_error
    assert third == (1 / 3, 1 / 3)
    env = gym.make(name, duration=np.float32(0.3), control_dt=0.005, initial_error=np.array([0.1, 0.2], np.float32))
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario == env.unwrapped.scenario
    batch = gym.make_vec(name, 2, "vector_entry_point", duration=0.3, max_episode_steps=20)
    usual, *others = (gym.make(name, **most) for most in ({}, {"max_episode_steps": 50}, {"max_episode_steps": 5000}))
    lengths = [each.spec.max_episode_steps for each in (env, again, batch, usual, *others)]
    assert lengths == [60, 60, 20, 1000, 50, 1000]
    assert EnvSpec.from_json(others[1].spec.to_json()).max_episode_steps == 1000


def test_a_batch_has_gymnasiums_class_among_its_direct_bases():
    """There skrl's `wrap_env` looks for it."""
    for batch in (TwoLinkArmVectorEnv, TwoLinkArmTrackingVectorEnv):
        assert gym.vector.VectorEnv in batch.__bases__


DELAYED = {"scenario": "everything-2", "preview": 2, "actuator": {"delay": 0.01}}


@pytest.mark.parametrize("options", [{}, {"scenario": "servo-nominal"}, DELAYED], ids=str)
def test_error_coordinates_are_the_documented_ones(options):
    plain, tracking = TwoLinkArmEnv(**options, past_actions=1), gym.make(TRACKING, **options)
    assert tracking.observation_space == ErrorScales(plain.interface).space
    assert tracking.observation_space.dtype == np.float32
    a, b = plain.reset(seed=1)[0], tracking.reset(seed=1)[0]
    for k in range(20):
        at = plain.layout
        q, v, now = a[at["position"]], a[at["velocity"]], a[at.reference[:6]]
        scale = np.array([0.1, 0.1, 1.0, 1.0, 10.0, 10.0])
        expected = [(now[:4] - [*q, *v]) / scale[:4], q + [np.pi / 2, 0.0], v, now[4:] / 10.0]
        samples = a[at["preview"]].reshape(-1, 6) if "preview" in at else ()
        expected += [*((sample - now) / scale for sample in samples), a[at["previous_actions"]]]
        np.testing.assert_allclose(b, np.clip(np.concatenate(expected), -10, 10), rtol=1e-6, atol=1e-6)
        assert b in tracking.observation_space
        action = np.array([0.05 * k, -0.3], dtype=np.float32)
        a, b = plain.step(action)[0], tracking.step(action)[0]
        np.testing.assert_array_equal(a[at["previous_actions"]][:2], action)


@pytest.mark.parametrize("preview", [0, 2])
def test_history_fine_scales_and_data_sheet_change_their_entries_alone(preview):
    options = {"scenario": "servo-delay-2", "preview": preview, "duration": 0.2}
    plain, fine = TwoLinkArmTrackingEnv(**options), TwoLinkArmTrackingEnv(**options, fine=(0.002, 0.05))
    drive, stacked = TwoLinkArmTrackingEnv(**options, drive=True), TwoLinkArmTrackingEnv(**options, history=2)
    size, sheet = plain.observation_space.shape[0], plain.interface
    last = size - (plain.layout["previous_actions"].stop - plain.layout["previous_actions"].start)
    stated = np.array([*np.divide([*sheet.delay, *sheet.lag], 0.05), 1.0, 0.0, 0.0], np.float32)
    assert stacked.observation_space.shape == (3 * size,)
    rng = np.random.default_rng(0)
    for seed in (1, 2):
        a, *others = (env.reset(seed=seed)[0] for env in (plain, fine, drive, stacked))
        frames = [np.zeros_like(a), np.zeros_like(a), a]
        for _ in range(10):
            b, c, d = others
            errors = np.sinh(b[:4].astype(float)) * [0.002, 0.002, 0.05, 0.05]
            np.testing.assert_allclose(errors, a[:4] * [0.1, 0.1, 1.0, 1.0], rtol=3e-6, atol=1e-9)
            np.testing.assert_array_equal(b[4:], a[4:])
            np.testing.assert_array_equal(c, np.concatenate([a[:last], stated, a[last:]]))
            np.testing.assert_array_equal(d, np.concatenate(frames[-3:]))
            action = rng.uniform(-1, 1, 2)
            a, *others = (env.step(action)[0] for env in (plain, fine, drive, stacked))
            frames.append(a)


def test_the_widest_errors_are_the_bounds_of_fine_scales():
    env = TwoLinkArmTrackingEnv("nominal", fine=(0.002, 0.05), reward={"tracking": "l1"})
    observation = env.reset(options={"position": (9.0, -9.0), "velocity": (90.0, -90.0)})[0]
    high = env.observation_space.high[:4]
    np.testing.assert_allclose(high, np.arcsinh([500, 500, 200, 200]), rtol=1e-6)
    np.testing.assert_array_equal(observation[:4], high * [-1, 1, -1, 1])


@pytest.mark.parametrize(("options", "message"), [
    ({"history": -1}, "history must be a whole number not below 0"),
    ({"drive": "no"}, "drive must be True or False, got 'no'"),
    ({"fine": 0.0}, "fine must be .* greater than 0, got 0"),
    ({"fine": (1, 2, 3)}, r"fine must be one number, or one for each"),
])  # fmt: skip
def test_a_wrong_option_is_named(options, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmTrackingEnv(**options)
