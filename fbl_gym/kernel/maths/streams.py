"""Named, counter-based random streams.

A random number is a function of (seed, stream name, episode, step), not of the numbers drawn
before. Therefore another noise source does not shift the disturbance, and a lane of a batch draws
the same numbers as the single environment.

The generator is Philox4x64-10 (Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as
1, 2, 3", SC 2011), with key = (seed, hash of the stream's name) and counter = (step, slot, episode,
0). Its words equal those of `numpy.random.Philox` for the same key and counter; a test checks it.
"""

import hashlib

import numpy as np

from fbl_gym.kernel.maths.fastmath import inline_njit, kernel_njit, log, sincos, sqrt

_MULTIPLIER_0 = np.uint64(0xD2E7470EE14C6C93)
_MULTIPLIER_1 = np.uint64(0xCA5A826395121157)
_WEYL_0 = np.uint64(0x9E3779B97F4A7C15)
_WEYL_1 = np.uint64(0xBB67AE8584CAA73B)
_LOW_32 = np.uint64(0xFFFFFFFF)
_32 = np.uint64(32)
_12 = np.uint64(12)
_ONE_BITS = np.uint64(0x3FF0000000000000)  # 1.0 as a double
_ZERO = np.uint64(0)
TWO_PI = 6.283185307179586


def stream_key(name: str) -> np.uint64:
    """Return the 64-bit key of a stream: the first eight bytes of its name's SHA-256."""
    return np.uint64(int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big"))


@inline_njit
def _multiply(a, b):
    """Return the high and the low word of the 128-bit product of two 64-bit words."""
    a_low, a_high = a & _LOW_32, a >> _32
    b_low, b_high = b & _LOW_32, b >> _32
    low = a_low * b_low
    middle = a_high * b_low + (low >> _32)
    middle_2 = a_low * b_high + (middle & _LOW_32)
    return a_high * b_high + (middle >> _32) + (middle_2 >> _32), a * b


@inline_njit
def philox(key_0, key_1, c_0, c_1, c_2):
    """Return four random 64-bit words from a key of two words and a counter (c_0, c_1, c_2, 0)."""
    c_3 = _ZERO
    for _ in range(10):
        high_0, low_0 = _multiply(_MULTIPLIER_0, c_0)
        high_1, low_1 = _multiply(_MULTIPLIER_1, c_2)
        c_0, c_1, c_2, c_3 = high_1 ^ c_1 ^ key_0, low_1, high_0 ^ c_3 ^ key_1, low_0
        key_0 += _WEYL_0
        key_1 += _WEYL_1
    return c_0, c_1, c_2, c_3


@inline_njit
def _unit(word):
    """Return a double in [0, 1) with 52 random bits, from a word's upper bits."""
    return np.uint64((word >> _12) | _ONE_BITS).view(np.float64) - 1.0


@kernel_njit
def uniforms(seed, stream, episode, step, slot):
    """Return four independent numbers, uniform in [0, 1)."""
    a, b, c, d = philox(seed, stream, step, slot, episode)
    return _unit(a), _unit(b), _unit(c), _unit(d)


@inline_njit
def normals(seed, stream, episode, step, slot):
    """Return two independent standard normal numbers (Box and Muller 1958)."""
    a, b, _, _ = philox(seed, stream, step, slot, episode)
    radius = sqrt(-2.0 * log(1.0 - _unit(a)))
    sine, cosine = sincos(TWO_PI * _unit(b))
    return radius * cosine, radius * sine
