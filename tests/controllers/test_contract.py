"""One suite over everything that is registered: what a policy promises, whoever wrote it."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

import controllers
import fbl_gym
from fbl_gym import Interface, TwoLinkArmEnv, TwoLinkArmVectorEnv

NAMES = controllers.names()
HONEST = [name for name in NAMES if controllers.access(name) != "privileged"]


def run(policy, env, steps, seed=0):
    """Observations and actions of a closed loop."""
    observation, _ = env.reset(seed=seed)
    state, log = None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state)
        log.append((observation, action))
        observation = env.step(action)[0]
    return log


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("action", ["normalized", "torque", "acceleration"])
def test_actions_have_the_observations_shape_and_lie_in_the_box(name, action):
    env = TwoLinkArmVectorEnv(5, "everything-2", action=action)
    for _, actions in run(controllers.make(name, env), env, 20):
        assert actions.shape == (5, 2)
        low, high = env.single_action_space.low, env.single_action_space.high
        assert np.all((actions >= low) & (actions <= high))
    single = TwoLinkArmEnv("everything-2", action=action)
    for _, one in run(controllers.make(name, single), single, 5):
        assert one.shape == (2,)


@pytest.mark.parametrize("name", NAMES)
def test_a_lane_of_a_batch_acts_as_a_single_policy(name):
    batch, lanes = TwoLinkArmVectorEnv(4, "everything-3"), []
    together = run(controllers.make(name, batch), batch, 50, seed=10)
    for lane in range(4):
        env = TwoLinkArmEnv("everything-3")
        lanes.append(run(controllers.make(name, env), env, 50, seed=10 + lane))
    for k, (_, actions) in enumerate(together):
        np.testing.assert_allclose(actions, [lane[k][1] for lane in lanes], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", HONEST)
def test_episode_start_begins_just_those_lanes_afresh(name):
    env = TwoLinkArmVectorEnv(3, "mixed-error-3")
    policy = controllers.make(name, env)
    log = run(policy, env, 60)
    observation, _ = env.reset(seed=5)
    old = None
    for earlier, _ in log:
        _, old = policy.predict(earlier, old)
    kept, _ = policy.predict(observation, old, np.array([False, False, False]))
    fresh, _ = policy.predict(observation, None)
    mixed, _ = policy.predict(observation, old, np.array([False, True, False]))
    np.testing.assert_array_equal(mixed[[0, 2]], kept[[0, 2]])
    np.testing.assert_array_equal(mixed[1], fresh[1])


@pytest.mark.parametrize("name", NAMES)
def test_predict_is_a_function_of_its_arguments(name):
    env = TwoLinkArmVectorEnv(2, "mixed-error-3")
    policy = controllers.make(name, env)
    log = run(policy, env, 10)
    state = None
    for observation, _ in log:
        _, state = policy.predict(observation, state)
    before = [x.copy() for x in state or ()]
    one, _ = policy.predict(log[-1][0], state)
    two, _ = policy.predict(log[-1][0], state)
    np.testing.assert_array_equal(one, two)
    for x, y in zip(before, state or (), strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("name", NAMES)
def test_policies_are_frozen(name):
    policy = controllers.make(name, TwoLinkArmEnv())
    field = dataclasses.fields(policy)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(policy, field, None)


@pytest.mark.parametrize("name", HONEST)
def test_no_way_to_the_truth(name):
    """What an honest policy holds is plain data: its interface and its gains, nothing that leads to an environment."""
    policy = controllers.make(name, TwoLinkArmEnv("mixed-error-3"))
    for field in dataclasses.fields(policy):
        value = getattr(policy, field.name)
        assert isinstance(value, Interface | float | int | str | tuple | None), field.name
    assert controllers.make(name, policy.interface) == policy


@pytest.mark.parametrize("name", HONEST)
def test_hidden_parameters_do_not_change_a_decision(name):
    """Two arms with one nominal model and the same readings get the same action."""
    policy = [controllers.make(name, TwoLinkArmEnv(parameter_error=ratio)) for ratio in (0.5, 2.0)]
    observation, _ = TwoLinkArmEnv().reset(seed=1)
    np.testing.assert_array_equal(policy[0].predict(observation)[0], policy[1].predict(observation)[0])


@pytest.mark.parametrize("name", NAMES)
def test_sb3_evaluates_it_as_it_is(name):
    evaluation = pytest.importorskip("stable_baselines3.common.evaluation")
    monitor = pytest.importorskip("stable_baselines3.common.monitor")
    env = monitor.Monitor(gym.make("fbl_gym/TwoLinkArm-v0", duration=1.0))
    reward, spread = evaluation.evaluate_policy(controllers.make(name, env), env, n_eval_episodes=2)
    assert 0.0 <= reward <= 100.0
    assert spread >= 0.0


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("zero", "adrc", "nmpc", "oracle-flm")])
def test_a_missing_sensor_is_named(name):
    with pytest.raises(ValueError, match="needs a sensor of"):
        controllers.make(name, TwoLinkArmEnv(sensors=("position",)))


def test_a_wrong_observation_is_refused():
    env = TwoLinkArmEnv()
    policy = controllers.make("pid-flm", env)
    with pytest.raises(ValueError, match=r"observation must have shape \(12,\)"):
        policy.predict(np.zeros(7))


def test_names_and_arguments_are_checked():
    env = TwoLinkArmEnv()
    with pytest.raises(ValueError, match="did you mean 'pid-flm'"):
        controllers.make("pid-fml", env)
    with pytest.raises(ValueError, match="unknown argument of pid-flm 'kpp'; did you mean 'kp'"):
        controllers.make("pid-flm", env, kpp=3)
    with pytest.raises(ValueError, match="kp must be a finite number"):
        controllers.make("pid-flm", env, kp=float("nan"))
    with pytest.raises(ValueError, match="needs the environment"):
        controllers.make("oracle-flm", env.interface)
    with pytest.raises(ValueError, match="registered already"):
        controllers.register("zero", "controllers.simple:Zero", "again")


def test_a_strangers_policy_is_found_by_its_entry_point(monkeypatch):
    """Any installed package can add a policy with an entry point `fbl_gym.policies`."""
    from importlib import metadata

    from controllers import policy

    point = metadata.EntryPoint("mine", "controllers.simple:PdGravity", policy.ENTRY_POINTS)
    monkeypatch.setattr(policy, "_entry_points", lambda: (point,))
    assert "mine" in controllers.names()
    assert controllers.access("mine") == "nominal"
    assert controllers.summary("mine").startswith("torque = Kp e")
    assert controllers.make("mine", TwoLinkArmEnv(), frequency=3.0).frequency == (3.0, 3.0)


def test_a_law_of_ones_own_in_a_few_lines():
    """What the README shows: a subclass of TorqueLaw is a policy."""

    @dataclasses.dataclass(frozen=True)
    class ComputedTorque(controllers.TorqueLaw):
        w: float = 8.0

        def torque(self, observation, state):
            q, v = self.read(observation, "position", "velocity")
            r, dr, ddr = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
            a = ddr + self.w**2 * (r - q) + 2 * self.w * (dr - v)
            return fbl_gym.arm.inverse_dynamics(self.interface.nominal, q, v, a), state

    env = TwoLinkArmEnv()
    run(ComputedTorque(env.interface), env, 900)
    assert np.abs(env.truth.reference - env.truth.position).max() < 5e-3
