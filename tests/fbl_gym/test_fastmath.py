"""The fast elementary functions against NumPy's, and the random streams against NumPy's Philox, to the bit."""

import hashlib

import numpy as np
import pytest
from numba import njit

from fbl_gym.kernel.maths import fastmath, streams

RNG = np.random.default_rng(0)


@njit
def over(x, sine, cosine, power, logarithm):
    for i in range(len(x)):
        sine[i], cosine[i] = fastmath.sincos(x[i])
        power[i] = fastmath.exp(x[i])
        logarithm[i] = fastmath.log(abs(x[i]) + 1e-300)


def apply(x):
    x = np.asarray(x, dtype=float)
    results = tuple(np.empty_like(x) for _ in range(4))
    over(x, *results)
    return results


@pytest.mark.parametrize("reach", [1.0, 10.0, 1e3, 1e5, 1e14])
def test_sine_and_cosine_are_accurate(reach):
    x = np.concatenate([RNG.uniform(-reach, reach, 100_000), np.arange(-64, 65) * np.pi / 4, [-0.0]])
    sine, cosine, _, _ = apply(x)
    np.testing.assert_allclose(sine, np.sin(x), rtol=0, atol=2.3e-16)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=0, atol=2.3e-16)
    assert (sine[-1], cosine[-1]) == (0.0, 1.0)


@pytest.mark.parametrize("last", [64, 4000, 120_000])
def test_sine_and_cosine_are_accurate_between_quadrants(last):
    """At multiples of pi/4 and their neighbours, the error is a few ulp, and 1e-12 relative near a zero.

    There the remainder of pi/2 beyond two doubles, 1.5e-33, counts once for each subtraction.
    """
    edges = np.arange(-last, last + 1) * np.pi / 4
    x = np.concatenate([edges, np.nextafter(edges, np.inf), np.nextafter(edges, -np.inf)])
    sine, cosine, _, _ = apply(x)
    for computed, truth in ((sine, np.sin(x)), (cosine, np.cos(x))):
        np.testing.assert_allclose(computed, truth, rtol=6e-16, atol=1.5e-33 * (last / 2 + 1))
        np.testing.assert_allclose(computed, truth, rtol=1e-12)


def test_sine_is_odd_and_cosine_even_to_the_bit():
    """Therefore the arm and its mirror image move alike."""
    x = RNG.uniform(0, 100, 100_000)
    sine, cosine, _, _ = apply(x)
    mirrored = apply(-x)
    assert np.array_equal(mirrored[0], -sine)
    assert np.array_equal(mirrored[1], cosine)


def test_the_exponential_is_accurate():
    """NumPy's error is part of the 4.5e-16."""
    x = np.concatenate([RNG.uniform(-700, 700, 100_000), RNG.uniform(-1, 1, 100_000), [0.0, -0.0, 700.0, -700.0]])
    np.testing.assert_allclose(apply(x)[2], np.exp(x), rtol=4.5e-16)
    assert apply([0.0])[2][0] == 1.0


def test_extreme_exponents_are_clipped():
    """No overflow, no zero, no warning: e**700 above, e**-700 below."""
    above, below = apply([700.1, 1e9, 1e300, np.inf])[2], apply([-700.1, -1e9, -1e300, -np.inf])[2]
    np.testing.assert_allclose(above, np.exp(700.0), rtol=4.5e-16)
    np.testing.assert_allclose(below, np.exp(-700.0), rtol=4.5e-16)


def test_the_logarithm_is_accurate():
    """Also close to 1, the logarithm's zero."""
    near = 1.0 + RNG.uniform(-1, 1, 100_000) * 10.0 ** RNG.uniform(-15, -1, 100_000)
    far = 10.0 ** RNG.uniform(-15, 3, 100_000)
    x = np.concatenate([far, near, RNG.uniform(0.5, 2.0, 100_000), [2.0**-52, 1e-290, 1e300]])
    np.testing.assert_allclose(apply(x)[3], np.log(x + 1e-300), rtol=6e-16)
    assert apply([1.0])[3][0] == 0.0
    assert np.array_equal(apply(2.0 ** np.arange(-50, 50))[3], np.log(2.0 ** np.arange(-50, 50)))


# Random streams.


# The package's functions are compiled for compiled callers alone.
philox, uniforms, normals = (njit(f.py_func) for f in (streams.philox, streams.uniforms, streams.normals))

U = np.uint64
WORD = 2**64
LAST = WORD - 1


def numpys_words(k0, k1, c0, c1, c2):
    """Return the words of NumPy's Philox; it increments its counter before it draws."""
    counter = (c0 + (c1 << 64) + (c2 << 128) - 1) % 2**256
    return [int(w) for w in np.random.Philox(key=k0 + (k1 << 64), counter=counter).random_raw(4)]


@pytest.mark.parametrize("case", [
    (0, 0, 0, 0, 0), (0, 0, 1, 0, 0), (5, 7, LAST, 0, 0), (5, 7, LAST, LAST, 3), (LAST, 0, 0, 0, 0), (0, LAST, 0, 0, 0),
    (5, 7, 0, 1, 0), (5, 7, 0, 0, 1),  # NumPy's carries from the first word to the second, and on to the third
    (LAST, LAST, LAST, LAST, LAST),
    *np.random.default_rng(0).integers(0, WORD, (300, 5), dtype=np.uint64).tolist(),
], ids=str)  # fmt: skip
def test_words_are_those_of_numpys_philox(case):
    """Also where counters, keys and round keys wrap around."""
    assert [int(word) for word in philox(*map(U, case))] == numpys_words(*case)


def test_a_streams_key_is_the_start_of_its_names_hash():
    for name in ("position noise", "velocity noise"):
        assert int(streams.stream_key(name)) == int(hashlib.sha256(name.encode()).hexdigest()[:16], 16)


def test_uniforms_are_the_words_upper_bits():
    """52 bits, which excludes 1; four numbers from one block."""
    key = streams.stream_key("a")
    words = numpys_words(1, int(key), 3, 4, 2)
    drawn = uniforms(U(1), key, U(2), U(3), U(4))
    assert list(drawn) == [(w >> 12) / 2**52 for w in words]
    assert max((LAST >> 12) / 2**52, *drawn) < 1.0


def test_normals_are_box_and_mullers():
    words = numpys_words(1, int(streams.stream_key("a")), 3, 4, 2)
    u, angle = (words[0] >> 12) / 2**52, 2 * np.pi * (words[1] >> 12) / 2**52
    radius = np.sqrt(-2 * np.log1p(-u))
    drawn = normals(U(1), streams.stream_key("a"), U(2), U(3), U(4))
    np.testing.assert_allclose(drawn, [radius * np.cos(angle), radius * np.sin(angle)], rtol=1e-13)
