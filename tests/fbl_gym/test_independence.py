"""Options are independent: one does not change the random numbers of another."""

import numpy as np
import pytest

from fbl_gym import TwoLinkArmVectorEnv
from tests.fbl_gym.paired_runs import play, same, torques

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


@pytest.mark.parametrize(
    "change",
    [
        {"reference": {"kind": "fourier"}}, {"reference": {"kind": "steps", "period": 0.3}},
        {"reference": {"kind": "minimum-jerk", "low": 0.0, "high": 1.0}}, {"initial_error": (0.2, -0.1)},
        {"friction": None}, {"arm": {"gravity": 0.0}},
    ],
    ids=str,
)  # fmt: skip
def test_another_task_has_the_same_random_numbers(change):
    ours, theirs = play(**{**CROWDED, **change}), play(**CROWDED)
    np.testing.assert_allclose(readings(*ours), readings(*theirs), atol=1e-11)
    assert same(ours[2][1:], theirs[2][1:], *UNRELATED)
    assert not same(ours[2][5:], theirs[2][5:], "position", "reference")


@pytest.mark.parametrize(
    "change",
    [
        {"reward": {"tracking": "l1", "weight_effort": 3.0}}, {"preview": 4}, {"duration": 4.0},
        {"limits": {"position": 50.0, "velocity": 200.0, "command": 5.0}},
        {"name": "another", "description": "of the same"},
    ],
    ids=str,
)  # fmt: skip
def test_options_outside_the_arm_do_not_move_it(change):
    """All readings and the whole truth are the same to the bit."""
    options = {"action": "torque", "limits": {"position": 100.0}, **CROWDED}
    one, two = TwoLinkArmVectorEnv(20, **{**options, **change}), TwoLinkArmVectorEnv(20, **options)
    a, b = one.reset(seed=0)[0], two.reset(seed=0)[0]
    for k in range(60):
        np.testing.assert_array_equal(a[:, :12], b[:, :12])
        for name, value in vars(two.truth).items():
            np.testing.assert_array_equal(getattr(one.truth, name), value, err_msg=name)
        a, b = one.step(torques(k, 20))[0], two.step(torques(k, 20))[0]
