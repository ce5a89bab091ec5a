"""Limits, constraints and rewards: bounds, costs, and the end of the episode of an arm that diverged or is lost."""

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from fbl_gym import Constraints, Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import TIGHT, started

STILL = {"kind": "array", "position": [(0.2, 0.1)]}


def test_each_limit_reaches_its_space():
    limits = {"position": 1.5, "velocity": 7.0, "acceleration": 11.0, "command": 13.0}
    env = TwoLinkArmEnv(action="acceleration", limits=limits)
    high = env.observation_space.high
    for name, bound in (("position", 3.0), ("velocity", 14.0), ("acceleration", 11.0)):
        np.testing.assert_array_equal(high[env.layout[name]], bound)
        np.testing.assert_array_equal(high[env.layout[f"reference_{name}"]], bound)
    np.testing.assert_array_equal(env.action_space.high, np.float32(13.0))
    env.reset(seed=0)
    observation = env.step((13.0, -13.0))[0]
    assert np.abs(env.truth.acceleration).max() > 11.0
    assert np.abs(observation[env.layout["acceleration"]]).max() == 11.0


@pytest.mark.parametrize("limit", ["position", "velocity"])
def test_an_arm_diverges_just_beyond_its_limit(limit):
    """The limit holds for each joint, from its start."""
    bound = {"position": 0.4, "velocity": 2.0}[limit]
    for torque in ((2000.0, 0.0), (0.0, -400.0)):
        env = started(action="torque", limits={limit: bound}, initial_error=0.3, reference=STILL)
        start, ended = env.truth.position, False
        while not ended:
            ended = env.step(torque)[2]
            gone = env.truth.position - start if limit == "position" else env.truth.velocity
            assert ended == bool(np.abs(gone).max() > bound)


def test_divergence_ends_the_episode_also_at_the_last_step():
    """Terminated with reward 0, and truncated too if it was the last step; then it needs a reset."""
    env = started(limits={"velocity": 2.0})
    last = next(k for k in range(1000) if env.step((1.0, 1.0))[2]) + 1
    env = started(limits={"velocity": 2.0}, duration=last * 0.01)
    steps = [env.step((1.0, 1.0)) for _ in range(last)]
    assert [step[2:4] for step in steps] == [(False, False)] * (last - 1) + [(True, True)]
    assert min(step[1] for step in steps[:-1]) > 0.0 == steps[-1][1]
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step((0.0, 0.0))
    env.reset()
    assert not env.step((0.0, 0.0))[2]


def end(**options):
    """Return the number of steps of an unforced arm's episode, its flags and the errors of its steps [steps]."""
    env, errors, ends = started(action="torque", **options), [], [False, False]
    while not any(ends):
        _, _, *ends, _ = env.step((0.0, 0.0))
        errors.append(np.abs(env.truth.reference - env.truth.position).max())
    return len(errors), *ends, np.array(errors)


def test_an_arm_is_lost_after_a_time_far_from_its_reference():
    steps, *ends, errors = end(limits={"error": 0.5, "error_time": 0.3})
    assert ends == [True, False]
    assert (errors[-30:] > 0.5).all()
    assert not any((errors[k : k + 30] > 0.5).all() for k in range(steps - 30))


def test_an_arm_that_comes_back_in_time_is_not_lost():
    """A swinging arm is far from its reference again and again, each time for less than the limit."""
    limits, hanging = {"error": 1.0, "error_time": 3.0, "position": 100.0}, [(-np.pi / 2, 0.0)]
    _, *ends, errors = end(limits=limits, reference={"kind": "array", "position": hanging}, initial_error=0.9)
    assert ends == [False, True]
    assert (errors > 1.0).sum() > 10


def test_an_arm_may_be_far_from_its_reference_unless_a_limit_ends_it():
    for limits in ({}, {"error": 0.01, "error_time": 1.7e308}):
        assert end(limits=limits)[1:3] == (False, True)
    assert end(limits={"error": 0.1, "error_time": 0.01}, initial_error=0.2)[:2] == (1, True)


def test_the_truth_needs_an_episode():
    for env in (TwoLinkArmEnv(), TwoLinkArmVectorEnv(2)):
        with pytest.raises(ResetNeeded, match=r"call reset\(\) before reading truth: no episode has begun"):
            _ = env.truth
        with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
            env.step(np.zeros(env.action_space.shape))
        env.reset(seed=0)
        assert env.truth.position.shape[-1] == 2


@pytest.mark.parametrize("options", [{}, {"joint": {"stiffness": 4000, "rotor_inertia": 0.5}, "info": True}], ids=str)
def test_the_cost_is_one_beyond_a_bound(options):
    env, plain = TwoLinkArmEnv("everything-2", constraints=TIGHT, **options), TwoLinkArmEnv("everything-2", **options)
    assert env.reset(seed=1)[1] == {}
    plain.reset(seed=1)
    costs = []
    for k in range(80):
        action = np.full(2, 0.4 if k % 40 < 20 else -0.4)
        *step, info = env.step(action)
        for ours, theirs in zip(step, plain.step(action), strict=False):
            np.testing.assert_array_equal(ours, theirs)
        truth = env.truth
        assert info["cost"] == env.scenario.constraints.violated(truth.position, truth.velocity)
        costs.append(info["cost"])
    assert set(costs) == {0.0, 1.0}
    assert set(info) == ({"cost"} if not options else {*plain.step(action)[4], "cost"})


