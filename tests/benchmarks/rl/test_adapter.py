"""The adapter between environment and agent."""

import dataclasses

import numpy as np
import pytest

import controllers
from benchmarks.agents.adapter import AdapterSettings, AgentAdapter
from benchmarks.agents.agent import Agent, write
from benchmarks.analysis.board import assemble
from benchmarks.policies.spec import resolve
from benchmarks.report.columns import columns
from benchmarks.run.cell import Cell
from benchmarks.run.runner import run_cell
from benchmarks.training.vec_env import VectorAdapter
from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingVectorEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.arm import forward_dynamics
from tests.benchmarks.rl.agents import MISTAKES, batch, random_actor

MOTION = ("position", "velocity")
ERROR = {"radius": 0.5, "payload": {"mass": 10.0, "pick_up": 0.1, "drop": 0.2}}


def start(scenario, *settings, **more):
    """Return an observation, and the torque of an agent's adapter there for an action."""
    env = TwoLinkArmEnv(scenario)
    observation = env.reset(seed=0)[0][None].copy()
    adapter = AgentAdapter(AdapterSettings(*settings, **more), env.interface)
    torque = lambda *action: adapter.torque(np.array([action]), observation, adapter.initial(observation))[0]
    return env, observation, torque


def first_seen(env, settings):
    """Return what an agent observes first, which has the size of its adapter."""
    adapter, observation = AgentAdapter(settings, env.interface), env.reset(seed=0)[0][None]
    (seen,) = adapter.observe(observation, adapter.initial(observation))
    assert seen.shape == (adapter.size,)
    return seen


