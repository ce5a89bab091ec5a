"""From the action to the torque on the joints: limit, delay, lag, disturbance."""

import numpy as np

from fbl_gym import settings as at
from fbl_gym.fastmath import compiled, inline, sincos
from fbl_gym.kernel.physics import load_on_joints, lumped_terms, solve_terms
from fbl_gym.settings import (
    ACTION1, ACTION2, CHATTER, D1, D2, E1, E2, EPISODE, H1, H2, LANES, PAIR, PHASE1, Q1, Q2, QUEUE, S1, S2, SEED,
    STEP, T1, T2, U1, U2, V1, V2, Y1, Y2, Y3, Y4,
)  # fmt: skip
from fbl_gym.streams import stream_key, uniforms

_STREAM = stream_key("disturbance")
_NONE = np.uint64(0)


@compiled
def command(b, x, actions, count):
    """Torque commands from actions; lanes beyond the batch keep theirs."""
    limit1, limit2 = x[at.TORQUE_LIMIT], x[at.TORQUE_LIMIT + 1]
    depth = int(x[at.QUEUE_DEPTH])
    for age in range(depth, 0, -1):
        for l in range(count):
            to = QUEUE + PAIR * age + l
            b[to], b[to + LANES] = b[to - PAIR], b[to - PAIR + LANES]
    for l in range(count):
        b[ACTION1 + l] = max(min(actions[2 * l], x[at.ACTION_LIMIT]), -x[at.ACTION_LIMIT])
        b[ACTION2 + l] = max(min(actions[2 * l + 1], x[at.ACTION_LIMIT + 1]), -x[at.ACTION_LIMIT + 1])
    mode = int(x[at.ACTION])
    for l in range(count):
        u1, u2 = b[ACTION1 + l], b[ACTION2 + l]
        if mode == at.FRACTION:
            u1, u2 = u1 * limit1, u2 * limit2
        elif mode == at.ACCELERATION:
            u1, u2 = nominal_torque(b, l, x, u1, u2)
        u1, u2 = max(min(u1, limit1), -limit1), max(min(u2, limit2), -limit2)
        b[CHATTER + l] = abs(u1 - b[U1 + l]) / limit1 + abs(u2 - b[U2 + l]) / limit2
        b[U1 + l], b[U2 + l] = u1, u2
        b[QUEUE + l], b[QUEUE + LANES + l] = u1, u2


@inline
def _nominal(x):
    """The lumped parameters of the nominal arm."""
    return lumped_terms(
        x[at.ARM_M1], x[at.ARM_M2], x[at.ARM_L1], x[at.ARM_L2], x[at.GRAVITY], x[at.CENTRE], x[at.INERTIA]
    )


@inline
def nominal_torque(b, l, x, a1, a2):
    """The nominal feedback linearisation mapping at the measured state."""
    p1, p2, p3, p4, p5 = _nominal(x)
    q1, q2, v1, v2 = b[Y1 + l], b[Y2 + l], b[Y3 + l], b[Y4 + l]
    m11, m12, m22, r1, r2 = load_on_joints(p1, p2, p3, p4, p5, q1, q2, v1, v2, 0.0, 0.0)
    return m11 * a1 + m12 * a2 - r1, m12 * a1 + m22 * a2 - r2


@inline
def nominal_acceleration(b, l, x):
    """The acceleration that the nominal model expects of the applied torque, at the true state."""
    p1, p2, p3, p4, p5 = _nominal(x)
    q1, q2, v1, v2 = b[Q1 + l], b[Q2 + l], b[V1 + l], b[V2 + l]
    m11, m12, m22, r1, r2 = load_on_joints(p1, p2, p3, p4, p5, q1, q2, v1, v2, b[T1 + l], b[T2 + l])
    return solve_terms(m11, m12, m22, r1, r2)


@inline
def pick_disturbance(clock, l, x, substep):
    """Disturbance of the kinds that are held over a physics step: piecewise-constant, pulses, the user's array."""
    kind = int(x[at.DISTURBANCE])
    now = float(np.int64(clock[STEP + l])) * x[at.SUBSTEPS] + substep
    d1, d2 = 0.0, 0.0
    if kind == at.PIECEWISE_CONSTANT:
        level = np.uint64(np.floor(now / x[at.PUSH_EVERY]))
        a, c, _, _ = uniforms(clock[SEED + l], _STREAM, clock[EPISODE + l], level, _NONE)
        d1, d2 = (2.0 * a - 1.0) * x[at.PUSH], (2.0 * c - 1.0) * x[at.PUSH + 1]
    elif kind == at.PULSES:
        since = now - x[at.PUSH_START]
        phase = since - np.floor(since / x[at.PUSH_EVERY]) * x[at.PUSH_EVERY]
        on = 1.0 if since >= 0.0 and phase < x[at.PUSH_WIDTH] else 0.0
        d1, d2 = on * x[at.PUSH], on * x[at.PUSH + 1]
    elif kind == at.ARRAY:
        row = int(min(np.floor(now / x[at.PUSH_EVERY]), x[at.PUSH_ROWS] - 1.0))
        place = int(x[at.PUSH_TABLE]) + 2 * row
        d1, d2 = x[place], x[place + 1]
    return d1, d2


@compiled
def apply_torque(b, clock, x, width, substep):
    """Applied torque less disturbance at the start, the half and the end of a physics step."""
    # The command that the delay lets through now, and the lag behind it.
    depth = int(x[at.QUEUE_DEPTH])
    age = depth if substep < x[at.QUEUE_SWITCH] or depth == 0 else depth - 1
    start, half, end = x[at.LAG_START], x[at.LAG_HALF], x[at.LAG_END]
    for l in range(width):
        u1, u2 = b[QUEUE + PAIR * age + l], b[QUEUE + PAIR * age + LANES + l]
        gap1, gap2 = b[T1 + l] - u1, b[T2 + l] - u2
        b[S1 + l], b[S2 + l] = u1 + start * gap1, u2 + start * gap2
        b[H1 + l], b[H2 + l] = u1 + half * gap1, u2 + half * gap2
        b[E1 + l], b[E2 + l] = u1 + end * gap1, u2 + end * gap2
        b[T1 + l], b[T2 + l] = b[E1 + l], b[E2 + l]
    if x[at.DISTURBANCE] == at.SINE:
        _apply_sine(b, clock, x, width, substep)
    elif x[at.DISTURBANCE] != at.NO_DISTURBANCE:
        for l in range(width):
            d1, d2 = pick_disturbance(clock, l, x, substep)
            b[D1 + l], b[D2 + l] = d1, d2
            for row in range(3):
                b[S1 + PAIR * row + l] -= d1
                b[S2 + PAIR * row + l] -= d2


@compiled
def _apply_sine(b, clock, x, width, substep):
    for half_steps in range(3):
        for joint in range(2):
            load, push = S1 + PAIR * half_steps + LANES * joint, x[at.PUSH + joint]
            rate, phase, now = x[at.PUSH_RATE + joint], PHASE1 + LANES * joint, D1 + LANES * joint
            for l in range(width):
                steps = float(np.int64(clock[STEP + l])) * x[at.SUBSTEPS] + substep + 0.5 * half_steps
                sine, _ = sincos(rate * (steps * x[at.PHYSICS_DT]) + b[phase + l])
                b[load + l] -= push * sine
                b[now + l] = push * sine