BOUNDS = [("low", (-1.5, -9.0)), ("high", (9.0, 0.3)), ("velocity", (0.5, 99.0)), ("velocity", (99.0, 0.5))]


@pytest.mark.parametrize(("bound", "value"), BOUNDS)
def test_each_bound_counts(bound, value):
    env = started(constraints={bound: value}, action="torque", seed=3)
    costs = set()
    for _ in range(100):
        cost, truth = env.step((0.0, 0.0))[4]["cost"], env.truth
        q, speed = truth.position, np.abs(truth.velocity)
        beyond = {"low": value - q, "high": q - value, "velocity": speed - value}[bound]
        costs.add(cost)
        assert cost == (beyond.max() > 0.0)
    assert costs == {0.0, 1.0}
    assert Constraints(**{bound: value}) == env.interface.constraints


def test_an_end_has_no_reward():
    env = started(constraints={**TIGHT, "violation": "end"})
    while not (step := env.step((0.3, 0.3)))[2]:
        assert step[4]["cost"] == 0.0
    assert (step[1], step[4]["cost"]) == (0.0, 1.0)


RATES = [(0.01, 0.001, 10), (0.001, 0.001, 1), (0.3, 0.1, 3), (1 / 30, 1 / 300, 10), (0.02, 1e-4, 200), (0.7, 0.1, 7)]


@pytest.mark.parametrize(("control_dt", "physics_dt", "substeps"), RATES)
def test_any_physics_step_that_divides_the_control_step_works(control_dt, physics_dt, substeps):
    scenario = Scenario(control_dt=control_dt, physics_dt=physics_dt, duration=3 * control_dt)
    assert scenario.substeps == substeps
    env = started(scenario)
    assert [env.step((0.0, 0.0))[2:4] for _ in range(3)] == [(False, False)] * 2 + [(False, True)]
    with pytest.raises(ResetNeeded):
        env.step((0.0, 0.0))
    assert env.truth.time == pytest.approx(3 * control_dt)


# Rewards.


@pytest.mark.parametrize("form", ["log", "l1"])
@pytest.mark.parametrize("actuator", [{}, {"delay": 0.05, "lag": 0.1}], ids=str)
def test_the_reward_is_the_documented_equation(form, actuator):
    """Effort and chatter are of the command, not of the applied torque."""
    weights = {"weight_tracking": 2.0, "weight_effort": 0.3, "weight_chatter": 0.7}
    reward = {"tracking": form, "worst": 1.5, "resolution": 2e-3, **weights}
    env = started(reward=reward, noise={"position": 0.1}, actuator=actuator)
    rng, before = np.random.default_rng(0), env.truth.applied_torque / env.interface.torque_limit
    for k in range(60):
        u = rng.uniform(-0.2, 0.2, 2) * (1 if k % 10 else 7)  # now and then beyond its box
        reward, u = env.step(u)[1], np.clip(u, -1.0, 1.0)
        error = np.abs(env.truth.reference - env.truth.position).sum()
        t = np.log(1 + error / 2e-3) / np.log(1 + 1.5 / 2e-3) if form == "log" else error / 1.5
        e, c = np.abs(u).mean(), np.abs(u - before).mean() / 2
        assert reward == pytest.approx(1 - (2.0 * min(t, 1.0) + 0.3 * e + 0.7 * c) / 3.0, abs=1e-12)
        assert 0.0 <= reward <= 1.0
        before = u


def test_without_torque_limits_only_tracking_counts():
    env = started(actuator=None, action="torque", reward={"tracking": "l1", "worst": 3.0})
    for k in range(30):
        reward, truth = env.step((500.0 * (-1) ** k, 0.0))[1], env.truth
        error = np.abs(truth.reference - truth.position).sum()
        assert reward == pytest.approx(1 - min(error / 3.0, 1.0) / 1.12, abs=1e-12)


@pytest.mark.parametrize("form", ["log", "l1"])
def test_reward_has_a_slope_at_zero_error(form):
    """It is one at perfect tracking without effort or chatter, here of an arm that floats beside its reference."""
    still = {"reference": {"kind": "minimum-jerk", "points": [(0.0, 0.0)]}, "arm": {"gravity": 0.0}}
    errors = (0.0, 1e-6, 1e-4, 1e-2)
    envs = (started(reward={"tracking": form}, initial_error=(error, 0.0), **still) for error in errors)
    rewards = [env.step((0.0, 0.0))[1] for env in envs]
    assert rewards[0] == 1.0
    assert np.all(np.diff(rewards) / np.diff(errors) < -0.1)
