"""The single environment as Gymnasium, stable-baselines3 and their users expect it."""

import copy
import json
import pickle
import random

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from fbl_gym import Actuator, Friction, Noise, ParameterError, SensorError, SineDisturbance, TwoLinkArmEnv

ID = "fbl_gym/TwoLinkArm-v0"
RECORDS = {
    "parameter_error": ParameterError(ratio={"m2": 2.0}, radius=0.5, payload={"mass": 3.0, "pick_up": 0.2}),
    "noise": Noise(position=SensorError(sigma=0.01, bias=1e-3, quantization=1e-3), velocity=0.02),
    "friction": Friction(coulomb=5.0, stiction=(3.0, 2.0)),
    "disturbance": SineDisturbance(amplitude=10.0),
    "actuator": Actuator(delay=0.015, lag=0.02),
    "reference": {"kind": "filtered-steps", "bandwidth": 6.0},
    "preview": 2,
    "duration": 1.0,
}
PLAIN = {
    "parameter_error": {"ratio": {"m2": 2.0}, "radius": 0.5, "payload": {"mass": 3.0, "pick_up": 0.2}},
    "noise": {"position": {"sigma": 0.01, "bias": 1e-3, "quantization": 1e-3}, "velocity": 0.02},
    "friction": {"coulomb": 5.0, "stiction": (3.0, 2.0)},
    "disturbance": {"kind": "sine", "amplitude": 10.0},
    "actuator": {"delay": 0.015, "lag": 0.02},
    "reference": {"kind": "filtered-steps", "bandwidth": 6.0},
    "preview": 2,
    "duration": 1.0,
}


def episode(env, steps=60, seed=5):
    """Everything a run returns, as one array."""
    rng = np.random.default_rng(0)
    rows = [np.append(env.reset(seed=seed)[0], 0.0)]
    for _ in range(steps):
        observation, reward, *_ = env.step(rng.uniform(-0.3, 0.3, 2))
        rows.append(np.append(observation, reward))
    return np.array(rows)


@pytest.mark.parametrize("options", [{}, RECORDS, {"scenario": "everything-3"}], ids=["default", "many", "everything"])
def test_checkers_pass_without_a_warning(options):
    """pytest turns every warning into an error here, Gymnasium's own logger's included."""
    env = gym.make(ID, **options)
    check_env(env.unwrapped)
    pytest.importorskip("stable_baselines3.common.env_checker").check_env(env)


def test_plain_data_makes_the_same_environment_as_records():
    one, two = gym.make(ID, **RECORDS), gym.make(ID, **PLAIN)
    assert one.unwrapped.scenario == two.unwrapped.scenario
    np.testing.assert_array_equal(episode(one), episode(two))


@pytest.mark.parametrize("options", [RECORDS, PLAIN, {"scenario": "paper-10", "noise": None, "action": "torque"}])
def test_options_survive_the_spec(options):
    env = gym.make(ID, **options)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario == env.unwrapped.scenario
    assert again.unwrapped.interface == env.unwrapped.interface
    np.testing.assert_array_equal(episode(env, 20), episode(again, 20))
    json.loads(env.spec.to_json())


@pytest.mark.parametrize(
    "duplicate", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "copy"]
)
def test_a_copy_in_mid_episode_goes_on_alike_and_apart(duplicate):
    env = TwoLinkArmEnv(**RECORDS)
    episode(env, 10)
    other = duplicate(env)
    for k in range(20):
        a, b = env.step((0.1, 0.01 * k)), other.step((0.1, 0.01 * k))
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:4] == b[1:4]
    env.step((1.0, 1.0))
    assert not np.array_equal(env.truth.velocity, other.truth.velocity)


def test_an_episode_is_a_function_of_its_seed():
    env = TwoLinkArmEnv("everything-2")
    first = episode(env, seed=1)
    assert not np.array_equal(first, episode(env, seed=2))
    np.testing.assert_array_equal(first, episode(env, seed=1))
    env.reset(seed=1)
    second = env.reset()[0]
    assert not np.array_equal(second, first[0, :-1])
    env.reset(seed=1)
    np.testing.assert_array_equal(env.reset()[0], second)


