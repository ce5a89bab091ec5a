"""The reference: what is drawn of it when an episode starts, and its value at any step."""

import numpy as np

from fbl_gym import settings as at
from fbl_gym.fastmath import compiled, exp, inline, sincos
from fbl_gym.settings import LANES, PAIR, R1, R2, R3, R4, R5, R6, STEP
from fbl_gym.streams import stream_key, uniforms

_STREAM = stream_key("reference")
_NONE = np.uint64(0)


@compiled
def reference(b, l, x, step):
    """The reference of a lane at a control step: position, velocity and acceleration of both joints."""
    kind, row, points = int(x[at.REFERENCE]), int(x[at.REFERENCE_ROW]), int(x[at.POINTS])
    place = int(x[at.POINT_TABLE])
    if kind == at.REFERENCE_TABLE:
        place += 6 * min(step, points - 1)
        return x[place], x[place + 1], x[place + 2], x[place + 3], x[place + 4], x[place + 5]
    t = step * x[at.CONTROL_DT]
    if kind == at.HARMONICS:
        return _harmonics(b, l, x, row, points, place, t)
    if kind == at.MINIMUM_JERK:
        return _minimum_jerk(b, l, x, row, points, t)
    i, j, tau = _segment(x, points, t)
    to1, to2 = b[row + PAIR * j + l], b[row + PAIR * j + LANES + l]
    if kind == at.STEPS:
        return to1, to2, 0.0, 0.0, 0.0, 0.0
    # Filtered steps: r = to + (a + c tau) exp(-w tau).
    w = x[at.BANDWIDTH]
    fade = exp(-w * tau)
    own = row + PAIR * (points + 2 * i) + l
    a1, a2, c1, c2 = b[own], b[own + LANES], b[own + PAIR], b[own + PAIR + LANES]
    r1, r2 = (a1 + c1 * tau) * fade, (a2 + c2 * tau) * fade
    v1, v2 = c1 * fade - w * r1, c2 * fade - w * r2
    return to1 + r1, to2 + r2, v1, v2, -2.0 * w * v1 - w * w * r1, -2.0 * w * v2 - w * w * r2


@inline
def _segment(x, points, t):
    """Way-points (or levels) i and j between which time t lies, and the time since i; the last segment goes on for ever."""
    i = int(min(np.floor(t / x[at.POINT_TIME] + 1e-9), max(points - 2, 0)))
    return i, min(i + 1, points - 1), t - i * x[at.POINT_TIME]


@inline
def _minimum_jerk(b, l, x, row, points, t):
    i, j, tau = _segment(x, points, t)
    from1, from2 = b[row + PAIR * i + l], b[row + PAIR * i + LANES + l]
    d1, d2 = b[row + PAIR * j + l] - from1, b[row + PAIR * j + LANES + l] - from2
    move = x[at.MOVE_TIME]
    s = min(tau / move, 1.0)
    share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    rate = 30.0 * s * s * (1.0 + s * (s - 2.0)) / move
    bend = 60.0 * s * (1.0 + s * (2.0 * s - 3.0)) / (move * move)
    return from1 + share * d1, from2 + share * d2, rate * d1, rate * d2, bend * d1, bend * d2


@compiled
def _harmonics(b, l, x, row, points, place, t):
    q1, q2, v1, v2, a1, a2 = x[at.MIDDLE], x[at.MIDDLE + 1], 0.0, 0.0, 0.0, 0.0
    for i in range(points):
        w = (i + 1) * x[at.BASE_RATE]
        size1, size2 = x[place + 2 * i], x[place + 2 * i + 1]
        s1, c1 = sincos(w * t + b[row + PAIR * i + l])
        s2, c2 = sincos(w * t + b[row + PAIR * i + LANES + l])
        q1, q2 = q1 + size1 * s1, q2 + size2 * s2
        v1, v2 = v1 + w * size1 * c1, v2 + w * size2 * c2
        a1, a2 = a1 - w * w * size1 * s1, a2 - w * w * size2 * s2
    return q1, q2, v1, v2, a1, a2


@inline
def _note(b, l, r):
    """Keep the reference of a lane."""
    b[R1 + l], b[R2 + l], b[R3 + l] = r[0], r[1], r[2]
    b[R4 + l], b[R5 + l], b[R6 + l] = r[3], r[4], r[5]


@compiled
def refer(b, clock, x, width):
    """The reference of a block, now."""
    if x[at.REFERENCE] == at.MINIMUM_JERK:  # the usual one, without branches
        row, points = int(x[at.REFERENCE_ROW]), int(x[at.POINTS])
        for l in range(width):
            _note(b, l, _minimum_jerk(b, l, x, row, points, np.int64(clock[STEP + l]) * x[at.CONTROL_DT]))
    else:
        for l in range(width):
            _note(b, l, reference(b, l, x, np.int64(clock[STEP + l])))


@compiled
def draw_reference(b, l, x, seed, episode):
    """Way-points, levels or phases of a lane."""
    kind, row, points, place = int(x[at.REFERENCE]), int(x[at.REFERENCE_ROW]), int(x[at.POINTS]), int(x[at.POINT_TABLE])
    if kind == at.REFERENCE_TABLE:
        return
    for i in range(points):
        a, c, _, _ = uniforms(seed, _STREAM, episode, np.uint64(i), _NONE)
        if kind == at.HARMONICS:
            value1, value2 = 6.283185307179586 * a, 6.283185307179586 * c
            if x[at.PHASES_DRAWN] == 0.0:
                value1, value2 = x[place + 2 * points], x[place + 2 * points + 1]
        elif place < 0:
            value1 = x[at.LOW] + a * (x[at.HIGH] - x[at.LOW])
            value2 = x[at.LOW + 1] + c * (x[at.HIGH + 1] - x[at.LOW + 1])
        else:
            value1, value2 = x[place + 2 * i], x[place + 2 * i + 1]
        b[row + PAIR * i + l], b[row + PAIR * i + LANES + l] = value1, value2
    if kind == at.FILTERED_STEPS:
        _chain_filter(b, l, x, row, points)


@compiled
def _chain_filter(b, l, x, row, points):
    """The state of the reference's filter at the start of each segment, from the end of the one before."""
    w, time = x[at.BANDWIDTH], x[at.POINT_TIME]
    fade = exp(-w * time)
    for joint in range(2):
        own = row + LANES * joint + l
        r, v = b[own], 0.0
        for i in range(points):
            to = b[own + PAIR * min(i + 1, points - 1)]
            a = r - to
            c = v + w * a
            b[own + PAIR * (points + 2 * i)], b[own + PAIR * (points + 2 * i + 1)] = a, c
            r = to + (a + c * time) * fade
            v = (c - w * (a + c * time)) * fade
