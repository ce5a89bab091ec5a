"""The observation: its sensors with noise, bias and rounding, which touch nothing else, and its slots."""

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

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
    envs = TwoLinkArmVectorEnv(3, noise={"position": 1.0}), TwoLinkArmVectorEnv(3)

    def noises(action, **start):
        """Return the position noise [50 x 3 lanes x 2]."""
        actions = np.full((49, 3, 2), action)
        noisy, plain = ([env.reset(**start)[0], *(env.step(each)[0] for each in actions)] for env in envs)
        return np.subtract(noisy, plain)[..., :2]

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
        layout, noisy, _ = play(noise={sensor: (0.03, 0.2)})
        _, seen, truths = play(noise={sensor: {"sigma": (0.03, 0.2), "bias": bias, "quantization": quantum}})
        expected = np.floor((noisy[..., layout[sensor]] + bias) / quantum + 0.5) * quantum
        np.testing.assert_array_equal(seen[..., layout[sensor]], expected)
        assert same(truths, plain()[2], *PLANT)


def test_a_signal_to_noise_ratio_gives_its_variance():
    """1 dB against unit power is variance 0.794, and 10 dB is 0.1, as in the errata."""
    for snr, variance in ((1.0, 0.794), (10.0, 0.1)):
        layout, seen, _ = play(noise={"position": {"snr_db": snr}})
        assert (seen - plain()[1])[..., layout["position"]].var() == pytest.approx(variance, rel=0.05)


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


def readings(**options):
    """Return position and velocity readings [steps + 1 x lanes x 2] and the truths of a run."""
    layout, seen, truths = play(**options)
    return seen[..., layout["position"]], seen[..., layout["velocity"]], truths


@pytest.mark.parametrize("encoder", [
    4096, {"counts": (500, 1000)}, {"difference": 2}, {"difference": 1, "low_pass": 20.0}, {"latency": 3},
    {"dropout": 0.1, "dropout_length": 2},
], ids=str)  # fmt: skip
def test_an_encoder_reaches_the_readings_and_nothing_else(encoder):
    layout, seen, truths = play(encoder=encoder)
    assert same(truths, plain()[2], *PLANT)
    assert not np.array_equal(seen, plain()[1])
    rest = np.ones(seen.shape[-1], dtype=bool)
    rest[layout["position"]] = rest[layout["velocity"]] = False
    np.testing.assert_array_equal(seen[..., rest], plain()[1][..., rest])


def test_counts_round_the_position_to_parts_of_a_turn():
    position, _, truths = readings(encoder={"counts": (512, 1000)})
    steps = 2 * np.pi / np.array([512, 1000])
    expected = steps * np.round([truth.position for truth in truths] / steps)
    np.testing.assert_allclose(position, expected, atol=1e-9)


@pytest.mark.parametrize(("n", "low_pass"), [(1, None), (4, None), (1, 15.0), (3, 40.0)])
def test_a_computed_velocity_is_scipys_filtered_difference(n, low_pass):
    encoder = {"counts": 4096, "difference": n, "low_pass": low_pass}
    position, velocity, truths = readings(encoder=encoder)
    dt, quantum, start = 0.01, 2 * np.pi / 4096, truths[0].velocity
    ago = np.arange(2 * n, 0, -1)[:, None, None]
    before = np.floor((truths[0].position - ago * dt * start) / quantum + 0.5) * quantum
    history = np.concatenate([before, position])
    rate = (history[n:] - history[:-n]) / (n * dt)
    share = 1.0 if low_pass is None else 1 - np.exp(-2 * np.pi * low_pass * dt)
    expected, _ = lfilter([share], [1, share - 1], rate, axis=0, zi=((1 - share) * start)[None])
    np.testing.assert_allclose(velocity, expected[n:], atol=1e-9)


@pytest.mark.parametrize("latency", [1, 3])
def test_latency_shows_old_readings(latency):
    encoders, noise = ({"latency": latency}, None), {"position": 0.01, "velocity": 0.1}
    late, prompt = (readings(encoder=encoder, noise=noise) for encoder in encoders)
    np.testing.assert_array_equal(np.array(late[:2])[:, latency:], np.array(prompt[:2])[:, :-latency])
    # Before its start, the arm moved uniformly.
    np.testing.assert_allclose(late[0][0], prompt[0][0] - latency * 0.01 * prompt[2][0].velocity, atol=0.07)


def test_lost_readings_are_the_last_ones():
    """At a chance of 5 %, gaps of 3 samples begin; a gap may begin within another. The velocity is lost with them."""
    position, velocity, truths = readings(encoder={"dropout": 0.05, "dropout_length": 3}, steps=400)
    true = np.array([truth.position for truth in truths])
    lost = np.any(position != true, axis=-1)
    assert not lost[0].any()
    assert abs(lost[3:].mean() - (1 - 0.95**3)) < 0.01
    both = np.concatenate([position, velocity], axis=-1)
    np.testing.assert_array_equal(both[1:][lost[1:]], both[:-1][lost[1:]])
    begins = lost[1:-2] & ~lost[:-3]
    assert np.all(lost[2:-1][begins] & lost[3:][begins])


@pytest.mark.parametrize("encoder", [{"latency": 3}, {"latency": 3, "difference": 2}, {"difference": 1}], ids=str)
def test_readings_from_before_the_start_have_the_errors_of_the_sensors(encoder):
    noise = {"position": {"sigma": 1e-3, "bias": 0.02}}
    if "difference" not in encoder:
        noise["velocity"] = {"sigma": 0.1, "bias": 0.5, "quantization": 1e-3}
    env = TwoLinkArmVectorEnv(4000, "nominal", encoder=encoder, noise=noise, initial_velocity=0.3)
    seen, _ = env.reset(seed=0)
    latency, interval, truth = encoder.get("latency", 0), encoder.get("difference", 0), env.truth
    position = seen[:, env.layout["position"]] - (truth.position - latency * 0.01 * truth.velocity)
    velocity = seen[:, env.layout["velocity"]] - truth.velocity
    spread = np.sqrt(2) * 1e-3 / (interval * 0.01) if interval else 0.1
    np.testing.assert_allclose(position.mean(axis=0), 0.02, atol=1e-4)
    np.testing.assert_allclose(position.std(axis=0), 1e-3, rtol=0.05)
    np.testing.assert_allclose(velocity.mean(axis=0), 0.0 if interval else 0.5, atol=5 * spread / np.sqrt(4000))
    np.testing.assert_allclose(velocity.std(axis=0), spread, rtol=0.05)
    if not interval:
        counts = seen[:, env.layout["velocity"]] / 1e-3
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_a_density_is_the_same_sensor_at_every_rate():
    for dt in (0.01, 0.0025):
        env = TwoLinkArmVectorEnv(3000, noise={"position": {"density": (1e-4, 3e-4)}}, control_dt=dt, physics_dt=dt)
        seen, _ = env.reset(seed=0)
        error = seen[:, env.layout["position"]] - env.truth.position
        np.testing.assert_allclose(error.std(axis=0), np.array([1e-4, 3e-4]) / np.sqrt(2 * dt), rtol=0.04)
