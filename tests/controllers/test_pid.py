"""The paper's PID against its linear error equation and the roots of its printed gains."""

import numpy as np
import pytest

import controllers
from fbl_gym import SECTION_2_2, TABLE_1, TwoLinkArmEnv
from tests.controllers.closed_loop import tracking
from tests.controllers.linear import response

STILL = {"kind": "minimum-jerk", "points": ((-1.0, 0.5),)}
FAST = {"control_dt": 1e-3, "physics_dt": 1e-3}


def pid_deviation(arm, pose, start, dt):
    """Largest distance of pid-flm's error from e'' + 3 e' + 10 e = 0 over 4 s, as a share of its amplitude, per joint."""
    reference = {"kind": "minimum-jerk", "points": (pose,)}
    env = TwoLinkArmEnv(
        arm=arm, actuator=None, action="torque", reference=reference, initial_error=start, control_dt=dt, physics_dt=dt
    )
    steps = round(4.0 / dt)
    errors = tracking(controllers.make("pid-flm", env), env, steps)[0]
    expected = [response([[0, 1], [-10, -3]], [-x, 0.0], dt, steps) for x in start]
    return np.abs(errors - np.transpose(expected)).max(axis=0) / np.abs(start).max()


@pytest.mark.parametrize("arm", [TABLE_1, SECTION_2_2], ids=["table-1", "section-2-2"])
def test_pid_error_obeys_its_linear_equation(arm):
    """Exact model, no noise, 1 kHz: e'' + 3 e' + 10 e = 0 within 1e-3 of its amplitude, for both joints."""
    assert pid_deviation(arm, (0.0, 0.0), (-0.2, 0.2), 1e-3).max() < 1e-3


def test_pid_deviation_halves_with_the_sampling_interval():
    """Hanging, Table 1's gravity changes while the torque is held, and the deviation is 2.4e-3; it halves with the interval."""
    coarse = pid_deviation(TABLE_1, (-1.0, 0.5), (-0.2, 0.2), 1e-3)
    fine = pid_deviation(TABLE_1, (-1.0, 0.5), (-0.2, 0.2), 5e-4)
    assert coarse.max() < 3e-3
    np.testing.assert_allclose(fine / coarse, 0.5, atol=0.02)


def test_the_printed_gains_are_unstable():
    """P, I, D = 10, 3, 0 as printed: the error grows as exp(0.149 t), the roots of s^3 + 10 s + 3."""
    env = TwoLinkArmEnv(
        actuator=None, action="torque", reference=STILL, initial_error=(0.01, 0.0), duration=10.0, **FAST
    )
    errors = tracking(controllers.make("pid-flm", env, kp=10, ki=3, kd=0), env, 9999)[0][:, 0]
    roots = np.roots([1, 0, 10, 3])
    growth = roots.real.max()
    assert growth == pytest.approx(0.149, abs=1e-3)
    early, late = np.abs(errors[2000:4000]).max(), np.abs(errors[7000:9000]).max()
    assert late > 2 * early
    assert np.log(late / early) / 5.0 == pytest.approx(growth, rel=0.1)
