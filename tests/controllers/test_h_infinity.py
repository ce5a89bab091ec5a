"""The robust controller by the norm that it minimises, over frequencies; the law by its linear loop and its integral."""

import numpy as np
import pytest

import controllers
from controllers.laws.h_infinity import INTEGRAL, SLACK, robust_controller
from fbl_gym import TwoLinkArmEnv
from tests.controllers.closed_loop import EXACT, tracking


def shaped(s, dead):
    """The shaped plant with the delay's approximation of second order, (12 - 6 x + x^2) / (12 + 6 x + x^2)."""
    x = dead * s
    return (s + INTEGRAL) / s**3 * (12 - 6 * x + x**2) / (12 + 6 * x + x**2)


def norms(dead):
    """The largest singular value of [K; 1] (1 - G K)^-1 [G, 1] over frequencies, and gamma."""
    a, b, c, gamma = robust_controller(dead)
    s = 1j * np.geomspace(1e-4, 1e4, 20001)
    k = np.array([(c @ np.linalg.solve(each * np.eye(5) - a, b))[0, 0] for each in s])
    g = shaped(s, dead)
    return np.max(np.sqrt((1 + abs(k) ** 2) * (1 + abs(g) ** 2)) / abs(1 - g * k)), gamma


@pytest.mark.parametrize("dead", [0.05, 0.3, 1.0, 2.0])
def test_gamma_is_the_norm_of_the_loop(dead):
    """The norm lies between the least gamma that any controller reaches and the one that was asked for."""
    norm, gamma = norms(dead)
    assert gamma / SLACK <= norm * (1 + 1e-6)
    assert norm <= gamma * (1 + 1e-6)


def test_the_loop_has_the_poles_of_the_design():
    """Exact model at 1 kHz, a small error, so that Coriolis torques vanish: the loop of plant and controller."""
    dt, w = 1e-3, 8.0
    env = TwoLinkArmEnv(**EXACT, initial_error=(-1e-3, 0.0))
    policy = controllers.make("h-infinity", env, bandwidth=w)
    errors = tracking(policy, env, 2999)[0]
    a, b, c, _ = robust_controller(0.05)
    # x = (integral of u, e, e', controller), time in 1/w; e'' = -(u + INTEGRAL integral), u = -c x
    loop = np.zeros((8, 8))
    loop[0, 3:] = -c[0]
    loop[1, 2] = 1.0
    loop[2, 0], loop[2, 3:] = -INTEGRAL, c[0]
    loop[3:, 1], loop[3:, 3:] = b[:, 0], a
    x, expected = np.zeros(8), []
    x[1] = 1e-3
    values, vectors = np.linalg.eig(loop)
    amplitude = np.linalg.solve(vectors, x)
    for k in range(3000):
        expected.append((vectors[1] * np.exp(values * w * dt * k) @ amplitude).real)
    assert np.abs(errors - np.transpose([expected, np.zeros(3000)])).max() < 0.02 * 1e-3


def test_a_bandwidth_beyond_the_dead_time_keeps_its_numbers_finite():
    env = TwoLinkArmEnv("servo-nominal")
    _, states = tracking(controllers.make("h-infinity", env, bandwidth=400.0), env, 500)
    assert np.abs(states[-1].memory).max() < 1e3
