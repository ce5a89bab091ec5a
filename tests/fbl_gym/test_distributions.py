"""Numbers that vary: drawn per episode from a stream of their own, within their distribution."""

import json

import numpy as np
import pytest
from scipy import stats

from fbl_gym import Distribution, Friction, Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.records import ends, middle
from tests.fbl_gym.paired_runs import play, same

LANES = 4000
VARIED = {
    "parameter_error": {
        "payload": {"mass": {"uniform": [1, 4]}, "pick_up": {"choice": [0.01, 0.02]}, "drop": {"uniform": [0.1, 0.2]}}
    },
    "noise": {"position": {"log_uniform": [1e-4, 1e-2]}, "velocity": {"bias": {"uniform": [-0.1, 0.1]}}},
    "friction": {
        "viscous": [{"uniform": [0, 5]}, 1.0],
        "coulomb": {"uniform": [0, 20]},
        "stiction": {"choice": [0, 5]},
    },
    "disturbance": {"kind": "sine", "amplitude": {"uniform": [0, 20]}, "frequency": {"uniform": [0.5, 2]}},
    "actuator": {
        "delay": {"uniform": [0, 0.025]},
        "lag": {"log_uniform": [1e-4, 0.02]},
        "gain": {"uniform": [0.8, 1.2]},
    },
    "initial_error": {"uniform": [-0.1, 0.1]},
    "initial_velocity": {"uniform": [-1, 1]},
}


def drawn(lanes=LANES, seed=0, **options):
    """Return the truth of many arms at their start, and after a step."""
    env = TwoLinkArmVectorEnv(lanes, action="torque", **options)
    env.reset(seed=seed)
    start = env.truth
    env.step(np.zeros((lanes, 2)))
    return start, env.truth


def check(values, distribution):
    """Refuse values [n] that do not have a distribution of SciPy, by the test of Kolmogorov and Smirnov."""
    assert stats.kstest(values, distribution.cdf).pvalue > 1e-3


def test_numbers_have_their_distributions():
    start, _ = drawn(
        friction={"viscous": {"uniform": [1, 5]}, "coulomb": [{"log_uniform": [0.1, 10]}, {"uniform": [0, 2]}]},
        actuator={"gain": {"uniform": [0.5, 1.5]}},
    )
    for joint in range(2):
        check(start.viscous[:, joint], stats.uniform(1, 4))
        check(start.gain[:, joint], stats.uniform(0.5, 1))
    check(start.coulomb[:, 0], stats.loguniform(0.1, 10))
    check(start.coulomb[:, 1], stats.uniform(0, 2))
    assert abs(np.corrcoef(start.viscous.T)[0, 1]) < 0.06
    assert abs(np.corrcoef(start.viscous[:, 0], start.gain[:, 0])[0, 1]) < 0.06


def test_a_choice_has_equal_chances():
    start, _ = drawn(friction={"stiction": {"choice": [1.0, 2.0, 5.0, 2.5]}})
    values, counts = np.unique(start.stiction, return_counts=True)
    np.testing.assert_array_equal(values, [1.0, 2.0, 2.5, 5.0])
    assert stats.chisquare(counts).pvalue > 1e-3


def test_the_start_is_drawn():
    still, _ = drawn(reference="sine")
    off, _ = drawn(
        reference="sine", initial_error={"uniform": [-0.2, 0.3]}, initial_velocity=[0.5, {"uniform": [-1, 1]}]
    )
    for joint in range(2):
        check((off.position - still.position)[:, joint], stats.uniform(-0.2, 0.5))
    np.testing.assert_allclose((off.velocity - still.velocity)[:, 0], 0.5)
    check((off.velocity - still.velocity)[:, 1], stats.uniform(-1, 2))


def test_disturbances_are_drawn():
    _, truth = drawn(disturbance={"kind": "pulses", "amplitude": [{"log_uniform": [1, 9]}, 3.0], "width": 0.5})
    check(truth.disturbance[:, 0], stats.loguniform(1, 9))
    np.testing.assert_array_equal(truth.disturbance[:, 1], 3.0)
    sine = {"kind": "sine", "amplitude": 10.0, "phase": 0.0, "frequency": {"uniform": [1, 4]}}
    _, truth = drawn(disturbance=sine)
    check(np.arcsin(truth.disturbance[:, 0] / 10.0) / (2 * np.pi * 0.01), stats.uniform(1, 3))


def test_noise_and_bias_are_drawn():
    layout, seen, truths = play(
        200, 512, noise={"position": {"sigma": {"uniform": [0.01, 0.05]}, "bias": {"uniform": [1, 2]}}}
    )
    errors = seen[..., layout["position"]] - [truth.position for truth in truths]
    for joint in range(2):
        check(errors[..., joint].mean(axis=0), stats.uniform(1, 1))
        spread = np.sort(errors[..., joint].std(axis=0))
        np.testing.assert_allclose(spread, np.linspace(0.01, 0.05, 512), atol=0.006)


def test_payloads_are_drawn_and_come_and_go_at_drawn_times():
    times = {"pick_up": {"uniform": [0, 0.3]}, "drop": {"choice": [0.5, 0.6]}}
    _, _, truths = play(80, 1000, parameter_error={"payload": {"mass": {"uniform": [1, 4]}, **times}})
    loads = np.array([truth.payload for truth in truths])
    check(loads[40], stats.uniform(1, 3))
    # Truth shows a payload from the step after its pick-up on.
    np.testing.assert_allclose(np.argmax(loads > 0, axis=0).mean() * 0.01, 0.155, atol=0.01)
    assert set(np.argmax(loads[40:] == 0, axis=0) + 40) == {51, 61}