def test_without_a_seed_episodes_differ():
    assert not np.array_equal(TwoLinkArmEnv().reset()[0], TwoLinkArmEnv().reset()[0])


def test_no_global_random_state_is_touched():
    before = random.getstate(), np.random.get_state()[1].tobytes()  # noqa: NPY002
    episode(TwoLinkArmEnv("everything-3"))
    assert (random.getstate(), np.random.get_state()[1].tobytes()) == before  # noqa: NPY002


def test_an_episode_is_truncated_after_its_duration_and_then_needs_a_reset():
    env = TwoLinkArmEnv(duration=0.2)
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step((0, 0))
    env.reset(seed=0)
    flags = [env.step((0, 0))[2:4] for _ in range(20)]
    assert flags == [(False, False)] * 19 + [(False, True)]
    with pytest.raises(ResetNeeded):
        env.step((0, 0))
    env.reset()
    env.step((0, 0))


@pytest.mark.parametrize("form", ["log", "l1"])
def test_reward_is_what_its_documentation_says(form):
    weights = {"weight_tracking": 2.0, "weight_effort": 0.3, "weight_chatter": 0.7}
    reward = {"tracking": form, "worst": 1.5, "resolution": 2e-3, **weights}
    env = TwoLinkArmEnv(reward=reward, noise={"position": 0.1})
    env.reset(seed=0)
    rng, before = np.random.default_rng(0), env.truth.applied_torque / env.torque_limit
    for _ in range(60):
        u = rng.uniform(-0.2, 0.2, 2)
        found = env.step(u)[1]
        error = np.abs(env.truth.reference - env.truth.position).sum()
        t = np.log(1 + error / 2e-3) / np.log(1 + 1.5 / 2e-3) if form == "log" else error / 1.5
        e, c = np.abs(u).mean(), np.abs(u - before).mean() / 2
        assert found == pytest.approx(1 - (2.0 * min(t, 1.0) + 0.3 * e + 0.7 * c) / 3.0, abs=1e-12)
        assert 0.0 <= found <= 1.0
        before = u


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ((np.nan, 0.0), "action must be finite, got .*nan"),
        ((0.0, np.inf), "action must be finite, got .*inf"),
        (np.zeros(3), r"action must have shape \(2,\), got shape \(3,\)"),
        (np.zeros((1, 2)), r"action must have shape \(2,\), got shape \(1, 2\)"),
        (0.5, r"action must have shape \(2,\)"),
        (("a", "b"), r"action must be numbers of shape \(2,\), got \('a', 'b'\)"),
        (None, "action must"),
    ],
)
def test_a_bad_action_is_named_and_nothing_is_lost(bad, message):
    env, twin = TwoLinkArmEnv(**RECORDS), TwoLinkArmEnv(**RECORDS)
    episode(env, 10)
    episode(twin, 10)
    with pytest.raises(ValueError, match=message):
        env.step(bad)
    np.testing.assert_array_equal(env.step((0.1, 0.1))[0], twin.step((0.1, 0.1))[0])


