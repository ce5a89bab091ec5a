"""Numbers that vary have their distributions.

`test_options.py` checks for every number that an arm which draws a value is the arm with that value.
"""

import numpy as np
from scipy import stats

from fbl_gym import Distribution, Friction
from fbl_gym.records.record import ends, middle
from tests.fbl_gym.episodes import started_batch

LANES = 4000


def test_numbers_have_their_distributions():
    friction = {"viscous": {"uniform": [1, 5]}, "coulomb": [{"log_uniform": [0.1, 10]}, {"uniform": [0, 2]}]}
    start = started_batch(LANES, friction=friction, actuator={"gain": {"uniform": [0.5, 1.5]}}).truth
    drawn = [
        *[(start.viscous[:, joint], stats.uniform(1, 4)) for joint in (0, 1)],
        *[(start.gain[:, joint], stats.uniform(0.5, 1)) for joint in (0, 1)],
        (start.coulomb[:, 0], stats.loguniform(0.1, 10)),
        (start.coulomb[:, 1], stats.uniform(0, 2)),
    ]
    for values, distribution in drawn:
        assert stats.kstest(values, distribution.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(start.viscous.T)[0, 1]) < 0.06
    assert abs(np.corrcoef(start.viscous[:, 0], start.gain[:, 0])[0, 1]) < 0.06


def test_a_choice_has_equal_chances():
    start = started_batch(LANES, friction={"stiction": {"choice": [1.0, 2.0, 5.0, 2.5]}}).truth
    values, counts = np.unique(start.stiction, return_counts=True)
    np.testing.assert_array_equal(values, [1.0, 2.0, 2.5, 5.0])
    assert stats.chisquare(counts).pvalue > 1e-3


def test_a_pair_holds_a_distribution_for_each_joint():
    friction = Friction(viscous=[{"uniform": [0, 5]}, 1.0], coulomb={"uniform": [0, 20]})
    assert friction.coulomb == (Distribution(uniform=(0.0, 20.0)),) * 2
    assert friction.viscous == (Distribution(uniform=(0.0, 5.0)), 1.0)


def test_ends_and_middle():
    assert ends((Distribution(uniform=(1, 2)), 5.0)) == (1.0, 5.0)
    assert middle(Distribution(log_uniform=(1, 4))) == 2.0
    assert middle(Distribution(choice=(1, 4, 6))) == 3.5
    assert middle(3.0) == 3.0
