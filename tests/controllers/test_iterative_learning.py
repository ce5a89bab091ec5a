"""Iterative learning control: the contraction of its theory, and the state that goes on from trial to trial."""

import numpy as np
import pytest

import controllers
from benchmarks.run.rollout import rollout, rollout_trials
from controllers.laws.iterative_learning import CAPACITY
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.tiers import tier_scenario
from tests.controllers.closed_loop import nominal

W, GAIN, BANDWIDTH, DT = 10.0, 0.6, 20.0, 0.004

# The stretched arm without gravity stays where it is linear.
STILL = nominal(
    arm={"gravity": 0.0}, actuator=None, control_dt=DT, duration=4.0,
    reference={"kind": "array", "position": [[0, 0]] * 2, "velocity": [[0, 0]] * 2, "acceleration": [[0, 0]] * 2},
)  # fmt: skip


@pytest.mark.parametrize("frequency", [3.0, 10.0, 25.0])
def test_an_error_that_repeats_shrinks_by_the_factor_of_the_theory(frequency):
    """A disturbance d of one frequency [rad/s], in the middle of the trial, where no transient is left."""
    law = controllers.make("computed-torque-ilc", TwoLinkArmEnv(STILL, action="torque"))
    size = tuple(0.05 * law.stretched)
    disturbance = {"kind": "sine", "amplitude": size, "frequency": frequency / (2 * np.pi), "phase": 0.0}
    gains = {"frequency": W, "gain": GAIN, "bandwidth": BANDWIDTH}
    traces = rollout_trials("computed-torque-ilc", STILL.replace(disturbance=disturbance), [0], 3, gains)
    middle = slice(STILL.steps // 3, -STILL.steps // 6)
    sizes = [np.abs((trace.reference - trace.position)[middle, 0]).max(axis=0) for trace in traces]
    s, q = 1j * frequency, 2.0 ** (-0.5 * (frequency / BANDWIDTH) ** 2)
    t = (2 * W * s + W**2) / (s + W) ** 2
    # u_2 = Q gain T d, u_3 = Q (u_2 + gain T (d - u_2))
    left = [1.0, abs(1 - q * GAIN * t), abs(1 - q * GAIN * t * (1 + q * (1 - GAIN * t)))]
    np.testing.assert_allclose(np.array(sizes) / sizes[0], np.outer(left, [1, 1]), atol=0.03)


def test_the_first_trial_is_computed_torque_and_later_ones_err_less_on_the_hardware():
    arm = CLASSES["servo"].arm
    scenario = tier_scenario("servo-practice-friction-3", arm).replace(duration=4.0)
    seeds = range(10_000, 10_004)
    first, *_, last = rollout_trials("computed-torque-ilc", scenario, seeds, 5)
    np.testing.assert_array_equal(first.torque, rollout("computed-torque@frequency=10", scenario, seeds).torque)
    errors = [np.abs(trace.reference - trace.position)[100:].mean(axis=(0, 2)) for trace in (first, last)]
    assert last.alive.all()
    assert (errors[1] < 0.25 * errors[0]).all()


def learned(law, observation, steps, state=None, start=None):
    """Return the state of a trial's end, of which each observation is the same."""
    for _ in range(steps):
        (_, state), start = law.predict(observation, state, start), None
    return state


@pytest.fixture
def asked():
    """A law, and the observation of two arms that are away from their references."""
    env = TwoLinkArmVectorEnv(2)
    law = controllers.make("computed-torque-ilc", env)
    observation = env.reset(seed=0)[0]
    observation[:, law.interface.layout["position"]] += 0.1
    return law, observation


def test_it_forgets_a_trial_that_ended_early_and_another_motion(asked):
    law, observation = asked
    begins, state, fresh = np.array([True, True]), learned(law, observation, 20), law.predict(observation)[0]
    assert not np.allclose(law.predict(observation, state, begins)[0], fresh)
    short = learned(law, observation, 19, state, begins)
    np.testing.assert_array_equal(law.predict(observation, short, begins)[0], fresh)
    observation[1, law.interface.layout["reference_position"]] += 0.1
    actions, alone = law.predict(observation, state, begins)[0], law.predict(observation)[0]
    np.testing.assert_array_equal(actions[1], alone[1])
    assert not np.allclose(actions[0], alone[0])


def test_the_lengths_of_other_lanes_trials_do_not_matter(asked):
    """Beyond its room, the state doubles for all lanes."""
    law, observation = asked
    both = learned(law, observation, 30)
    both = learned(law, observation, CAPACITY + 6, both, np.array([False, True]))
    alone = learned(law, observation[1], CAPACITY + 6, learned(law, observation[1], 30), np.array([True]))
    begins = np.array([False, True])
    for _ in range(3):
        actions, both = law.predict(observation, both, begins)
        action, alone = law.predict(observation[1], alone, begins[1:])
        np.testing.assert_array_equal(actions[1], action)
        begins = np.array([False, False])


def test_a_composed_law_learns_too():
    scenario = scenarios.get("servo-practice-nominal").replace(duration=2.0)
    first, second = rollout_trials("computed-torque-ilc+kalman+predictor", scenario, [10_000], 2)
    errors = [np.abs(trace.reference - trace.position)[50:].mean() for trace in (first, second)]
    assert errors[1] < 0.8 * errors[0]