@pytest.mark.parametrize("seed", [-1, 1.5, "1", True, 2**64])
def test_a_bad_seed_is_named(seed):
    env = TwoLinkArmEnv()
    with pytest.raises(ValueError, match="seed must be"):
        env.reset(seed=seed)
    env.reset(seed=2**64 - 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"threads": 2}, "'threads' is an option of many arms at once"),
        ({"frictionn": 1}, "unknown option 'frictionn'; did you mean 'friction'"),
        ({"scenario": "paper-3c"}, "unknown scenario 'paper-3c'; did you mean"),
        ({"scenario": 3}, "scenario must be"),
        ({"action": "torques"}, "unknown action 'torques'; did you mean 'torque'"),
        ({"actuator": None}, "action='fraction' needs a torque limit"),
        ({"sensors": ("position",), "action": "acceleration"}, "has none"),
        ({"sensors": ("velocity",)}, "sensors must include 'position'"),
        ({"preview": -1}, "preview must be a whole number not below 0, got -1"),
        ({"render_mode": "humann"}, "render_mode"),
        ({"reward": {"weight_effort": -1}}, "reward: weight_effort must be a finite number not below 0, got -1"),
        ({"physics_dt": 0.003}, "control_dt must be a multiple of physics_dt=0.003 s, got control_dt=0.01 s"),
        ({"physics_dt": 0.02}, "physics_dt must divide control_dt, got physics_dt=0.02 s and control_dt=0.01 s"),
        ({"arm": {"m1": -1}}, "arm: m1 must be a positive, finite number, got -1"),
        ({"noise": {"position": -0.1}}, "noise: position: sigma.* must be a finite number not below 0, got -0.1"),
        ({"noise": {"velocity": 0.1}, "sensors": ("position",)}, "noise.velocity is given, but sensors"),
        (
            {"disturbance": {"kind": "sinus", "amplitude": 1}},
            "unknown kind of disturbance 'sinus'; did you mean 'sine'",
        ),
        ({"disturbance": {"kind": "sine"}}, "disturbance must have the fields of SineDisturbance"),
        ({"actuator": {"delay": 0.0005}}, "actuator.delay must be a multiple of physics_dt"),
        ({"reference": {"kind": "steps", "low": 1, "high": 0}}, "low must not exceed high"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmEnv(**options)


def test_reset_takes_no_options():
    with pytest.raises(ValueError, match="unknown reset option 'low'"):
        TwoLinkArmEnv().reset(options={"low": 1})


def test_truth_is_a_copy_and_looking_changes_nothing():
    env, twin = TwoLinkArmEnv("everything-2"), TwoLinkArmEnv("everything-2")
    env.reset(seed=0)
    twin.reset(seed=0)
    for _ in range(50):
        truth = env.truth
        before = truth.position.copy()
        truth.velocity[:] = 99.0
        a, b = env.step((0.1, 0.1)), twin.step((0.1, 0.1))
        np.testing.assert_array_equal(a[0], b[0])
        np.testing.assert_array_equal(truth.position, before)


def test_what_a_controller_may_know():
    env = gym.make(ID, scenario="mixed-error-3").unwrapped
    assert env.nominal.m1 == 20.0
    assert env.control_dt == 0.01
    assert env.torque_limit == (2000.0, 800.0)
    assert env.layout.size == env.observation_space.shape[0]
    assert len(env.layout.names) == len(env.layout.units) == env.layout.size
    assert env.observation_space.dtype == np.float64


# More of the above: how an environment is made, copied, and what it does with what it is given.

MODES = ("fraction", "torque", "acceleration")


@pytest.mark.parametrize("name", [ID, "fbl_gym:fbl_gym/TwoLinkArm-v0"])
def test_both_names_make_it(name):
    env = gym.make(name, scenario="noise-1")
    assert isinstance(env.unwrapped, TwoLinkArmEnv)
    assert env.unwrapped.scenario.name == "noise-1"
    assert env.spec.id == ID


def test_a_made_environment_can_be_pickled():
    env = gym.make(ID, **RECORDS)
    other = pickle.loads(pickle.dumps(env))
    assert other.unwrapped.scenario == env.unwrapped.scenario
    np.testing.assert_array_equal(episode(env), episode(other))


@pytest.mark.parametrize(
    "duplicate", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "copy"]
)
def test_a_copy_knows_its_own_truth(duplicate):
    env = TwoLinkArmEnv(**RECORDS)
    episode(env, 10)
    other = duplicate(env)
    for _ in range(20):
        env.step((0.1, -0.1))
        other.step((0.1, -0.1))
    for name, value in vars(env.truth).items():
        np.testing.assert_array_equal(getattr(other.truth, name), value, err_msg=name)


