"""The adapter between environment and agent."""

import numpy as np
import pytest

import controllers
from benchmarks.rl.adapter import AdapterSettings, AgentAdapter
from benchmarks.rl.agent import Agent
from benchmarks.rl.vec_env import ArmVecEnv, VectorAdapter
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.arm import forward_dynamics
from tests.benchmarks.rl.agents import PAYLOAD_OPTIONS, random_actor

MOTION = ("position", "velocity")


@pytest.mark.parametrize(
    ("action", "history", "context"),
    [
        ("torque", 0, False),
        ("residual", 3, False),
        ("residual", 0, True),
        ("residual", 3, True),
        ("blend", 1, False),
    ],
)
def test_an_agent_acts_as_in_training(action, history, context):
    """Closed loops on the plain environment and on the training environment are equal over several episodes."""
    second = "pid-flm" if action == "blend" else ""
    settings = AdapterSettings(action=action, second=second, history=history, context=context)
    options = {**PAYLOAD_OPTIONS, "autoreset_mode": "SameStep"}
    plain = TwoLinkArmVectorEnv(3, **options)
    training = VectorAdapter(TwoLinkArmVectorEnv(3, **options), settings)
    agent = Agent(plain.interface, settings, random_actor(settings, plain.interface), plain if context else None)
    plain_observation, training_observation = plain.reset(seed=3)[0], training.reset(seed=3)[0]
    state, starts = None, np.ones(3, dtype=bool)
    episodes = 0
    for _ in range(70):
        actions, state = agent.predict(plain_observation, state, starts)
        plain_observation, *outcome, _ = plain.step(actions)
        training_observation, *training_outcome, infos = training.step(agent.actor(training_observation))
        np.testing.assert_array_equal(outcome, training_outcome)
        starts = outcome[1] | outcome[2]
        for lane in np.flatnonzero(starts):
            assert infos["final_obs"][lane].shape == (agent.adapter.size,)
            episodes += 1
    assert episodes == 6
    np.testing.assert_array_equal(plain.truth.position, training.env.unwrapped.truth.position)


def test_history_holds_the_errors_and_actions_of_the_last_steps():
    env = VectorAdapter(TwoLinkArmVectorEnv(2, autoreset_mode="SameStep", duration=0.1), AdapterSettings(history=2))
    observations, actions = [env.reset(seed=1)[0]], []
    np.testing.assert_array_equal(observations[0][:, 12:], 0)
    rng = np.random.default_rng(0)
    for _ in range(5):
        actions.append(rng.uniform(-1, 1, (2, 2)).astype(np.float32))
        observations.append(env.step(actions[-1])[0])
    errors = [observation[:, :12] for observation in observations]
    expected = np.concatenate([errors[5], errors[4], actions[4], errors[3], actions[3]], axis=-1)
    np.testing.assert_array_equal(observations[5], expected)
    for _ in range(5):
        first, *_, infos = env.step(np.zeros((2, 2)))
    np.testing.assert_array_equal(first[:, 12:], 0)  # a new episode
    assert np.any(infos["final_obs"][0][12:] != 0)


@pytest.mark.parametrize("kind", ["normalized", "torque", "acceleration"])
def test_every_kind_of_action_gives_the_same_torque(kind):
    settings = AdapterSettings(action="residual")
    env = TwoLinkArmEnv("mixed-error-2", action=kind)
    observation, _ = env.reset(seed=0)
    agent = Agent(env.interface, settings, random_actor(settings, env.interface))
    action, _ = agent.predict(observation)
    torque, _ = agent.torque(observation[None], agent.initial(observation[None]))
    position, velocity = observation[:2], observation[2:4]
    np.testing.assert_allclose(
        env.interface.torque_from_action(action, position, velocity), env.interface.saturate(torque[0]), rtol=1e-9
    )


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"action": "torques"}, "unknown action 'torques'; did you mean 'torque'"),
        ({"base": "cascade"}, "unknown base 'cascade'; did you mean 'cascade-flm'"),
        ({"base": "computed-torque+eco"}, "did you mean 'eso'"),
        ({"action": "blend"}, "second must be a law for a blend alone, and another than base, got ''"),
        ({"action": "blend", "base": "lqg", "second": "lqg"}, "another than base, got 'lqg'"),
        ({"second": "lqg"}, "second must be a law for a blend alone"),
        ({"action": "blend", "second": "lgq"}, "unknown second 'lgq'; did you mean 'lqg'"),
        ({"memory": -1.0}, "memory must be a finite number not below 0, got -1.0"),
        ({"history": -1}, "history must be a whole number not below 0, got -1"),
        ({"context": "no"}, "context must be True or False, got 'no'"),
        ({"scales": (0.1, -1.0, 10.0)}, r"scales\[1\] must be a finite number greater than 0, got -1.0"),
    ],
)
def test_wrong_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        AdapterSettings(**settings)


