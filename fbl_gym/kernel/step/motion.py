"""The reference: its draws at the start of an episode, and its value at any step."""

import numpy as np

from fbl_gym.kernel.maths.fastmath import exp, floor, inline_njit, kernel_njit, sincos, smaller
from fbl_gym.kernel.maths.streams import TWO_PI, stream_key, uniforms
from fbl_gym.kernel.memory.layout import FILTERED_STEPS, FOURIER, MINIMUM_JERK, ONE_SINE, SAMPLES, STEPS
from fbl_gym.kernel.memory.views import pair, put

_STREAM = stream_key("reference")
_ZERO = np.uint64(0)


@kernel_njit
def reference(block, waypoints, settings, tables, lane, step):
    """Return the reference of a lane at a control step.

    Returns:
        Position of both joints [rad], then velocity [rad/s], then acceleration [rad/s^2].
    """
    kind, points = settings.reference_kind, settings.reference_points
    if kind == SAMPLES:
        index = settings.reference_table + 6 * min(step, points - 1)
        sample = tables[index : index + 6]
        return sample[0], sample[1], sample[2], sample[3], sample[4], sample[5]
    time = step * settings.control_dt
    if kind in (ONE_SINE, FOURIER):
        return _harmonics(block, waypoints, settings, tables, lane, time)
    if kind == MINIMUM_JERK:
        return _along(waypoints, lane, _profile(settings, time))
    i, j, tau = _segment(settings, time)
    to1, to2 = pair(waypoints[j], lane)
    if kind == STEPS:
        return to1, to2, 0.0, 0.0, 0.0, 0.0
    # Filtered steps: r = to + (a + c tau) exp(-w tau).
    w = block.bandwidth[lane]
    fade = exp(-w * tau)
    (a1, a2), (c1, c2) = pair(waypoints[points + 2 * i], lane), pair(waypoints[points + 2 * i + 1], lane)
    r1, r2 = (a1 + c1 * tau) * fade, (a2 + c2 * tau) * fade
    v1, v2 = c1 * fade - w * r1, c2 * fade - w * r2
    return to1 + r1, to2 + r2, v1, v2, -2.0 * w * v1 - w * w * r1, -2.0 * w * v2 - w * w * r2


@inline_njit
def _segment(settings, time):
    """Return the way-points i, j around a time, and the time since i."""
    points = settings.reference_points
    i = int(smaller(floor(time / settings.point_time + 1e-9), max(points - 2, 0)))
    return i, min(i + 1, points - 1), time - i * settings.point_time


@inline_njit
def _profile(settings, time):
    """Return the way-points around a time, and the share of the way made, its rate and its bend.

    The share is the polynomial of fifth order that begins and ends at rest.
    """
    i, j, tau = _segment(settings, time)
    move = settings.move_time
    s = smaller(tau / move, 1.0)
    share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
    rate = 30.0 * s * s * (1.0 + s * (s - 2.0)) / move
    bend = 60.0 * s * (1.0 + s * (2.0 * s - 3.0)) / (move * move)
    return i, j, share, rate, bend


@inline_njit
def _along(waypoints, lane, profile):
    """Return the reference of a lane on the way between two way-points."""
    i, j, share, rate, bend = profile
    (from1, from2), (to1, to2) = pair(waypoints[i], lane), pair(waypoints[j], lane)
    way1, way2 = to1 - from1, to2 - from2
    return from1 + share * way1, from2 + share * way2, rate * way1, rate * way2, bend * way1, bend * way2


@kernel_njit
def _harmonics(block, waypoints, settings, tables, lane, time):
    """Return a sum of sines."""
    (q1, q2), (amplitude1, amplitude2) = pair(block.reference_middle, lane), pair(block.reference_amplitude, lane)
    v1, v2, a1, a2 = 0.0, 0.0, 0.0, 0.0
    for i in range(settings.reference_points):
        w, share = (i + 1) * block.base_rate[lane], tables[settings.reference_table + i]
        size1, size2 = share * amplitude1, share * amplitude2
        sin1, cos1 = sincos(w * time + waypoints[i, 0, lane])
        sin2, cos2 = sincos(w * time + waypoints[i, 1, lane])
        q1, q2 = q1 + size1 * sin1, q2 + size2 * sin2
        v1, v2 = v1 + w * size1 * cos1, v2 + w * size2 * cos2
        a1, a2 = a1 - w * w * size1 * sin1, a2 - w * w * size2 * sin2
    return q1, q2, v1, v2, a1, a2


@inline_njit
def store_reference(block, lane, values):
    """Store the six values of `reference` as the reference of a lane."""
    put(block.reference_position, lane, values[:2])
    put(block.reference_velocity, lane, values[2:4])
    put(block.reference_acceleration, lane, values[4:])


@kernel_njit
def update_reference(block, waypoints, settings, tables, width):
    """Compute the reference of a block at its present step."""
    if settings.reference_kind == MINIMUM_JERK:  # the usual kind, in loops without branches
        others = 0
        for lane in range(width):
            others += block.step[lane] != block.step[0]
        if others == 0:  # the usual case: the lanes began together
            profile = _profile(settings, np.int64(block.step[0]) * settings.control_dt)
            for lane in range(width):
                store_reference(block, lane, _along(waypoints, lane, profile))
            return
        for lane in range(width):
            time = np.int64(block.step[lane]) * settings.control_dt
            store_reference(block, lane, _along(waypoints, lane, _profile(settings, time)))
    else:
        for lane in range(width):
            step = np.int64(block.step[lane])
            store_reference(block, lane, reference(block, waypoints, settings, tables, lane, step))


@kernel_njit
def draw_reference(block, waypoints, settings, tables, lane, seed, episode, given):
    """Set the way-points, levels or phases of a lane for a new episode, unless they are given."""
    kind, points, index = settings.reference_kind, settings.reference_points, settings.reference_table
    if kind == SAMPLES:
        return
    low, high = settings.reference_low, settings.reference_high
    for i in range(0 if given else points):
        draw1, draw2, _, _ = uniforms(seed, _STREAM, episode, np.uint64(i), _ZERO)
        if kind in (ONE_SINE, FOURIER):
            value1, value2 = TWO_PI * draw1, TWO_PI * draw2
            if not settings.reference_phases_drawn:
                value1, value2 = tables[index + points], tables[index + points + 1]
        elif index < 0:
            value1, value2 = low[0] + draw1 * (high[0] - low[0]), low[1] + draw2 * (high[1] - low[1])
        else:
            value1, value2 = tables[index + 2 * i], tables[index + 2 * i + 1]
        waypoints[i, 0, lane], waypoints[i, 1, lane] = value1, value2
    if kind == FILTERED_STEPS:
        _chain_filter(block, waypoints, settings, lane)


@kernel_njit
def _chain_filter(block, waypoints, settings, lane):
    """Compute the filter's state at the start of each segment from the end of the one before."""
    w, time, points = block.bandwidth[lane], settings.point_time, settings.reference_points
    fade = exp(-w * time)
    for joint in range(2):
        r, v = waypoints[0, joint, lane], 0.0
        for i in range(points):
            to = waypoints[min(i + 1, points - 1), joint, lane]
            a = r - to
            c = v + w * a
            waypoints[points + 2 * i, joint, lane], waypoints[points + 2 * i + 1, joint, lane] = a, c
            r = to + (a + c * time) * fade
            v = (c - w * (a + c * time)) * fade
