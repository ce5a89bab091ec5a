"""A hand on a running arm: nothing changes until it acts, and it acts through the options' own physics."""

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv, scenarios
from fbl_gym.envs.hand import BANDWIDTH, Hand, open_to_hand

ACTION = np.array([0.02, -0.01])


def started(scenario="nominal", **options):
    env = TwoLinkArmEnv(open_to_hand(scenarios.get(scenario).replace(duration=2.0), 3), **options)
    hand = Hand(env)
    return env, hand, env.reset(seed=3)[0]


@pytest.mark.parametrize("scenario", ["everything-2", "geared-everything-2", "servo-everything-2"])
def test_an_idle_hand_changes_no_bit_of_the_seeds_episode(scenario):
    plain = TwoLinkArmEnv(scenarios.get(scenario).replace(duration=2.0))
    env, hand, observation = started(scenario)
    np.testing.assert_array_equal(observation, plain.reset(seed=3)[0])
    for _ in range(20):
        hand.push(np.zeros(2))
        np.testing.assert_array_equal(env.step(ACTION)[0], plain.step(ACTION)[0])


def test_a_push_is_a_disturbance_of_one_control_step():
    env, hand, _ = started()
    torque = [(3.0, -1.0), (0.0, 5.0)]
    given = {"kind": "array", "torque": [(0.0, 0.0), *np.negative(torque), (0.0, 0.0)], "dt": 0.01}
    other = TwoLinkArmEnv(env.scenario.replace(disturbance=given))
    other.reset(seed=3)
    for k in range(6):
        if k in (1, 2):
            hand.push(torque[k - 1])
        np.testing.assert_array_equal(env.step(ACTION)[0], other.step(ACTION)[0])


def test_payload_drives_and_noise_change_at_the_next_step():
    env, hand, _ = started("payload-2")
    before = env.truth
    hand.load(2.0)
    hand.scale_drives((1.0, 0.5))
    hand.make_noise((1e-3, 1e-2))
    observation, truth = env.step(ACTION)[0], env.truth
    np.testing.assert_array_equal([truth.payload, *truth.gain], [before.payload + 2.0, *before.gain * (1.0, 0.5)])
    readings = np.abs(observation[:4] - [*truth.position, *truth.velocity])
    assert ((readings > 0.0) & (readings < 5 * np.repeat([1e-3, 1e-2], 2))).all()
    hand.unload()
    env.step(ACTION)
    assert env.truth.payload == 0.0


def test_the_reference_goes_smoothly_to_the_target_also_in_the_preview():
    """r'' = w^2 (s - r) - 2 w r', and `let_go` gives the scenario's own reference back."""
    env, hand, first = started(preview=3)
    layout, target = env.layout, np.array((-1.0, 0.5))
    for _ in range(120):
        hand.aim(tuple(target))
        before, now = env.truth, env.step(ACTION)[0]
    position, velocity, acceleration = now[layout.reference[:6]].reshape(3, 2)
    np.testing.assert_allclose(acceleration, BANDWIDTH**2 * (target - position) - 2 * BANDWIDTH * velocity, atol=1e-12)
    np.testing.assert_allclose(position - before.reference, 0.01 * velocity, atol=1e-3)
    assert np.abs(position - target).max() < 0.1
    ahead = now[layout["preview"]][:6]
    hand.aim(tuple(target))
    np.testing.assert_allclose(env.step(ACTION)[0][layout.reference[:6]], ahead, atol=1e-12)
    hand.let_go()
    np.testing.assert_array_equal(env.reset(seed=3)[0], first)