@pytest.mark.parametrize(("action", "history", "preview", "period"), [
    ("torque", 0, 0, 1), ("residual", 3, 0, 1), ("residual", 0, 4, 1), ("residual", 3, 4, 1), ("blend", 1, 0, 1),
    ("residual", 2, 0, 5), ("torque", 0, 7, 5),
])  # fmt: skip
def test_an_agent_acts_as_in_training(action, history, preview, period):
    """Closed loops on the plain environment and on the training environment are equal over several episodes.

    The agent decides once in a period of some samples, and its law at each.
    """
    second = "pid-flm" if action == "blend" else ""
    settings = AdapterSettings(action, second=second, history=history, preview=0.01 * preview, period=0.01 * period)
    options = {"scenario": "everything-2", "duration": 0.3, "preview": preview, "parameter_error": ERROR}
    training = batch(3, settings, **options)
    plain = TwoLinkArmVectorEnv(3, **options, autoreset_mode="SameStep")
    agent = Agent(plain.interface, settings, random_actor(settings, plain.interface))
    plain_observation, training_observation = plain.reset(seed=3)[0], training.reset(seed=3)[0]
    state, starts, episodes = None, np.ones(3, dtype=bool), 0
    for _ in range(70 // period):
        rewards, decided = [], []
        training_observation, mean, *training_ends, infos = training.step(agent.actor(training_observation))
        for _ in range(period):
            actions, state = agent.predict(plain_observation, state, starts)
            plain_observation, reward, *ends, _ = plain.step(actions)
            rewards.append(reward)
            decided.append(state.action)
            starts = np.logical_or(*ends)
        np.testing.assert_array_equal(ends, training_ends)
        np.testing.assert_allclose(np.mean(rewards, axis=0), mean, atol=1e-12)
        np.testing.assert_array_equal(decided, decided[:1] * period)
        for lane in np.flatnonzero(starts):
            assert infos["final_obs"][lane].shape == (agent.adapter.size,)
            episodes += 1
    assert episodes == 6
    np.testing.assert_array_equal(plain.truth.position, training.env.unwrapped.truth.position)


def test_history_holds_the_errors_and_actions_of_the_last_steps():
    env = batch(2, AdapterSettings(history=2), duration=0.1)
    actions = np.random.default_rng(0).uniform(-1, 1, (5, 2, 2)).astype(np.float32)
    observations = [env.reset(seed=1)[0], *(env.step(action)[0] for action in actions)]
    np.testing.assert_array_equal(observations[0][:, 12:], 0)
    errors = [observation[:, :12] for observation in observations]
    expected = np.concatenate([errors[5], errors[4], actions[4], errors[3], actions[3]], axis=-1)
    np.testing.assert_array_equal(observations[5], expected)
    for _ in range(5):
        first, *_, infos = env.step(np.zeros((2, 2)))
    np.testing.assert_array_equal(first[:, 12:], 0)  # a new episode
    assert np.any(infos["final_obs"][0][12:] != 0)
    last = env.step(np.ones((2, 2)))[0]
    again = env.reset(options={"reset_mask": np.array([True, False])})[0]
    assert again[0].any() > again[0, 12:].any()
    np.testing.assert_array_equal(again[1], last[1])


def test_an_agent_observes_compressed_errors_their_mean_and_steps_ever_further_back():
    plain = AdapterSettings(sensors=MOTION)
    settings = AdapterSettings(sensors=MOTION, fine=(0.005, 0.05), integral=0.04, history=3, reach=0.08)
    envs = [batch(2, each, "servo-practice-nominal") for each in (plain, settings)]
    actions, mean = np.random.default_rng(0).uniform(-1, 1, (9, 2, 2)), np.zeros((2, 2))
    rows = [[env.reset(seed=1)[0], *(env.step(action)[0] for action in actions)] for env in envs]
    for row in rows[0][:9]:
        mean = 0.75 * mean + 0.25 * row[:, :2]
    errors = [np.concatenate([np.arcsinh(20 * row[:, :4]), row[:, 4:]], axis=1) for row in rows[0]]
    past = [part for age in (1, 3, 8) for part in (errors[9 - age], actions[9 - age])]
    expected = np.concatenate([errors[9], *past, np.arcsinh(20 * mean)], axis=1)
    np.testing.assert_allclose(rows[1][-1], expected, rtol=1e-12, atol=1e-12)


def test_an_agent_observes_the_datasheet_of_arm_springs_and_sensors():
    for scenario, springs in (("servo-practice-elastic-3", True), ("servo-practice-noise-3", False)):
        env = TwoLinkArmEnv(scenario)
        seen = first_seen(env, AdapterSettings(sensors=MOTION, arm=True))[10:]
        interface, limit = env.interface, np.array(env.interface.torque_limit)
        weights, rotors = interface.nominal.lumped[3:] / limit, 10 * np.array(interface.nominal.rotor) / limit
        np.testing.assert_allclose(seen[3:7], [*weights, *rotors])
        assert np.all(seen[7:11] > 0) == springs
        np.testing.assert_allclose(seen[13:], 1e3 * np.array([*interface.noise_std[0], *interface.resolution]))


@pytest.mark.parametrize(("settings", "message"), MISTAKES["settings"])
def test_wrong_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        AdapterSettings(**settings)


@pytest.mark.parametrize(("options", "settings", "message"), [
    ({"action": "torque", "actuator": {"torque_limit": None}}, {}, "actions are shares of torque limits"),
    ({"scenario": "servo-nominal"}, {}, "sensors of position, velocity, acceleration, got position, velocity"),
    ({"preview": 4}, {"preview": 0.05}, "needs preview=5, got preview=4"),
])  # fmt: skip
def test_an_agent_that_is_not_applicable_is_refused(options, settings, message):
    with pytest.raises(ValueError, match=f"not applicable: the agent.* {message}"):
        Agent(TwoLinkArmEnv(**options).interface, AdapterSettings(**settings), None)


def test_a_batch_that_observes_otherwise_is_refused():
    with pytest.raises(ValueError, match="must observe one scenario as TwoLinkArm-v0 does"):
        VectorAdapter(TwoLinkArmTrackingVectorEnv(2), AdapterSettings(sensors=("position", "velocity")))


def test_an_agent_may_observe_positions_alone():
    envs = batch(2, AdapterSettings(sensors=("position",)), sensors=("position",))
    envs.reset(seed=0)
    assert np.isfinite(envs.step(np.zeros((2, 2)))[0]).all()


def test_a_torque_is_a_share_of_the_drives_limits():
    env, _, torque = start("servo-nominal", sensors=MOTION)
    np.testing.assert_allclose(torque(1.0, -0.5)[0], env.interface.torque_limit * np.array([1.0, -0.5]))


def test_a_residual_is_an_acceleration_of_the_nominal_arm():
    env, observation, torque = start("mixed-error-2", "residual", residual=3.0)
    motion = observation[:, :2], np.zeros((1, 2))
    none, some = (forward_dynamics(env.interface.nominal, *motion, torque(*each)) for each in ((0, 0), (1, -0.5)))
    np.testing.assert_allclose(some - none, [[3.0, -1.5]])


def test_a_blend_is_between_its_laws():
    env, observation, torque = start("servo-practice-payload-1", "blend", base="pid-flm", second="lqg", sensors=MOTION)
    laws = [controllers.make(name, env.interface) for name in ("pid-flm", "lqg")]
    first, second = (law.torque(observation, law.initial(observation))[0] for law in laws)
    for action, expected in ((1.0, first), (-1.0, second), (0.5, 0.75 * first + 0.25 * second)):
        np.testing.assert_allclose(torque(action, action), expected)


def test_memory_is_the_running_mean_of_the_squares_of_errors_and_of_their_change():
    settings = AdapterSettings(memory=0.04, sensors=("position",), scales=(1.0, 1.0, 1.0))
    env = batch(1, settings, control_dt=0.01, duration=0.1)
    before = error = env.reset(seed=1)[0][:, :2]
    squares = np.tile(error**2, 2)
    for _ in range(5):
        row = env.step(np.full((1, 2), 0.3))[0]
        squares = 0.75 * squares + 0.25 * np.concatenate([error, error - before], axis=-1) ** 2
        np.testing.assert_allclose(row[:, -4:], 0.25 * np.log(squares + 1e-6))
        before, error = error, row[:, :2]
    *_, row = (env.step(np.zeros((1, 2)))[0] for _ in range(5))
    np.testing.assert_allclose(row[:, -4:], 0.25 * np.log(np.tile(row[:, :2] ** 2, 2) + 1e-6))


def test_the_memory_of_a_blend_has_the_difference_between_its_torques():
    """It is an acceleration: over the inertia of the stretched arm, at the scale of accelerations."""
    names = {"base": "pid-flm", "second": "lqg@tuned"}
    settings = AdapterSettings("blend", **names, memory=0.04, sensors=("position",), scales=(1.0, 1.0, 5.0))
    env = TwoLinkArmEnv("servo-practice-payload-1")
    adapter, laws = AgentAdapter(settings, env.interface), [controllers.make(n, env.interface) for n in names.values()]
    observation = env.reset(seed=0)[0][None].copy()
    state = adapter.initial(observation)
    np.testing.assert_array_equal(state.squares[:, [2, 3, 6, 7]], 0.0)
    torques = [law.torque(observation, law.initial(observation))[0] for law in laws]
    after = adapter.torque(np.zeros((1, 2)), observation, state)[1]
    expected = 0.25 * ((torques[0] - torques[1]) / (5.0 * laws[0].stretched)) ** 2
    np.testing.assert_allclose(after.squares[:, [2, 3, 6, 7]], np.tile(expected, 2))
    assert adapter.observe(observation, after).shape == (1, adapter.size) == (1, 14)


def test_an_agent_observes_the_drive_and_its_own_sensors_only():
    for options in ({"sensors": MOTION}, {}):
        env = TwoLinkArmEnv(actuator={"delay_samples": 2, "lag": {"uniform": (0.01, 0.03)}}, **options)
        observed = first_seen(env, AdapterSettings(drive=True, sensors=MOTION))
        assert len(observed) == 17
        np.testing.assert_allclose(observed[-7:], [0.4, 0.4, 0.2, 0.6, 1.0, 0.0, 0.0])


def test_an_episode_that_ends_within_a_period_ends_once():
    env = batch(2, AdapterSettings(period=0.05, sensors=MOTION), "servo-practice-nominal", duration=0.07)
    env.reset(seed=1)
    ends = [env.step(np.zeros((2, 2))) for _ in range(2)]
    assert [truncated.tolist() for *_, truncated, _ in ends] == [[False] * 2, [True] * 2]
    assert np.stack(ends[1][4]["final_obs"]).shape == (2, env.single_observation_space.shape[0])


def test_a_residual_fades_at_the_torque_limits():
    env, observation, torque = start("servo-nominal", "residual", base="pd-gravity", sensors=MOTION)
    observation[:, env.interface.layout["reference_position"]] += 3.0
    assert (np.abs(torque(0.0, 0.0)) >= env.interface.torque_limit).all()
    np.testing.assert_array_equal(torque(1.0, 1.0), torque(0.0, 0.0))


def test_an_agent_with_preview_sees_the_reference_of_five_coming_times():
    """In scales of the errors, after all else that it observes, at each control rate; on a board, too."""
    settings = AdapterSettings(drive=True, memory=0.1, preview=0.1, scales=(0.001, 0.1, 10.0), sensors=MOTION)
    for scenario, steps in (("servo-nominal", (2, 4, 6, 8, 10)), ("direct-nominal", (10, 20, 30, 40, 50))):
        env = TwoLinkArmEnv(scenario, preview=settings.previewed(scenarios.get(scenario).control_dt))
        adapter = AgentAdapter(settings, env.interface)
        observations = [env.reset(seed=0)[0], *(env.step(np.zeros(2))[0] for _ in range(100))]
        now, *later = (observations[20 + step][adapter.interface.layout.reference[:6]] for step in (0, *steps))
        seen = adapter.observe(observations[20][None], adapter.initial(observations[20][None]))[0]
        expected = (np.array(later) - now) / np.repeat(settings.scales, 2)
        np.testing.assert_allclose(seen[-30:], np.clip(expected, -10, 10).ravel(), atol=1e-12)
        assert np.abs(expected).max() > 10
        without = AgentAdapter(dataclasses.replace(settings, preview=0.0), env.interface)
        assert adapter.size == len(seen) == 30 + without.size


def test_the_samples_of_a_preview():
    for preview, control_dt, samples in ((0.0, 0.01, 0), (0.1, 0.01, 10), (0.3, 0.1, 3), (1e-3, 0.01, 1)):
        assert AdapterSettings(preview=preview).previewed(control_dt) == samples


def test_a_saved_agent_declares_its_preview_and_gets_it(tmp_path):
    settings = AdapterSettings(preview=0.05, sensors=MOTION)
    env = TwoLinkArmEnv("servo-nominal", preview=5)
    write(tmp_path, random_actor(settings, env.interface), {"interface": dataclasses.asdict(settings)})
    assert resolve(str(tmp_path)).preview == 0.05
    result = run_cell(Cell(str(tmp_path), "servo-nominal", (0, 1)))
    (sensors,) = [column.values for column in columns(assemble([result])) if column.key == "sensors"]
    assert (result.error, sensors) == ("", ["p v r"])
