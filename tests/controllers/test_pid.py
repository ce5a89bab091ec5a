"""The paper's PID against its linear error equation and the roots of its printed gains."""

import numpy as np
import pytest

import controllers
from fbl_gym import SECTION_2_2, TABLE_1, TwoLinkArmEnv
from tests.controllers.closed_loop import EXACT, response, tracking


@pytest.mark.parametrize("arm", [TABLE_1, SECTION_2_2], ids=["table-1", "section-2-2"])
def test_pid_error_obeys_its_linear_equation(arm):
    """Exact model, no noise, 1 kHz: e'' + 3 e' + 10 e = 0 within 1e-3 of its amplitude, for both joints."""
    reference = {"kind": "minimum-jerk", "points": ((0.0, 0.0),)}
    env = TwoLinkArmEnv(arm=arm, **EXACT | {"reference": reference}, initial_error=(-0.2, 0.2))
    errors = tracking(controllers.make("pid-flm", env), env, 4000)[0]
    expected = [response([[0, 1], [-10, -3]], [x, 0.0], 1e-3, 4000) for x in (0.2, -0.2)]
    assert np.abs(errors - np.transpose(expected)).max() < 1e-3 * 0.2


def test_the_printed_gains_are_unstable():
    """P, I, D = 10, 3, 0 as printed: the error grows as exp(0.149 t), the roots of s^3 + 10 s + 3."""
    env = TwoLinkArmEnv(**EXACT, initial_error=(0.01, 0.0), duration=10.0)
    errors = tracking(controllers.make("pid-flm", env, kp=10, ki=3, kd=0), env, 9999)[0][:, 0]
    roots = np.roots([1, 0, 10, 3])
    growth = roots.real.max()
    assert growth == pytest.approx(0.149, abs=1e-3)
    early, late = np.abs(errors[2000:4000]).max(), np.abs(errors[7000:9000]).max()
    assert late > 2 * early
    assert np.log(late / early) / 5.0 == pytest.approx(growth, rel=0.1)