def test_delays_are_drawn_per_arm():
    """Each arm moves as an arm with its delay alone."""
    delays = [0.0, 0.004, 0.01, 0.023]
    _, _, ours = play(40, 64, actuator={"delay": {"choice": delays}})
    theirs = [play(40, 64, actuator={"delay": delay})[2] for delay in delays]
    motion = np.array([truth.position for truth in ours])
    match = [np.all(motion == [truth.position for truth in run], axis=(0, 2)) for run in theirs]
    assert np.sum(match, axis=0).tolist() == [1] * 64
    assert min(np.sum(match, axis=1)) >= 5


def test_lags_are_drawn_per_arm():
    env = TwoLinkArmVectorEnv(LANES, action="torque", actuator={"lag": {"uniform": [0.005, 0.03]}})
    env.reset(seed=0)
    held = env.truth.applied_torque
    env.step(np.full((LANES, 2), 100.0))
    lag = -0.01 / np.log((env.truth.applied_torque - 100.0) / (held - 100.0))
    np.testing.assert_allclose(lag[:, 0], lag[:, 1])
    check(lag[:, 0], stats.uniform(0.005, 0.025))


@pytest.mark.parametrize("name", sorted(VARIED))
def test_another_number_that_varies_shifts_no_draw(name):
    alone, _ = drawn(64, **{name: VARIED[name]})
    crowd, _ = drawn(64, **VARIED)
    fields = {
        "friction": ("viscous", "coulomb", "stiction"),
        "actuator": ("gain",),
        "initial_error": ("position",),
        "initial_velocity": ("velocity",),
        "disturbance": ("disturbance",),
        "parameter_error": ("payload",),
        "noise": ("reference",),
    }
    assert same([alone], [crowd], *fields[name])


@pytest.mark.parametrize("lanes", [1, 7, 33])
def test_a_lane_draws_as_the_single_environment_in_every_episode(lanes):
    options = {**VARIED, "duration": 0.05}
    envs = TwoLinkArmVectorEnv(lanes, autoreset_mode="SameStep", **options)
    env = TwoLinkArmEnv(**options)
    np.testing.assert_array_equal(envs.reset(seed=3)[0][-1], env.reset(seed=3 + lanes - 1)[0])
    seen = []
    for k in range(20):
        action = np.array([0.1 * np.sin(k), 0.05])
        observations, rewards, *_ = envs.step(np.tile(action, (lanes, 1)))
        observation, reward, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            observation = env.reset()[0]
        np.testing.assert_array_equal(observations[-1], observation)
        assert rewards[-1] == reward
        seen.append(tuple(env.truth.coulomb))
    assert len(set(seen)) == 5


def test_a_fixed_number_is_the_choice_of_it_alone():
    ours = play(friction={"viscous": {"choice": [2.0]}, "coulomb": {"uniform": [3.0, 3.0]}})
    theirs = play(friction={"viscous": 2.0, "coulomb": 3.0})
    np.testing.assert_array_equal(ours[1], theirs[1])


def test_distributions_survive_json():
    scenario = Scenario(**VARIED)
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario
    assert scenario.friction.coulomb == (Distribution(uniform=(0.0, 20.0)),) * 2
    assert scenario.friction.viscous[1] == 1.0
    assert hash(scenario.friction) == hash(Friction(**VARIED["friction"]))


def test_ends_and_middle():
    assert ends((Distribution(uniform=(1, 2)), 5.0)) == (1.0, 5.0)
    assert middle(Distribution(log_uniform=(1, 4))) == 2.0
    assert middle(Distribution(choice=(1, 4, 6))) == 3.5
    assert middle(3.0) == 3.0


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"uniform": [5, 1]}, r"friction: coulomb: uniform\[1\] must be a finite number not below 5, got 1"),
        ({"uniform": [-1, 1]}, "friction: coulomb, a distribution, must be a finite number not below 0, got -1.0"),
        ({"log_uniform": [0, 1]}, r"friction: coulomb: log_uniform\[0\] must be a finite number greater than 0, got 0"),
        ({"uniform": 3}, "friction: coulomb: uniform must be the two ends of a range, got 3"),
        ({"choice": []}, r"friction: coulomb: choice must be a list of numbers, got \[\]"),
        ({"choice": [1, "x"]}, r"friction: coulomb: choice\[1\] must be a finite number, got 'x'"),
        ({"unifrom": [0, 1]}, "unknown field of coulomb 'unifrom'; did you mean 'uniform'"),
        ({"uniform": [0, 1], "choice": [1]}, "give one of uniform, log_uniform, choice, got"),
        ({}, "give one of uniform, log_uniform, choice, got"),
        ([{"uniform": [0, 1]}] * 3, "coulomb must be one number, or one for each of the two joints"),
    ],
)
def test_a_wrong_distribution_is_an_error_with_its_right_form(value, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmEnv(friction={"coulomb": value})


def test_a_number_that_may_not_vary_says_so():
    with pytest.raises(ValueError, match=r"torque_limit must be a finite number .*got {'uniform'"):
        TwoLinkArmEnv(actuator={"torque_limit": {"uniform": [1, 2]}})


def test_a_payload_must_be_dropped_after_it_is_picked_up_in_every_episode():
    with pytest.raises(ValueError, match="drop must be a finite number greater than 2, got 1"):
        TwoLinkArmEnv(parameter_error={"payload": {"mass": 1, "pick_up": {"uniform": [0, 2]}, "drop": 1.0}})
