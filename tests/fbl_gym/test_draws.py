"""Numbers that vary: their distributions, independence of other options, and `drawn_per`.

`test_options.py` checks for every number that an arm which draws a value is the arm with that value.
"""

import numpy as np
import pytest
from scipy import stats

from fbl_gym import Distribution, TwoLinkArmVectorEnv
from fbl_gym.records.record import ends, middle
from tests.fbl_gym.episodes import play, run, same, started_batch

LANES = 4000


def test_numbers_have_their_distributions():
    friction = {"viscous": {"uniform": [1, 5]}, "coulomb": [{"log_uniform": [0.1, 10]}, {"uniform": [0, 2]}]}
    start = started_batch(LANES, friction=friction, actuator={"gain": {"uniform": [0.5, 1.5]}}).truth
    drawn = np.hstack([start.viscous, start.gain, start.coulomb]).T
    expected = [
        *[stats.uniform(1, 4)] * 2,
        *[stats.uniform(0.5, 1)] * 2,
        stats.loguniform(0.1, 10),
        stats.uniform(0, 2),
    ]
    for values, distribution in zip(drawn, expected, strict=True):
        assert stats.kstest(values, distribution.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(start.viscous.T)[0, 1]) < 0.06
    assert abs(np.corrcoef(start.viscous[:, 0], start.gain[:, 0])[0, 1]) < 0.06


def test_a_choice_has_equal_chances():
    start = started_batch(LANES, friction={"stiction": {"choice": [1.0, 2.0, 5.0, 2.5]}}).truth
    values, counts = np.unique(start.stiction, return_counts=True)
    np.testing.assert_array_equal(values, [1.0, 2.0, 2.5, 5.0])
    assert stats.chisquare(counts).pvalue > 1e-3


def test_ends_and_middle():
    assert ends((Distribution(uniform=(1, 2)), 5.0)) == (1.0, 5.0)
    numbers = Distribution(log_uniform=(1, 4)), Distribution(choice=(1, 4, 6)), 3.0
    assert [*map(middle, numbers)] == [2.0, 3.5, 3.0]


UNRELATED = ("applied_torque", "disturbance", "masses", "lengths", "payload")
CROWDED = {
    "parameter_error": {"radius": 0.5, "payload": {"mass": 3.0, "pick_up": 0.3}},
    "disturbance": {"kind": "piecewise-constant", "amplitude": 20.0, "period": 0.07},
    "noise": {"position": 0.01, "velocity": 0.1},
    "friction": {"coulomb": 3.0},
}


def readings(layout, seen, truths):
    """Return the errors of the sensors [steps + 1 x lanes x 4]."""
    added = [seen[..., layout[name]] - [getattr(truth, name) for truth in truths] for name in ("position", "velocity")]
    return np.concatenate(added, axis=-1)


@pytest.mark.parametrize("change", [
    {"reference": {"kind": "fourier"}}, {"reference": {"kind": "steps", "period": 0.3}},
    {"reference": {"kind": "minimum-jerk", "low": 0.0, "high": 1.0}}, {"initial_error": (0.2, -0.1)},
    {"friction": None}, {"arm": {"gravity": 0.0}},
], ids=str)  # fmt: skip
def test_another_task_has_the_same_random_numbers(change):
    ours, theirs = play(**{**CROWDED, **change}), play(**CROWDED)
    np.testing.assert_allclose(readings(*ours), readings(*theirs), atol=1e-11)
    assert same(ours[2][1:], theirs[2][1:], *UNRELATED)
    assert not same(ours[2][5:], theirs[2][5:], "position", "reference")


@pytest.mark.parametrize("change", [
    {"reward": {"tracking": "l1", "weight_effort": 3.0}}, {"preview": 4}, {"duration": 4.0},
    {"limits": {"position": 50.0, "velocity": 200.0, "command": 5.0}},
    {"name": "another", "description": "of the same"},
], ids=str)  # fmt: skip
def test_options_outside_the_arm_do_not_move_it(change):
    """All readings and the whole truth are the same to the bit."""
    (_, seen, truths), (_, others, plain) = (play(60, 20, **{**CROWDED, **more}) for more in (change, {}))
    np.testing.assert_array_equal(seen[..., :12], others[..., :12])
    for one, other in zip(truths, plain, strict=True):
        np.testing.assert_equal(vars(one), vars(other))


OPTIONS = {
    "parameter_error": {"radius": 0.5, "payload": {"mass": {"uniform": [1, 4]}, "pick_up": {"uniform": [0, 0.02]}}},
    "noise": {"position": {"sigma": 0.01, "bias": {"uniform": [0, 1]}}}, "friction": {"coulomb": {"uniform": [0, 20]}},
    "disturbance": {"kind": "piecewise-constant", "amplitude": {"uniform": [5, 20]}, "period": 0.02},
    "actuator": {"gain": {"uniform": [0.8, 1.2]}}, "initial_error": {"uniform": [-0.1, 0.1]},
}  # fmt: skip
DRAWN = ("masses", "lengths", "payload", "coulomb", "gain", "reference")


def episodes(**options):
    """Return the readings, and the truth of each step, of two episodes in a row and of one of another seed."""
    env = TwoLinkArmVectorEnv(17, action="torque", **(OPTIONS | options))
    return [run(env, 6, seed=seed) for seed in (3, None, 4)]


@pytest.mark.parametrize("reference", ["minimum-jerk", "steps", "filtered-steps", "fourier"])
def test_arm_and_reference_stay_and_noise_and_disturbance_are_new(reference):
    (seen, first), (seen_again, second), (_, other) = episodes(drawn_per="seed", reference=reference)
    assert (other[0].masses != first[0].masses).all()
    for one, two in zip(first, second, strict=True):
        for name in DRAWN:
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)
    np.testing.assert_array_equal(first[0].position, second[0].position)
    assert (first[3].disturbance != second[3].disturbance).all()
    (usual, usual_first), (usual_again, usual_second), _ = episodes(reference=reference)
    np.testing.assert_array_equal(seen, usual)
    assert not np.array_equal(usual_first[0].masses, usual_second[0].masses)
    assert not np.array_equal(usual_first[0].reference, usual_second[0].reference)
    pairs = ((seen, first), (seen_again, second), (usual_again, usual_second))
    noise, new, usual_new = (rows[..., :2] - [truth.position for truth in truths] for rows, truths in pairs)
    assert np.std(noise - new) == pytest.approx(0.01 * np.sqrt(2), rel=0.2)  # the bias stays
    np.testing.assert_allclose(np.diff(new, axis=0), np.diff(usual_new, axis=0), atol=1e-12)
