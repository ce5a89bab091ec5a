"""Ends that an engineer expects: a lost run, a task that cannot be done, and the truth of no episode."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import ID, started


def end(**options):
    """Return the number of steps of an unforced arm's episode, its flags and the errors of its steps [steps]."""
    env = started(action="torque", **options)
    errors = []
    for k in range(env.scenario.steps):
        *_, terminated, truncated, _ = env.step((0.0, 0.0))
        errors.append(np.abs(env.truth.reference - env.truth.position).max())
        if terminated or truncated:
            return k + 1, terminated, truncated, np.array(errors)
    raise AssertionError("the episode did not end")


def test_an_arm_is_lost_after_a_time_far_from_its_reference():
    steps, terminated, truncated, errors = end(limits={"error": 0.5, "error_time": 0.3})
    assert (terminated, truncated) == (True, False)
    assert (errors[-30:] > 0.5).all()
    assert not any((errors[k : k + 30] > 0.5).all() for k in range(steps - 30))


def test_an_arm_that_comes_back_in_time_is_not_lost():
    """A swinging arm is far from its reference again and again, each time for less than the limit."""
    limits = {"error": 1.0, "error_time": 3.0, "position": 100.0}
    options = {"reference": {"kind": "array", "position": [(-np.pi / 2, 0.0)]}, "initial_error": 0.9}
    _, terminated, truncated, errors = end(limits=limits, **options)
    assert (errors > 1.0).sum() > 10
    assert (terminated, truncated) == (False, True)


@pytest.mark.parametrize("limits", [{}, {"error": 0.01, "error_time": 1.7e308}], ids=str)
def test_an_arm_may_be_far_from_its_reference_unless_a_limit_ends_it(limits):
    assert end(limits=limits)[1:3] == (False, True)


def test_an_error_time_of_one_step_ends_at_once():
    assert end(limits={"error": 0.1, "error_time": 0.01}, initial_error=0.2)[:2] == (1, True)


def test_the_truth_needs_an_episode():
    for env in (TwoLinkArmEnv(), TwoLinkArmVectorEnv(2)):
        with pytest.raises(ResetNeeded, match=r"call reset\(\) before reading truth: no episode has begun"):
            _ = env.truth
        env.reset(seed=0)
        assert env.truth.position.shape[-1] == 2


def test_arrays_inside_options_survive_the_spec():
    noise = {"position": {"sigma": np.array([1e-3, 2e-3])}}
    reference = {"kind": "array", "position": np.zeros((3, 2)), "dt": np.float64(0.1)}
    env = gym.make(ID, actuator={"torque_limit": np.array([100.0, 50.0])}, noise=noise, reference=reference)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario == env.unwrapped.scenario
