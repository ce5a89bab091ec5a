"""The random streams against NumPy's Philox, and against the distributions they promise."""

import hashlib

import numpy as np
import pytest
from numba import njit
from scipy import stats

from fbl_gym import streams

U = np.uint64
WORD = 2**64


@pytest.mark.parametrize("case", range(20))
def test_words_are_those_of_numpys_philox(case):
    """NumPy counts up before it draws, so its block for counter c + 1 comes first when it is set to c."""
    rng = np.random.default_rng(case)
    k0, k1, c0, c1, c2 = (int(x) for x in rng.integers(0, WORD, 5, dtype=np.uint64))
    if case == 0:
        k0, k1, c0, c1, c2 = 0, 0, 1, 0, 0
    if case == 1:
        k0, k1, c0, c1, c2 = WORD - 1, WORD - 1, WORD - 1, WORD - 1, WORD - 1
    words = streams.philox(U(k0), U(k1), U(c0), U(c1), U(c2))
    counter = (c0 + (c1 << 64) + (c2 << 128) - 1) % 2**256
    numpys = np.random.Philox(key=k0 + (k1 << 64), counter=counter).random_raw(4)
    assert [int(w) for w in words] == [int(w) for w in numpys]


def test_a_streams_key_is_the_start_of_its_names_hash():
    digest = hashlib.sha256(b"position noise").hexdigest()
    assert int(streams.stream_key("position noise")) == int(digest[:16], 16)
    assert streams.stream_key("position noise") != streams.stream_key("velocity noise")


@njit
def draw(seed, stream, uniform, normal):
    for i in range(len(uniform)):
        uniform[i] = streams.uniforms(seed, stream, U(0), U(i), U(0))
        normal[i] = streams.normals(seed, stream, U(0), U(i), U(1))


def test_distributions():
    uniform, normal = np.empty((200_000, 4)), np.empty((200_000, 2))
    draw(U(3), streams.stream_key("test"), uniform, normal)
    assert uniform.min() >= 0.0
    assert uniform.max() < 1.0
    for column in uniform.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    for column in normal.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(np.c_[uniform, normal].T) - np.eye(6)).max() < 0.01
    assert abs(np.corrcoef(normal[1:, 0], normal[:-1, 0])[0, 1]) < 0.01
    assert np.all(np.isfinite(normal))


def test_each_coordinate_of_a_number_matters():
    key = streams.stream_key("a")
    base = streams.uniforms(U(1), key, U(2), U(3), U(4))
    others = [
        streams.uniforms(U(9), key, U(2), U(3), U(4)),
        streams.uniforms(U(1), streams.stream_key("b"), U(2), U(3), U(4)),
        streams.uniforms(U(1), key, U(9), U(3), U(4)),
        streams.uniforms(U(1), key, U(2), U(9), U(4)),
        streams.uniforms(U(1), key, U(2), U(3), U(9)),
    ]
    assert all(not set(base) & set(other) for other in others)
    assert base == streams.uniforms(U(1), key, U(2), U(3), U(4))