def test_another_autoreset_mode_is_refused():
    with pytest.raises(ValueError, match="SameStep"):
        ArmVecEnv(VectorAdapter(TwoLinkArmVectorEnv(2), AdapterSettings()))


def test_a_torque_is_a_share_of_the_drives_limits():
    env = TwoLinkArmEnv("servo-nominal")
    observation = env.reset(seed=0)[0][None]
    adapter = AgentAdapter(AdapterSettings(sensors=("position", "velocity")), env.interface)
    torque, _ = adapter.torque(np.array([[1.0, -0.5]]), observation, adapter.initial(observation))
    np.testing.assert_allclose(torque[0], env.interface.torque_limit * np.array([1.0, -0.5]))
    with pytest.raises(ValueError, match="not applicable: the agent's actions are shares of torque limits"):
        Agent(TwoLinkArmEnv(action="torque", actuator={"torque_limit": None}).interface, AdapterSettings(), None)


def test_a_residual_is_an_acceleration_of_the_nominal_arm():
    env = TwoLinkArmEnv("mixed-error-2")
    observation = env.reset(seed=0)[0][None]
    adapter = AgentAdapter(AdapterSettings("residual", residual=3.0), env.interface)
    torques = [
        adapter.torque(np.array([action]), observation, adapter.initial(observation))[0]
        for action in ([0, 0], [1, -0.5])
    ]
    change = [
        forward_dynamics(env.interface.nominal, observation[:, :2], np.zeros((1, 2)), torque) for torque in torques
    ]
    np.testing.assert_allclose(change[1] - change[0], [[3.0, -1.5]])


def test_a_blend_is_between_its_laws():
    env = TwoLinkArmEnv("servo-practice-payload-1")
    observation = env.reset(seed=0)[0][None]
    adapter = AgentAdapter(AdapterSettings("blend", base="pid-flm", second="lqg"), env.interface)
    laws = [controllers.make(name, env.interface) for name in ("pid-flm", "lqg")]
    first, second = (law.torque(observation, law.initial(observation))[0] for law in laws)
    for action, expected in ((1.0, first), (-1.0, second), (0.5, 0.75 * first + 0.25 * second)):
        torque, _ = adapter.torque(np.full((1, 2), action), observation, adapter.initial(observation))
        np.testing.assert_allclose(torque, expected)


def test_memory_is_the_running_mean_of_the_squares_of_errors_and_of_their_change():
    settings = AdapterSettings(memory=0.04, sensors=("position",), scales=(1.0, 1.0, 1.0))
    env = VectorAdapter(TwoLinkArmVectorEnv(1, control_dt=0.01, autoreset_mode="SameStep", duration=0.1), settings)
    rows = [env.reset(seed=1)[0]]
    errors = [rows[0][:, :2]]
    squares = np.tile(errors[0] ** 2, 2)
    for _ in range(5):
        rows.append(env.step(np.full((1, 2), 0.3))[0])
        before = errors[-2] if len(errors) > 1 else errors[0]
        squares = 0.75 * squares + 0.25 * np.concatenate([errors[-1], errors[-1] - before], axis=-1) ** 2
        np.testing.assert_allclose(rows[-1][:, -4:], 0.25 * np.log(squares + 1e-6))
        errors.append(rows[-1][:, :2])
    for _ in range(5):
        rows.append(env.step(np.zeros((1, 2)))[0])
    np.testing.assert_allclose(rows[-1][:, -4:], 0.25 * np.log(np.tile(rows[-1][:, :2] ** 2, 2) + 1e-6))


