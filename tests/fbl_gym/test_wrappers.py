"""Wrappers: error coordinates and residuals, of the single and the vector environment."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import controllers
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.wrappers import ErrorCoordinates, Residual, VectorErrorCoordinates, VectorResidual

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
    wrapped = ErrorCoordinates(Residual(env, controllers.make("cascade-flm", env)))
    check_env(wrapped, skip_render_check=True)
    pytest.importorskip("stable_baselines3.common.env_checker").check_env(wrapped)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_each_lane_of_a_vector_wrapper_equals_the_single_wrapper(mode):
    """Error coordinates over a residual on a controller with state, over several episodes."""

    def single():
        env = gym.make("fbl_gym/TwoLinkArm-v0", **OPTIONS)
        return ErrorCoordinates(Residual(env, controllers.make("cascade-flm", env), scale=0.1))

    lanes = 3
    theirs = gym.vector.SyncVectorEnv([single] * lanes, autoreset_mode=mode)
    batch = TwoLinkArmVectorEnv(lanes, autoreset_mode=mode, **OPTIONS)
    ours = VectorErrorCoordinates(VectorResidual(batch, controllers.make("cascade-flm", batch), scale=0.1))
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.single_action_space == theirs.single_action_space
    a, b = ours.reset(seed=4)[0], theirs.reset(seed=4)[0]
    rng = np.random.default_rng(0)
    for _ in range(170):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-8)
        actions = rng.uniform(-1, 1, (lanes, 2))
        a, reward, terminated, truncated, info = ours.step(actions)
        b, *rest, their_info = theirs.step(actions)
        np.testing.assert_allclose(reward, rest[0], atol=1e-8)
        np.testing.assert_array_equal(truncated, rest[2])
        if "final_obs" in info:
            for lane in np.flatnonzero(info["_final_obs"]):
                np.testing.assert_allclose(info["final_obs"][lane], their_info["final_obs"][lane], atol=1e-8)
        if mode == "Disabled" and (terminated | truncated).any():
            mask = terminated | truncated
            a, b = ours.reset(options={"reset_mask": mask})[0], theirs.reset(options={"reset_mask": mask})[0]


def test_a_zero_residual_leaves_the_policys_action():
    plain = TwoLinkArmEnv("mixed-error-3")
    env = Residual(TwoLinkArmEnv("mixed-error-3"), controllers.make("cascade-flm", plain))
    policy, state = controllers.make("cascade-flm", plain), None
    a, b = plain.reset(seed=0)[0], env.reset(seed=0)[0]
    for _ in range(50):
        np.testing.assert_array_equal(a, b)
        action, state = policy.predict(a, state)
        a, b = plain.step(action)[0], env.step(np.zeros(2))[0]


@pytest.mark.parametrize("bad", [np.zeros(3), np.array([np.nan, 0.0]), np.array(["a", "b"])])
def test_a_bad_residual_does_not_advance_the_policy(bad):
    env = Residual(TwoLinkArmEnv(), controllers.make("cascade-flm", TwoLinkArmEnv()))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action must be finite numbers"):
        env.step(bad)
    assert env._base.state is None


def test_the_scale_of_a_residual_must_be_positive():
    with pytest.raises(ValueError, match="scale must be"):
        Residual(TwoLinkArmEnv(), controllers.make("zero", TwoLinkArmEnv()), scale=-1)


def test_error_coordinates_survive_the_spec():
    env = ErrorCoordinates(gym.make("fbl_gym/TwoLinkArm-v0", scenario="noise-1"))
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    np.testing.assert_array_equal(env.reset(seed=0)[0], again.reset(seed=0)[0])
