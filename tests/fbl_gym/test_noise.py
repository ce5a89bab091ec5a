"""The observation: its sensors with noise, bias and rounding, which touch nothing else, and its slots."""

import numpy as np
import pytest
from scipy import stats

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import PLANT, WAYS, plain, play, same


@pytest.mark.parametrize("sensor", WAYS)
def test_noise_is_white_has_its_sigma_and_touches_only_its_sensor(sensor):
    sigma = (0.02, 0.05)
    layout, seen, truths = play(noise={sensor: sigma})
    assert same(truths, plain()[2], *PLANT)
    noise = (seen - plain()[1])[..., layout[sensor]]
    for other in set(WAYS) - {sensor}:
        assert np.array_equal(seen[..., layout[other]], plain()[1][..., layout[other]])
    for joint in (0, 1):
        x = noise[..., joint]
        assert x.std() == pytest.approx(sigma[joint], rel=0.03)
        assert abs(x.mean()) < 4 * sigma[joint] / np.sqrt(x.size)
        assert stats.kstest(x.ravel() / sigma[joint], "norm").pvalue > 1e-3
        assert abs(np.corrcoef(x[1:].ravel(), x[:-1].ravel())[0, 1]) < 0.05
        assert abs(np.corrcoef(x[:, 1:].ravel(), x[:, :-1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1]) < 0.05


def test_noise_is_new_in_each_episode_and_seed_and_the_same_for_every_policy():
    env, plain = TwoLinkArmVectorEnv(3, noise={"position": 1.0}), TwoLinkArmVectorEnv(3)

    def noises(action, **start):
        """Return the position noise [50 x 3 lanes x 2]."""
        rows = [env.reset(**start)[0] - plain.reset(**start)[0]]
        for _ in range(49):
            actions = np.full((3, 2), action)
            rows.append(env.step(actions)[0] - plain.step(actions)[0])
        return np.array(rows)[..., :2]

    first, second = noises(0.0, seed=0), noises(0.0)
    again, shifted = noises(0.2, seed=0), noises(0.0, seed=1)
    np.testing.assert_allclose(first, again, atol=1e-12)
    np.testing.assert_allclose(first[:, 1:], shifted[:, :-1], atol=1e-12)  # lane i has the seed s + i
    columns = np.concatenate([first, second, shifted[:, 2:]], axis=1).reshape(50, -1).T
    assert np.abs(np.corrcoef(columns) - np.eye(14)).max() < 0.6
    assert not np.any(first == second)


def test_a_reading_is_bias_then_noise_then_rounding():
    quantum, bias = np.array([0.01, 0.25]), np.array([0.5, -1.0])
    for sensor in WAYS:
        sigma = {"sigma": (0.03, 0.2)}
        layout, noisy, _ = play(noise={sensor: sigma})
        _, seen, truths = play(noise={sensor: {**sigma, "bias": bias, "quantization": quantum}})
        expected = np.floor((noisy[..., layout[sensor]] + bias) / quantum + 0.5) * quantum
        np.testing.assert_array_equal(seen[..., layout[sensor]], expected)
        assert same(truths, plain()[2], *PLANT)


def test_a_signal_to_noise_ratio_gives_its_variance():
    """1 dB against unit power is variance 0.794, and 10 dB is 0.1, as in the errata."""
    for snr, variance in ((1.0, 0.794), (10.0, 0.1)):
        layout, seen, _ = play(noise={"position": {"snr_db": snr}})
        assert (seen - plain()[1])[..., layout["position"]].var() == pytest.approx(variance, rel=0.05)


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
