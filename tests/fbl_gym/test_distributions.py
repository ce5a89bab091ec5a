"""Numbers that vary have their distributions.

`test_options.py` checks for every number that an arm which draws a value is the arm with that value.
"""

import numpy as np
from scipy import stats

from fbl_gym import Distribution, Friction
from fbl_gym.records import ends, middle
from tests.fbl_gym.episodes import started_batch
from tests.fbl_gym.paired_runs import play

LANES = 4000


def drawn(lanes=LANES, seed=0, **options):
    """Return the truth of many arms at their start, and after a step."""
    env = started_batch(lanes, action="torque", **options, seed=seed)
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


def test_a_fixed_number_is_the_choice_of_it_alone():
    ours = play(friction={"viscous": {"choice": [2.0]}, "coulomb": {"uniform": [3.0, 3.0]}})
    theirs = play(friction={"viscous": 2.0, "coulomb": 3.0})
    np.testing.assert_array_equal(ours[1], theirs[1])


def test_a_pair_holds_a_distribution_for_each_joint():
    friction = Friction(viscous=[{"uniform": [0, 5]}, 1.0], coulomb={"uniform": [0, 20]})
    assert friction.coulomb == (Distribution(uniform=(0.0, 20.0)),) * 2
    assert friction.viscous == (Distribution(uniform=(0.0, 5.0)), 1.0)


def test_ends_and_middle():
    assert ends((Distribution(uniform=(1, 2)), 5.0)) == (1.0, 5.0)
    assert middle(Distribution(log_uniform=(1, 4))) == 2.0
    assert middle(Distribution(choice=(1, 4, 6))) == 3.5
    assert middle(3.0) == 3.0
