"""The random streams against NumPy's Philox, to the bit."""

import hashlib

import numpy as np
import pytest
from numba import njit

from fbl_gym.kernel.maths import streams

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
