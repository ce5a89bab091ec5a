"""Viscous friction of a light arm, and the creep of the printed law."""

import re

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.dry_arm import flat
from tests.fbl_gym.episodes import started, truths_of

LIGHT = {"m1": 0.05, "m2": 0.02, "L1": 0.2, "L2": 0.2}


def test_a_step_too_long_for_the_friction_is_refused_with_one_that_does():
    options = {"arm": LIGHT, "friction": {"viscous": 5.0}}
    with pytest.raises(ValueError, match=r"physics_dt=0\.001 s is too long for this friction") as error:
        TwoLinkArmEnv(**options)
    step = float(re.search(r"physics_dt=([0-9.e-]+) s would do", str(error.value)).group(1))
    env = started(**options, physics_dt=0.01 / round(0.01 / step), initial_velocity=10.0)
    assert not env.step((0.0, 0.0))[2]
    assert np.abs(env.truth.velocity).max() < 1.0


def test_the_creep_of_the_printed_law_is_an_effect_of_the_step_size():
    friction, creep = {"coulomb": 10.0, "stiction": 10.0, "law": "literal"}, {}
    for h in (1e-3, 1e-4):
        env = flat(friction=friction, physics_dt=h)
        first, *_, last = truths_of(env, [(15.0, 0.0)] * 20)
        creep[h] = abs(last.position - first.position)[0]
    assert 0 < creep[1e-4] < 0.2 * creep[1e-3]
