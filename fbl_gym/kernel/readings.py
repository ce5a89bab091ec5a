"""What is seen of the arm: the sensors' readings, and the observation they go into."""

import numpy as np

from fbl_gym import settings as at
from fbl_gym.fastmath import compiled, inline
from fbl_gym.kernel.motion import reference
from fbl_gym.kernel.physics import acceleration_and_friction
from fbl_gym.settings import (
    A1, A2, EPISODE, LANES, Q1, SEED, STEP, Y1, Y2, Y3, Y4, Y5, Y6,
)  # fmt: skip
from fbl_gym.streams import normals, stream_key

_STREAMS = (stream_key("position noise"), stream_key("velocity noise"), stream_key("acceleration noise"))
_NONE = np.uint64(0)


@inline
def _within(value, bound):
    """`value` cut to [-bound, bound]; NaN becomes -bound."""
    value = value if value > -bound else -bound
    return value if value < bound else bound


@compiled
def sense(b, clock, x, width):
    """The readings of a block. They depend on its state alone: taken twice, they are the same."""
    if x[at.SENSES_ACCELERATION] != 0.0:
        friction = int(x[at.FRICTION])
        if friction == at.NO_FRICTION:
            for l in range(width):
                b[A1 + l], b[A2 + l], _, _ = acceleration_and_friction(b, l, x, at.NO_FRICTION)
        elif friction == at.EXACT_FRICTION:
            for l in range(width):
                b[A1 + l], b[A2 + l], _, _ = acceleration_and_friction(b, l, x, at.EXACT_FRICTION)
        else:
            for l in range(width):
                b[A1 + l], b[A2 + l], _, _ = acceleration_and_friction(b, l, x, at.LITERAL_FRICTION)
    for row in range(6):
        for l in range(width):
            b[Y1 + LANES * row + l] = b[Q1 + LANES * row + l]
    if x[at.NOISY] != 0.0:
        for sensor in range(3):
            _disturb_reading(b, clock, x, width, 2 * sensor, _STREAMS[sensor])
    # A sensor reads no further than its range.
    position, velocity, acceleration = 2.0 * x[at.MAX_POSITION], 2.0 * x[at.MAX_VELOCITY], x[at.MAX_ACCELERATION]
    for l in range(width):
        b[Y1 + l] = _within(b[Y1 + l], position)
        b[Y2 + l] = _within(b[Y2 + l], position)
        b[Y3 + l] = _within(b[Y3 + l], velocity)
        b[Y4 + l] = _within(b[Y4 + l], velocity)
        b[Y5 + l] = _within(b[Y5 + l], acceleration)
        b[Y6 + l] = _within(b[Y6 + l], acceleration)


@compiled
def _disturb_reading(b, clock, x, width, sensor, stream):
    """Bias, noise and quantization of one sensor's two joints."""
    y1, y2 = Y1 + LANES * sensor, Y2 + LANES * sensor
    sigma1, sigma2 = x[at.SIGMA + sensor], x[at.SIGMA + sensor + 1]
    bias1, bias2 = x[at.BIAS + sensor], x[at.BIAS + sensor + 1]
    if sigma1 != 0.0 or sigma2 != 0.0:
        for l in range(width):
            a, c = normals(clock[SEED + l], stream, clock[EPISODE + l], clock[STEP + l], _NONE)
            b[y1 + l] += sigma1 * a
            b[y2 + l] += sigma2 * c
    for l in range(width):
        b[y1 + l] += bias1
        b[y2 + l] += bias2
    for joint in range(2):
        quantum, y = x[at.QUANTUM + sensor + joint], y1 + joint * LANES
        if quantum > 0.0:
            for l in range(width):
                b[y + l] = np.floor(b[y + l] / quantum + 0.5) * quantum


@compiled
def observe(b, clock, x, out, first, last):
    """The observations of a block's lanes from `first` up to `last`, into `out`, which begins with that of the first lane."""
    size, observed = int(x[at.SIZE]), int(x[at.OBSERVED])
    for column in range(observed):
        row, bound = int(x[at.OBSERVED_ROW + column]), x[at.OBSERVED_BOUND + column]
        for l in range(first, last):
            out[l * size + column] = _within(b[row + l], bound)
    position, velocity, acceleration = 2.0 * x[at.MAX_POSITION], 2.0 * x[at.MAX_VELOCITY], x[at.MAX_ACCELERATION]
    for ahead in range(int(x[at.PREVIEW])):
        for l in range(first, last):
            r1, r2, r3, r4, r5, r6 = reference(b, l, x, np.int64(clock[STEP + l]) + ahead + 1)
            n = l * size + observed + 6 * ahead
            out[n], out[n + 1] = _within(r1, position), _within(r2, position)
            out[n + 2], out[n + 3] = _within(r3, velocity), _within(r4, velocity)
            out[n + 4], out[n + 5] = _within(r5, acceleration), _within(r6, acceleration)
