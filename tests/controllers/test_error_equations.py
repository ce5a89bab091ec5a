"""Laws on an exact arm at 1 kHz against the linear equations of their errors."""

import numpy as np
import pytest

import controllers
from fbl_gym import SECTION_2_2, TABLE_1, TwoLinkArmEnv
from fbl_gym.model.arm import inertia_matrix
from tests.controllers.closed_loop import EXACT, FAST, loaded, response, tracking

ZERO = {"reference": {"kind": "minimum-jerk", "points": ((0.0, 0.0),)}}
HANGING = {"reference": {"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.4),)}}


@pytest.mark.parametrize(
    ("law", "gains", "options", "sizes", "first", "rates", "tolerance"),
    [
        # w = Kp e + e' has w' = -P w - I int(w)
        ("cascade-flm", {}, {}, (0.2, 0.0), [1, 0, 0], [[0, 1, 0], [-300, -30, -13], [10, 1, 0]], 6e-3),
        # e'' + D e' + P e + I int(e) = 0; P, I, D = 10, 3, 0 as printed is unstable: it grows as exp(0.149 t)
        *[
            (
                "pid-flm", {"kp": p, "ki": i, "kd": d}, {"arm": arm, **ZERO}, (0.2, -0.2), [1, 0, 0],
                [[0, 1, 0], [-p, -d, -i], [1, 0, 0]], 1e-3 if d else 2e-2,
            )
            for arm, (p, i, d) in ((TABLE_1, (10, 0, 3)), (SECTION_2_2, (10, 0, 3)), (TABLE_1, (10, 3, 0)))
        ],
        # e'' + 2 w e' + w^2 e = 0
        ("computed-torque", {"frequency": 8.0}, HANGING, (0.05, -0.05), [1, 0], [[0, 1], [-64, -16]], 5e-3),
        ("computed-torque-eso", {"controller_bandwidth": 5.0}, {}, (0.2, 0.0), [1, 0], [[0, 1], [-25, -10]], 5e-3),
        # e' = s - slope e, s' = -1.5 (bound / layer)^1/2 s - z, z' = 1.1 bound / layer s
        (
            "sliding-mode", {"slope": 10.0, "bound": 50.0, "layer": 0.5}, HANGING, (0.02, 0.0), [1, 10, 0],
            [[-10, 1, 0], [0, -15, -1], [0, 110, 0]], 0.02,
        ),
    ],
)  # fmt: skip
def test_the_error_obeys_its_linear_equation(law, gains, options, sizes, first, rates, tolerance):
    """Its states begin in `first`, times the first error of each joint [rad]."""
    env = TwoLinkArmEnv(**EXACT | options, initial_error=tuple(-np.array(sizes)))
    errors, _ = tracking(controllers.make(law, env, **gains), env, 2000)
    expected = np.outer(response(rates, np.array(first, dtype=float), 1e-3, 2000), sizes)
    assert np.abs(errors - expected).max() < tolerance * max(sizes)


def share_of(pole):
    return pole * 1e-3 / np.expm1(pole * 1e-3)


@pytest.mark.parametrize(
    ("law", "gains", "rates"),
    [
        # e'' + 2 w e' + w^2 e = x, x' = -g x, what is left of M^-1 d to find
        ("computed-torque-tde", {}, [[0, 1, 0], [-64, -16, 1], [0, 0, -12]]),
        # e'' + 2 w e' + w^2 e = f - z, z' = g (k f - z), k = p dt / (exp(p dt) - 1)
        *[
            ("l1-adaptive", {"pole": p}, [[0, 1, 0, 0], [-64, -16, -1, 1], [0, 0, -12, 12 * share_of(p)], [0, 0, 0, 0]])
            for p in (5.0, 200.0)
        ],
    ],
)
def test_the_error_under_a_constant_load_obeys_its_linear_equation(law, gains, rates):
    """The last state begins in M^-1 d."""
    load = np.array([20.0, 6.0])
    env = TwoLinkArmEnv(**FAST | loaded(*load))
    errors, states = tracking(controllers.make(law, env, frequency=8.0, bandwidth=12.0, **gains), env, 2000)
    push = np.linalg.solve(inertia_matrix(TABLE_1, (-1.0, 0.5)), load)
    expected = np.outer(response(rates, np.eye(len(rates))[-1], 1e-3, 2000), push)
    assert np.abs(errors - expected).max() < 0.03 * np.abs(expected).max()
    if law == "l1-adaptive":
        np.testing.assert_allclose(states[-1][1][0], -share_of(gains["pole"]) * push, rtol=0.01)
    else:
        assert np.abs(errors[-1]).max() < 1e-5