@pytest.mark.parametrize(
    "duplicate", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "copy"]
)
def test_a_copy_heeds_its_seeds(duplicate):
    """Both `reset(seed=...)` and the next episode of a seed are those of the original."""
    env = TwoLinkArmEnv(**RECORDS)
    env.reset(seed=3)
    other = duplicate(env)
    np.testing.assert_array_equal(other.reset()[0], env.reset()[0])
    np.testing.assert_array_equal(other.reset(seed=8)[0], env.reset(seed=8)[0])
    np.testing.assert_array_equal(episode(other, seed=9), episode(env, seed=9))


def test_divergence_ends_the_episode_with_reward_zero():
    env = TwoLinkArmEnv(limits={"velocity": 2.0})
    env.reset(seed=0)
    for _ in range(env.scenario.steps):
        _, reward, terminated, truncated, _ = env.step((1.0, 1.0))
        if terminated:
            break
        assert reward > 0.0
    assert (reward, terminated, truncated) == (0.0, True, False)
    assert np.abs(env.truth.velocity).max() > 2.0
    with pytest.raises(ResetNeeded):
        env.step((0.0, 0.0))
    env.reset()
    assert not env.step((0.0, 0.0))[2]


def test_an_arm_that_diverges_at_the_very_end_is_terminated_not_truncated():
    env = TwoLinkArmEnv(limits={"velocity": 2.0})
    env.reset(seed=0)
    last = next(k for k in range(1000) if env.step((1.0, 1.0))[2]) + 1
    env = TwoLinkArmEnv(limits={"velocity": 2.0}, duration=last * 0.01)
    env.reset(seed=0)
    assert [env.step((1.0, 1.0))[2:4] for _ in range(last)] == [(False, False)] * (last - 1) + [(True, False)]


@pytest.mark.parametrize(
    "bad",
    [
        ("0.1", "0.2"),
        "ab",
        None,
        [None, None],
        {},
        (1j, 0.0),
        np.array([1j, 0.0]),
        [[0.0], [0.0, 1.0]],
        (np.nan, -np.inf),
    ],
    ids=str,
)
def test_what_is_not_two_numbers_is_refused_in_mid_episode(bad):
    """And the run goes on, over many steps, as that of an undisturbed twin: observations, rewards, truth."""
    env, twin = TwoLinkArmEnv(**RECORDS), TwoLinkArmEnv(**RECORDS)
    episode(env, 10)
    episode(twin, 10)
    for k in range(30):
        if k % 7 == 0:
            with pytest.raises(ValueError, match="action must"):
                env.step(bad)
        a, b = env.step((0.1, 0.02 * k)), twin.step((0.1, 0.02 * k))
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:] == b[1:]
        np.testing.assert_array_equal(env.truth.velocity, twin.truth.velocity)


def test_a_bad_action_at_the_border_of_an_episode_is_no_step_either():
    env = TwoLinkArmEnv(duration=0.02)
    env.reset(seed=0)
    env.step((0.0, 0.0))
    with pytest.raises(ValueError, match="finite"):
        env.step((np.nan, 0.0))
    assert env.step((0.0, 0.0))[3]
    with pytest.raises(ResetNeeded):
        env.step((0.0, 0.0))


def test_what_is_returned_is_never_written_to_again():
    env = TwoLinkArmEnv(**RECORDS)
    kept = [env.reset(seed=0)[0]] + [env.step((0.1, 0.1))[0] for _ in range(50)] + [env.reset()[0]]
    copies = [observation.copy() for observation in kept]
    infos = [env.step((0.2, 0.2))[4] for _ in range(10)]
    for observation, before in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(observation, before)
    assert len({id(observation.base if observation.base is not None else observation) for observation in kept}) == 52
    assert len({id(info) for info in infos}) == 10


def test_what_is_given_is_neither_kept_nor_changed():
    env, twin = TwoLinkArmEnv(actuator={"delay": 0.02}), TwoLinkArmEnv(actuator={"delay": 0.02})
    env.reset(seed=0)
    twin.reset(seed=0)
    action = np.array([3.0, -0.5])
    env.step(action)
    np.testing.assert_array_equal(action, [3.0, -0.5])
    action[:] = 0.0
    twin.step((3.0, -0.5))
    np.testing.assert_array_equal(env.step((0.1, 0.1))[0], twin.step((0.1, 0.1))[0])


