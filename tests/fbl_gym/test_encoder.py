"""The option `encoder`: counts, computed velocity, latency; and noise given as a density."""

import numpy as np
import pytest
from scipy.signal import lfilter

from fbl_gym import TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import PLANT, plain, play, same


def readings(**options):
    """Return position and velocity readings [steps + 1 x lanes x 2] and the truths of a run."""
    layout, seen, truths = play(**options)
    return seen[..., layout["position"]], seen[..., layout["velocity"]], truths


@pytest.mark.parametrize(
    "encoder",
    [
        4096, {"counts": (500, 1000)}, {"difference": 2}, {"difference": 1, "low_pass": 20.0}, {"latency": 3},
        {"dropout": 0.1, "dropout_length": 2},
    ],
    ids=str,
)  # fmt: skip
def test_an_encoder_reaches_the_readings_and_nothing_else(encoder):
    layout, seen, truths = play(encoder=encoder)
    assert same(truths, plain()[2], *PLANT)
    assert not np.array_equal(seen, plain()[1])
    rest = np.ones(seen.shape[-1], dtype=bool)
    rest[layout["position"]] = rest[layout["velocity"]] = False
    np.testing.assert_array_equal(seen[..., rest], plain()[1][..., rest])


def test_counts_round_the_position_to_parts_of_a_turn():
    position, velocity, truths = readings(encoder={"counts": (512, 1000)})
    steps = 2 * np.pi / np.array([512, 1000])
    counts = position / steps
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    error = position - [truth.position for truth in truths]
    assert (np.abs(error).max(axis=(0, 1)) <= steps / 2 + 1e-12).all()
    np.testing.assert_array_equal(velocity, [truth.velocity for truth in truths])


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
    late = readings(encoder={"latency": latency}, noise={"position": 0.01, "velocity": 0.1})
    prompt = readings(noise={"position": 0.01, "velocity": 0.1})
    for name in range(2):
        np.testing.assert_array_equal(late[name][latency:], prompt[name][:-latency])
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
    np.testing.assert_allclose(position.mean(axis=0), 0.02, atol=1e-4)
    np.testing.assert_allclose(position.std(axis=0), 1e-3, rtol=0.05)
    spread = np.sqrt(2) * 1e-3 / (interval * 0.01) if interval else 0.1
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
