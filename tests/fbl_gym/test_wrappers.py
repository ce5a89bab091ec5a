"""The wrapper with error coordinates; `test_tracking.py` has the environments with them."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from fbl_gym import TwoLinkArmEnv
from fbl_gym.envs.wrappers import ErrorCoordinates

OPTIONS = {"scenario": "everything-2", "duration": 0.5, "preview": 2, "actuator": {"delay": 0.01}}


def test_error_coordinates_are_the_documented_ones():
    plain, wrapped = TwoLinkArmEnv(**OPTIONS), ErrorCoordinates(TwoLinkArmEnv(**OPTIONS))
    a, b = plain.reset(seed=1)[0], wrapped.reset(seed=1)[0]
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
        a, b = plain.step((0.1, -0.2))[0], wrapped.step((0.1, -0.2))[0]


def test_error_coordinates_without_sensors():
    env = ErrorCoordinates(TwoLinkArmEnv(sensors=("position",)))
    assert env.reset(seed=0)[0].shape == (6,)


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
def test_wrapped_environments_pass_the_checkers():
    env = gym.make("fbl_gym/TwoLinkArm-v0", **OPTIONS)
    wrapped = ErrorCoordinates(env)
    check_env(wrapped, skip_render_check=True)
    pytest.importorskip("stable_baselines3.common.env_checker").check_env(wrapped)


def test_error_coordinates_survive_the_spec():
    env = ErrorCoordinates(gym.make("fbl_gym/TwoLinkArm-v0", scenario="noise-1"))
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    np.testing.assert_array_equal(env.reset(seed=0)[0], again.reset(seed=0)[0])
