"""Spong's law against its Lyapunov function."""

import numpy as np

from fbl_gym.model.arm import inertia_matrix
from tests.controllers.passive_loop import closed_loop, wrong


def test_spongs_lyapunov_function_decreases_outside_the_layer():
    """V = s'Ms/2 falls by more than its damping where every parameter is within its bound, down to a set that shrinks with
    epsilon."""
    left = {}
    for epsilon in (0.1, 10.0):
        policy, p, (_, s, q, _) = closed_loop("spong-robust", wrong(0.25), damping=20.0, bound=1.0, epsilon=epsilon)
        nominal = policy.interface.nominal.lumped
        assert np.all(np.abs(p / nominal - 1) < policy.bound)
        v = 0.5 * np.einsum("tni,tnij,tnj->tn", s, inertia_matrix(p, q), s)
        # Each of the five parameters adds at most bound * epsilon p1 / 4 to V'; beyond that, V must fall.
        layer = 5 * policy.bound * epsilon * nominal[0] / 4
        gain = policy.damping * inertia_matrix(nominal, q)
        outside = np.einsum("tni,tnij,tnj->tn", s, gain, s)[:-1] > 1.5 * layer
        assert outside.any()
        assert np.diff(v, axis=0)[outside].max() < 0.0
        left[epsilon] = np.median(v[-1000:])
    assert left[0.1] < 0.3 * left[10.0]
