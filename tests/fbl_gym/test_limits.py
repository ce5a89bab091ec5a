"""The option `limits`: where the spaces and an episode end."""

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv


def test_each_limit_reaches_its_place():
    env = TwoLinkArmEnv(
        action="acceleration", limits={"position": 1.0, "velocity": 7.0, "acceleration": 11.0, "command": 13.0}
    )
    high = env.observation_space.high
    for name, bound in (("position", 2.0), ("velocity", 14.0), ("acceleration", 11.0)):
        np.testing.assert_array_equal(high[env.layout[name]], bound)
        np.testing.assert_array_equal(high[env.layout[f"reference_{name}"]], bound)
    np.testing.assert_array_equal(env.action_space.high, np.float32(13.0))
    env.reset(seed=0)
    observation = env.step((13.0, -13.0))[0]
    assert np.abs(env.truth.acceleration).max() > 11.0
    assert np.abs(observation[env.layout["acceleration"]]).max() == 11.0


def test_limits_end_an_episode_and_bound_the_sensors():
    env = TwoLinkArmEnv(limits={"position": 0.5, "velocity": 3.0}, action="torque", actuator=None)
    env.reset(seed=0)
    start = env.truth.position
    for _ in range(1000):
        observation, reward, terminated, _, _ = env.step((2000.0, 0.0))
        if terminated:
            break
    assert terminated
    assert reward == 0.0
    assert np.abs(env.truth.position - start).max() > 0.5 or np.abs(env.truth.velocity).max() > 3.0
    assert observation in env.observation_space
    assert env.observation_space.high[env.layout["velocity"]] == pytest.approx([6.0, 6.0])


@pytest.mark.parametrize("limit", ["position", "velocity"])
def test_an_arm_diverges_just_beyond_its_limit(limit):
    """Of where it started, and of either joint; not a step sooner."""
    bound = {"position": 0.4, "velocity": 2.0}[limit]
    for torque in ((2000.0, 0.0), (0.0, -400.0)):
        env = TwoLinkArmEnv(action="torque", limits={limit: bound}, initial_error=0.3)
        env.reset(seed=0)
        start, ended = env.truth.position, False
        for _ in range(100):
            ended = env.step(torque)[2]
            gone = env.truth.position - start if limit == "position" else env.truth.velocity
            assert ended == bool(np.abs(gone).max() > bound)
            if ended:
                break
        assert ended
