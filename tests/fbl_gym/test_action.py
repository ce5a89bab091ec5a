"""Actions, from what is given to the torque at the joints."""

import itertools

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.episodes import RECORDS, episode, started

MODES = ("normalized", "torque", "acceleration")


NOISY = {"noise": {"position": 0.1, "velocity": 0.3}, "parameter_error": 1.5}
SATURATED = {"limits": {"velocity": 1.0}, "noise": {"velocity": {"bias": 5.0}}}


@pytest.mark.parametrize("options", [
    *[{"action": mode, **NOISY} for mode in MODES],
    {"action": "torque", "actuator": None},
    {"action": MODES[2], **SATURATED},
], ids=str)  # fmt: skip
def test_the_interface_says_what_torque_an_action_makes(options):
    """And what action makes a torque; an acceleration goes through the nominal model at the readings that are shown."""
    env = TwoLinkArmEnv(**options)
    observation, _ = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for k in range(60):
        reach = 1.5 if k % 3 == 0 else 0.1  # also where the action, or the torque it makes, is beyond its limit
        action = rng.uniform(-reach, reach, 2) * np.minimum(env.interface.action_limit, 2000.0)
        q, v = observation[env.layout["position"]], observation[env.layout["velocity"]]
        expected = env.interface.torque_from_action(action, q, v)
        if reach < 1.0:
            inverse = env.interface.action_from_torque(expected, q, v)
            np.testing.assert_allclose(inverse, action, rtol=1e-7, atol=1e-9)
        observation, _, terminated, *_ = env.step(action)
        np.testing.assert_allclose(env.truth.applied_torque, expected, rtol=1e-12, atol=1e-9)
        if terminated:
            break


HUGE = ({"bias": 1e200}, {"bias": -1e308, "sigma": 1e308}, {"quantization": 1e-310}, {"quantization": 1e308})


@pytest.mark.parametrize("error", HUGE, ids=str)
@pytest.mark.parametrize("sensor", ["position", "velocity"])
def test_a_reading_beyond_all_bounds_makes_no_nan(sensor, error):
    """Not in the torque that an acceleration becomes at that reading, nor, before a delay lets it through, in the reward."""
    env = started(action="acceleration", actuator={"delay": 0.02}, noise={sensor: error})
    for _ in range(5):
        observation, reward, terminated, *_ = env.step((1.0, 1.0))
        assert observation in env.observation_space
        assert 0.0 <= reward <= 1.0
        assert np.isfinite(env.truth.applied_torque).all()
        if terminated:
            break


@pytest.mark.parametrize("mode", MODES)
def test_an_action_outside_its_box_acts_as_the_nearest_inside(mode):
    one, two = started(action=mode), started(action=mode)
    edge = np.array(one.interface.action_limit)
    for far, inside in itertools.product((1.5, 1e9, 1e300), ((1.0, -0.25), (0.0, -1.0))):
        beyond = np.where(np.abs(inside) == 1.0, far, 1.0) * inside
        np.testing.assert_equal(one.step(beyond * edge), two.step(inside * edge))


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_an_action_keeps_its_precision(kind):
    env = started()
    env.step(np.array([0.1, 0.1], dtype=kind))
    np.testing.assert_array_equal(env.truth.applied_torque, np.float64(kind(0.1)) * np.array([2000.0, 800.0]))


@pytest.mark.parametrize(("bad", "message"), [
    ((np.nan, -np.inf), "be finite, got .*nan"), ((0.0, np.inf), "be finite, got .*inf"),
    *[(bad, rf"be numbers of shape \(2,\), got shape \({text}\)")
      for bad, text in ((0.5, ""), (np.zeros(3), "3,"), (np.zeros((1, 2)), "1, 2"))],
    (("a", "b"), r"be numbers of shape \(2,\), got \('a', 'b'\)"),
    *[(bad, "") for bad in ("ab", None, [None, None], {}, (1j, 0.0), np.array([1j, 0.0]))],
], ids=str)  # fmt: skip
def test_what_is_not_two_numbers_is_refused_in_mid_episode(bad, message):
    """And the run goes on, over many steps, as that of an undisturbed twin: observations, rewards, truth."""
    env, twin = TwoLinkArmEnv(**RECORDS), TwoLinkArmEnv(**RECORDS)
    episode(env, 10)
    episode(twin, 10)
    for k in range(30):
        if k % 7 == 0:
            with pytest.raises(ValueError, match=f"action must {message}"):
                env.step(bad)
        np.testing.assert_equal(env.step((0.1, 0.02 * k)), twin.step((0.1, 0.02 * k)))
        np.testing.assert_array_equal(env.truth.velocity, twin.truth.velocity)


def test_a_bad_action_at_the_border_of_an_episode_is_no_step_either():
    env = started(duration=0.01)
    with pytest.raises(ValueError, match="finite"):
        env.step((np.nan, 0.0))
    assert env.step((0.0, 0.0))[3]
