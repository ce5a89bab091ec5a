"""Numbers that vary: drawn per episode from a stream of their own, within their distribution."""

import numpy as np
from scipy import stats

from fbl_gym import Distribution, Friction, Scenario, TwoLinkArmVectorEnv
from fbl_gym.records import ends, middle
from tests.fbl_gym.paired_runs import play

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


def test_a_fixed_number_is_the_choice_of_it_alone():
    ours = play(friction={"viscous": {"choice": [2.0]}, "coulomb": {"uniform": [3.0, 3.0]}})
    theirs = play(friction={"viscous": 2.0, "coulomb": 3.0})
    np.testing.assert_array_equal(ours[1], theirs[1])


def test_a_pair_holds_a_distribution_for_each_joint():
    friction = Scenario(**VARIED).friction
    assert friction.coulomb == (Distribution(uniform=(0.0, 20.0)),) * 2
    assert friction.viscous[1] == 1.0
    assert hash(friction) == hash(Friction(**VARIED["friction"]))


def test_ends_and_middle():
    assert ends((Distribution(uniform=(1, 2)), 5.0)) == (1.0, 5.0)
    assert middle(Distribution(log_uniform=(1, 4))) == 2.0
    assert middle(Distribution(choice=(1, 4, 6))) == 3.5
    assert middle(3.0) == 3.0
