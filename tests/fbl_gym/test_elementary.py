"""The fast elementary functions against NumPy's, which are good to the last bit or two."""

import numpy as np
import pytest
from numba import njit

from fbl_gym import elementary

RNG = np.random.default_rng(0)


@njit
def over(x, sine, cosine, power, logarithm):
    for i in range(len(x)):
        sine[i], cosine[i] = elementary.sincos(x[i])
        power[i] = elementary.exp(x[i])
        logarithm[i] = elementary.log(abs(x[i]) + 1e-300)


def apply(x):
    x = np.asarray(x, dtype=float)
    results = tuple(np.empty_like(x) for _ in range(4))
    over(x, *results)
    return results


@pytest.mark.parametrize("reach", [1.0, 10.0, 1e3, 1e5])
def test_sine_and_cosine(reach):
    x = np.concatenate([RNG.uniform(-reach, reach, 100_000), np.arange(-64, 65) * np.pi / 4])
    sine, cosine, _, _ = apply(x)
    np.testing.assert_allclose(sine, np.sin(x), rtol=0, atol=2.3e-16)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=0, atol=2.3e-16)
    # Near their zeros, too, the relative error stays small: the reduction keeps three parts of pi/2.
    near = np.arange(-10, 11) * np.pi / 2 + RNG.uniform(-1e-6, 1e-6, 21)
    sine, cosine, _, _ = apply(near)
    np.testing.assert_allclose(sine, np.sin(near), rtol=1e-12)
    np.testing.assert_allclose(cosine, np.cos(near), rtol=1e-12)


def test_sine_and_cosine_stay_finite_for_absurd_angles():
    sine, cosine, _, _ = apply([0.0, 1e9, -1e9])
    assert np.all(np.isfinite(sine) & np.isfinite(cosine))
    assert (sine[0], cosine[0]) == (0.0, 1.0)


def test_exponential():
    x = np.concatenate([RNG.uniform(-690, 690, 100_000), RNG.uniform(-1, 1, 100_000), [0.0, -0.0]])
    np.testing.assert_allclose(apply(x)[2], np.exp(x), rtol=4.5e-16)
    assert apply([0.0])[2][0] == 1.0
    assert 0.0 < apply([-1e9])[2][0] < 1e-300


def test_logarithm():
    x = np.concatenate([10.0 ** RNG.uniform(-15, 3, 100_000), RNG.uniform(0.5, 2.0, 100_000), [1.0, 2.0**-52]])
    np.testing.assert_allclose(apply(x)[3], np.log(x + 1e-300), rtol=1e-15, atol=1e-17)
    assert apply([1.0])[3][0] == 0.0