def test_an_agent_observes_the_drive_and_its_own_sensors_only():
    settings = AdapterSettings(drive=True, sensors=("position", "velocity"))
    for options in ({"sensors": ("position", "velocity")}, {}):
        env = TwoLinkArmEnv(actuator={"delay_samples": 2, "lag": {"uniform": (0.01, 0.03)}}, **options)
        adapter = AgentAdapter(settings, env.interface)
        observation = env.reset(seed=0)[0][None]
        observed = adapter.observe(observation, adapter.initial(observation), np.empty((1, 0)))
        assert observed.shape == (1, adapter.size) == (1, 17)
        np.testing.assert_allclose(observed[0, -7:], [0.4, 0.4, 0.2, 0.6, 1.0, 0.0, 0.0])


def test_an_agent_decides_once_in_a_period_and_its_law_at_each_step():
    """In training as in use."""
    scenario = scenarios.get("servo-practice-delay-3").replace(duration=1.0)
    settings = AdapterSettings("residual", base="pd-gravity", history=2, period=0.05, sensors=MOTION)
    alone, trained = (TwoLinkArmVectorEnv(3, scenario, autoreset_mode="SameStep") for _ in range(2))
    agent = Agent(alone.interface, settings, random_actor(settings, alone.interface))
    env = VectorAdapter(trained, settings)
    observation, state = alone.reset(seed=7)[0], None
    seen, _ = env.reset(seed=7)
    for _ in range(19):
        seen, mean, *_ = env.step(agent.actor(seen))
        rewards, decided = [], []
        for _ in range(5):
            action, state = agent.predict(observation, state)
            observation, reward, *_ = alone.step(action)
            rewards.append(reward)
            decided.append(state.action)
        np.testing.assert_array_equal(decided, decided[:1] * 5)
        np.testing.assert_allclose(np.mean(rewards, axis=0), mean, atol=1e-12)
        np.testing.assert_array_equal(alone.truth.position, trained.truth.position)


def test_an_episode_that_ends_within_a_period_ends_once():
    scenario = scenarios.get("servo-practice-nominal").replace(duration=0.07)
    env = VectorAdapter(
        TwoLinkArmVectorEnv(2, scenario, autoreset_mode="SameStep"), AdapterSettings(period=0.05, sensors=MOTION)
    )
    env.reset(seed=1)
    ends = [env.step(np.zeros((2, 2))) for _ in range(2)]
    assert [truncated.tolist() for *_, truncated, _ in ends] == [[False] * 2, [True] * 2]
    assert np.stack(ends[1][4]["final_obs"]).shape == (2, env.single_observation_space.shape[0])


def test_a_residual_fades_at_the_torque_limits():
    env = TwoLinkArmEnv("servo-nominal")
    observation = env.reset(seed=0)[0][None].copy()
    observation[:, env.interface.layout["reference_position"]] += 3.0
    adapter = AgentAdapter(AdapterSettings("residual", base="pd-gravity", sensors=MOTION), env.interface)
    law, _ = adapter.torque(np.zeros((1, 2)), observation, adapter.initial(observation))
    assert (np.abs(law) >= env.interface.torque_limit).all()
    np.testing.assert_array_equal(adapter.torque(np.ones((1, 2)), observation, adapter.initial(observation))[0], law)


def test_an_agent_is_not_applicable_without_its_sensors():
    settings = AdapterSettings()
    actor = random_actor(settings, TwoLinkArmEnv().interface)
    with pytest.raises(
        ValueError, match=r"not applicable: .* position, velocity, acceleration, got position, velocity"
    ):
        Agent(TwoLinkArmEnv("servo-nominal").interface, settings, actor)