@pytest.mark.parametrize("mode", MODES)
def test_an_action_outside_its_box_acts_as_the_nearest_inside(mode):
    one, two = TwoLinkArmEnv(action=mode), TwoLinkArmEnv(action=mode)
    one.reset(seed=0)
    two.reset(seed=0)
    edge = np.array(one.interface.action_limit)
    for far in (1.5, 1e9, 1e300):
        a, b = one.step((far * edge[0], -0.25 * edge[1])), two.step((edge[0], -0.25 * edge[1]))
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1] == b[1]
        np.testing.assert_array_equal(one.step((0.0, -far * edge[1]))[0], two.step((0.0, -edge[1]))[0])


def test_a_double_keeps_its_precision():
    env, coarse = TwoLinkArmEnv(), TwoLinkArmEnv()
    env.reset(seed=0)
    coarse.reset(seed=0)
    env.step(np.array([0.1, 0.1]))
    coarse.step(np.array([0.1, 0.1], dtype=np.float32))
    np.testing.assert_array_equal(env.truth.applied_torque, 0.1 * np.array([2000.0, 800.0]))
    np.testing.assert_array_equal(coarse.truth.applied_torque, np.float64(np.float32(0.1)) * np.array([2000.0, 800.0]))


@pytest.mark.parametrize("mode", MODES)
def test_actions_and_torques_are_each_others_inverse(mode):
    interface = TwoLinkArmEnv(action=mode).interface
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-3, 3, (500, 2)), rng.uniform(-3, 3, (500, 2))
    torque = rng.uniform(-1, 1, (500, 2)) * (300.0, 60.0)
    action = interface.action_from_torque(torque, q, v)
    inside = (np.abs(action) < interface.action_limit).all(axis=1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(
        interface.torque_from_action(action, q, v)[inside], torque[inside], rtol=1e-11, atol=1e-10
    )


def test_three_modes_with_equivalent_actions_are_one_motion():
    """On an arm without noise, each from its own observation: 1 s under the same torques."""
    envs = [TwoLinkArmEnv(action=mode) for mode in MODES]
    seen = [env.reset(seed=0)[0] for env in envs]
    at, rng = envs[0].layout, np.random.default_rng(0)
    for _ in range(100):
        torque = np.array([-60.0, -10.0]) + rng.uniform(-1, 1, 2) * (60.0, 20.0)
        for i, env in enumerate(envs):
            q, v = seen[i][at["position"]], seen[i][at["velocity"]]
            seen[i] = env.step(env.interface.action_from_torque(torque, q, v))[0]
            np.testing.assert_allclose(env.truth.applied_torque, torque, rtol=1e-12)
    for env in envs[1:]:
        np.testing.assert_allclose(env.truth.position, envs[0].truth.position, rtol=0, atol=1e-11)
        np.testing.assert_allclose(env.truth.velocity, envs[0].truth.velocity, rtol=0, atol=1e-10)


@pytest.mark.parametrize("mode", MODES)
def test_the_interface_says_what_torque_an_action_makes(mode):
    """At the measured state, noise and all, which is where an acceleration goes through the nominal model."""
    env = TwoLinkArmEnv(action=mode, noise={"position": 0.1, "velocity": 0.3}, parameter_error=1.5)
    observation, _ = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for k in range(60):
        reach = 1.5 if k % 3 == 0 else 0.1  # also where the action, or the torque it makes, is beyond its limit
        action = rng.uniform(-reach, reach, 2) * env.interface.action_limit
        q, v = observation[env.layout["position"]], observation[env.layout["velocity"]]
        expected = env.interface.torque_from_action(action, q, v)
        observation = env.step(action)[0]
        np.testing.assert_allclose(env.truth.applied_torque, expected, rtol=1e-12, atol=1e-9)


def test_the_interface_is_right_without_a_torque_limit_too():
    """Also where the action lies outside its box."""
    env = TwoLinkArmEnv(action="torque", actuator=None)
    observation, _ = env.reset(seed=0)
    q, v = observation[env.layout["position"]], observation[env.layout["velocity"]]
    action = np.array([3e6, -10.0])
    env.step(action)
    np.testing.assert_array_equal(env.interface.torque_from_action(action, q, v), env.truth.applied_torque)


def test_the_first_observation_of_a_heavy_unlimited_arm_lies_in_its_space():
    """The torque that holds it still, shown as the previous action, exceeds the box of a torque action."""
    env = TwoLinkArmEnv(arm={"m1": 1e5, "L1": 50.0}, action="torque", actuator={"torque_limit": None, "delay": 0.01})
    assert all(env.reset(seed=seed)[0] in env.observation_space for seed in range(10))


def test_effort_and_chatter_are_of_the_command_not_of_what_the_drive_delivers():
    env = TwoLinkArmEnv(
        actuator={"delay": 0.05, "lag": 0.1},
        reward={"weight_tracking": 0.0, "weight_effort": 1.0, "weight_chatter": 3.0},
    )
    env.reset(seed=0)
    before, rng = env.truth.applied_torque / env.torque_limit, np.random.default_rng(0)
    for _ in range(20):
        u = rng.uniform(-1.5, 1.5, 2)
        reward = env.step(u)[1]
        u = np.clip(u, -1.0, 1.0)
        assert reward == pytest.approx(1 - (np.abs(u).mean() + 3.0 * np.abs(u - before).mean() / 2) / 4.0, abs=1e-12)
        before = u


@pytest.mark.parametrize("form", ["log", "l1"])
def test_reward_stays_within_its_bounds_at_any_action(form):
    env = TwoLinkArmEnv(reward={"tracking": form, "worst": 0.3, "weight_effort": 1.0, "weight_chatter": 1.0})
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    rewards = []
    for _ in range(200):
        _, reward, terminated, _, _ = env.step(np.sign(rng.normal(size=2)) * 5.0)
        rewards.append(reward)
        if terminated:
            env.reset()
    assert all(0.0 <= reward <= 1.0 for reward in rewards)
    assert all(type(reward) is float for reward in rewards)
    assert len(set(rewards)) > 10


def test_an_arm_without_limits_pays_for_tracking_alone():
    env = TwoLinkArmEnv(actuator=None, action="torque", reward={"tracking": "l1", "worst": 3.0})
    env.reset(seed=0)
    for k in range(30):
        reward = env.step((500.0 * (-1) ** k, 0.0))[1]
        error = np.abs(env.truth.reference - env.truth.position).sum()
        assert reward == pytest.approx(1 - min(error / 3.0, 1.0) / 1.12, abs=1e-12)


@pytest.mark.parametrize("form", ["log", "l1"])
def test_reward_has_a_slope_at_zero_error(form):
    """And is one at perfect tracking without effort or chatter."""
    weights = {"weight_effort": 0.0, "weight_chatter": 0.0}

    def reward(error):
        """Of an arm that floats beside its reference."""
        env = TwoLinkArmEnv(
            reward={"tracking": form, **weights},
            reference={"kind": "minimum-jerk", "points": [(0.0, 0.0)]},
            initial_error=(error, 0.0),
            arm={"gravity": 0.0},
        )
        env.reset(seed=0)
        return env.step((0.0, 0.0))[1]

    errors = np.array([0.0, 1e-6, 1e-4, 1e-2])
    rewards = np.array([reward(error) for error in errors])
    assert rewards[0] == 1.0
    assert np.all(np.diff(rewards) / np.diff(errors) < -0.1)


def test_no_numpy_or_python_random_state_is_touched_by_making_seeding_or_drawing():
    before = random.getstate(), repr(np.random.get_state(legacy=False))  # noqa: NPY002
    env = TwoLinkArmEnv("everything-3", reference="fourier")
    env.reset()
    env.reset(seed=4)
    episode(env)
    assert random.getstate() == before[0]
    assert repr(np.random.get_state(legacy=False)) == before[1]  # noqa: NPY002


def test_global_seeds_change_no_episode():
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    first = episode(TwoLinkArmEnv("everything-3"))
    random.seed(2)
    np.random.seed(2)  # noqa: NPY002
    np.testing.assert_array_equal(first, episode(TwoLinkArmEnv("everything-3")))


def test_an_episode_does_not_depend_on_what_was_run_before():
    fresh, used = TwoLinkArmEnv(**RECORDS), TwoLinkArmEnv(**RECORDS)
    for seed in range(3):
        episode(used, 7 * seed, seed)
    np.testing.assert_array_equal(episode(fresh), episode(used))


@pytest.mark.parametrize("wrong", [{"acton": "torque"}, {"rewards": {}}, {"prevew": 2}, {"scenaro": "nominal"}])
def test_a_mistyped_argument_of_the_environment_is_recognised(wrong):
    """Not only the scenario's fields: action, reward, preview and scenario are options of `gym.make` too."""
    meant = {"acton": "action", "rewards": "reward", "prevew": "preview", "scenaro": "scenario"}
    (name,) = wrong
    with pytest.raises(ValueError, match=f"did you mean '{meant[name]}'"):
        gym.make(ID, **wrong)


@pytest.mark.parametrize("sensors", [None, 5])
def test_sensors_of_the_wrong_type_are_named(sensors):
    with pytest.raises(ValueError, match="sensors"):
        TwoLinkArmEnv(sensors=sensors)


def test_looking_at_the_truth_of_a_diverged_arm_is_harmless():
    """pytest turns NumPy's warnings into errors here."""
    env = TwoLinkArmEnv(arm={"m1": 0.01, "m2": 0.01}, actuator={"torque_limit": 1e5}, control_dt=0.1)
    env.reset(seed=0)
    observation, reward, terminated, *_ = env.step((1.0, -1.0))
    assert terminated
    assert reward == 0.0
    assert observation in env.observation_space
    assert env.truth.time == pytest.approx(0.1)


# Readings beyond the bounds of the observation.


def test_an_acceleration_goes_through_the_readings_that_are_shown():
    """Also where a reading saturates: what the interface reckons from the observation is what the environment does."""
    env = TwoLinkArmEnv(action="acceleration", limits={"velocity": 1.0}, noise={"velocity": {"bias": 5.0}})
    observation, _ = env.reset(seed=0)
    q, v = observation[env.layout["position"]], observation[env.layout["velocity"]]
    np.testing.assert_array_equal(v, 2.0)
    expected = env.interface.torque_from_action(np.array([1.0, 1.0]), q, v)
    env.step((1.0, 1.0))
    np.testing.assert_allclose(env.truth.applied_torque, expected, rtol=1e-12)


@pytest.mark.parametrize(
    "error",
    [{"bias": 1e200}, {"bias": -1e308, "sigma": 1e308}, {"quantization": 1e-310}, {"quantization": 1e308}],
    ids=str,
)
@pytest.mark.parametrize("sensor", ["position", "velocity"])
def test_a_reading_beyond_all_bounds_makes_no_nan(sensor, error):
    """Not in the torque that an acceleration becomes at that reading, nor, before a delay lets it through, in the reward."""
    env = TwoLinkArmEnv(action="acceleration", actuator={"delay": 0.02}, noise={sensor: error})
    observation, _ = env.reset(seed=0)
    for _ in range(5):
        assert observation in env.observation_space
        observation, reward, terminated, *_ = env.step((1.0, 1.0))
        assert 0.0 <= reward <= 1.0
        assert np.isfinite(env.truth.applied_torque).all()
        if terminated:
            break


def test_duration_and_initial_error():
    env = TwoLinkArmEnv(duration=0.05, initial_error=(0.1, -0.2))
    plain = TwoLinkArmEnv()
    env.reset(seed=0)
    plain.reset(seed=0)
    np.testing.assert_allclose(env.truth.position - plain.truth.position, [0.1, -0.2])
    assert [env.step((0, 0))[3] for _ in range(5)] == [False] * 4 + [True]
