"""One control interval, for one arm and for a batch: the only place where time advances.

A batch is worked on in blocks of `LANES` lanes. Within a block each phase is a loop over lanes without branches, which the
compiler turns into vector instructions; a lane's arithmetic is the same whatever the batch, so that lane i of any
batch is bit for bit the single environment. `settings.py` says where each number lies.

    command     action -> torque command, within the limit
    physics     `substeps` times: actuator, disturbance, payload, friction, Runge-Kutta
    sense       acceleration, noise, quantization
    reference   the motion asked for, now
    judge       reward, divergence, end of the episode
    observe     the flat observation
"""

import numpy as np

from fbl_gym import settings as at
from fbl_gym.arm import coriolis_terms as _coriolis_terms
from fbl_gym.arm import gravity_terms as _gravity_terms
from fbl_gym.arm import inertia_terms as _inertia_terms
from fbl_gym.arm import lumped_terms as _lumped_terms
from fbl_gym.arm import solve_terms as _solve_terms
from fbl_gym.elementary import compiled, exp, inline, log, sincos
from fbl_gym.friction import dry_friction, resist, sign
from fbl_gym.settings import (
    A1,
    A2,
    ACTION1,
    ACTION2,
    CHATTER,
    CLOCK_ROWS,
    D1,
    D2,
    E1,
    E2,
    ENDED,
    EPISODE,
    H1,
    H2,
    L1,
    L2,
    LANES,
    LOAD,
    M1,
    M2,
    P1,
    P2,
    P3,
    P4,
    P5,
    PHASE1,
    PHASE2,
    Q1,
    Q2,
    QUEUE,
    R1,
    R2,
    R3,
    R4,
    R5,
    R6,
    S1,
    S2,
    SEED,
    START1,
    START2,
    STEP,
    T1,
    T2,
    U1,
    U2,
    V1,
    V2,
    Y1,
    Y2,
    Y3,
    Y4,
    Y5,
    Y6,
)  # fmt: skip
from fbl_gym.streams import normals, stream_key, uniforms

NO_AUTORESET, NEXT_STEP, SAME_STEP = 0, 1, 2

_STREAM_PARAMETERS = stream_key("parameter error")
_STREAM_REFERENCE = stream_key("reference")
_STREAM_DISTURBANCE = stream_key("disturbance")
_STREAM_POSITION = stream_key("position noise")
_STREAM_VELOCITY = stream_key("velocity noise")
_STREAM_ACCELERATION = stream_key("acceleration noise")
_NONE = np.uint64(0)
_ONE = np.uint64(1)

inertia_terms = inline(_inertia_terms)
coriolis_terms = inline(_coriolis_terms)
gravity_terms = inline(_gravity_terms)
lumped_terms = inline(_lumped_terms)
solve_terms = inline(_solve_terms)


@inline
def _load_on_joints(p1, p2, p3, p4, p5, q1, q2, v1, v2, t1, t2):
    """The inertia matrix, and the torque left to accelerate it: t - C v - G."""
    s1, c1 = sincos(q1)
    s2, c2 = sincos(q2)
    m11, m12, m22 = inertia_terms(p1, p2, p3, c2)
    b1, b2 = coriolis_terms(p3, s2, v1, v2)
    g1, g2 = gravity_terms(p4, p5, c1, c1 * c2 - s1 * s2)
    return m11, m12, m22, t1 - b1 - g1, t2 - b2 - g2


@inline
def _slope(b, l, arm, law, row, q1, q2, v1, v2, friction):
    """The acceleration of one lane at a stage of a physics step, under the torques of `row`."""
    p1, p2, p3, p4, p5 = arm
    viscous1, viscous2, c1, c2, k1, k2, w1, w2, dry1, dry2, free1, free2 = law
    t1 = b[row * LANES + l] - viscous1 * v1 - dry1
    t2 = b[(row + 1) * LANES + l] - viscous2 * v2 - dry2
    if friction == at.LITERAL_FRICTION:
        t1 -= dry_friction(v1, c1, k1, w1) * sign(v1)
        t2 -= dry_friction(v2, c2, k2, w2) * sign(v2)
    m11, m12, m22, r1, r2 = _load_on_joints(p1, p2, p3, p4, p5, q1, q2, v1, v2, t1, t2)
    if friction == at.EXACT_FRICTION:
        # A stuck joint carries any reaction: the other moves as if alone.
        r1, r2, m12 = r1 * free1, r2 * free2, m12 * (free1 * free2)
    return solve_terms(m11, m12, m22, r1, r2)


@inline
def _runge_kutta(b, l, h, viscous1, viscous2, c1, c2, k1, k2, w1, w2, friction):
    """One physics step of one lane: fourth-order Runge-Kutta on the smooth part, friction by its law.

    Exact friction is a torque held over the step. It is what the two joints' box-constrained problem
    v+ = v + h M^-1 (load - f), |f_i| <= F_i(v), gives at the step's start, so that a joint at rest under a load below
    breakaway has no acceleration at all, at any step size; a joint that the problem brings to rest ends the step at rest.
    Sliding under Coulomb friction keeps the fourth order; where stiction fades, or a joint stops, the step is of first order.
    """
    q1, q2, v1, v2 = b[Q1 * LANES + l], b[Q2 * LANES + l], b[V1 * LANES + l], b[V2 * LANES + l]
    p1, p2, p3 = b[P1 * LANES + l], b[P2 * LANES + l], b[P3 * LANES + l]
    p4, p5 = b[P4 * LANES + l], b[P5 * LANES + l]
    dry1, dry2 = 0.0, 0.0  # friction torque held over the step
    free1, free2 = 1.0, 1.0  # 0 where a joint sticks throughout the step
    rest1, rest2 = False, False  # whether a joint ends the step at rest

    if friction == at.EXACT_FRICTION:
        m11, m12, m22, r1, r2 = _load_on_joints(
            p1, p2, p3, p4, p5, q1, q2, v1, v2, b[S1 * LANES + l] - viscous1 * v1, b[S2 * LANES + l] - viscous2 * v2
        )
        bound1, bound2 = h * dry_friction(v1, c1, k1, w1), h * dry_friction(v2, c2, k2, w2)
        g1, g2 = m11 * v1 + m12 * v2 + h * r1, m12 * v1 + m22 * v2 + h * r2
        x1, x2, dry1, dry2 = resist(m11, m12, m22, g1, g2, bound1, bound2)
        dry1, dry2 = dry1 / h, dry2 / h
        # Only friction can hold a joint: one without any merely has no velocity just now.
        rest1, rest2 = (x1 == 0.0) & (bound1 > 0.0), (x2 == 0.0) & (bound2 > 0.0)
        free1 = 0.0 if rest1 & (v1 == 0.0) else 1.0
        free2 = 0.0 if rest2 & (v2 == 0.0) else 1.0

    # The four stages: the state at which each is evaluated, and the acceleration there.
    half = 0.5 * h
    arm = (p1, p2, p3, p4, p5)
    law = (viscous1, viscous2, c1, c2, k1, k2, w1, w2, dry1, dry2, free1, free2)
    a1, a2 = _slope(b, l, arm, law, S1, q1, q2, v1, v2, friction)
    vb1, vb2 = v1 + half * a1, v2 + half * a2
    b1, b2 = _slope(b, l, arm, law, H1, q1 + half * v1, q2 + half * v2, vb1, vb2, friction)
    vc1, vc2 = v1 + half * b1, v2 + half * b2
    d1, d2 = _slope(b, l, arm, law, H1, q1 + half * vb1, q2 + half * vb2, vc1, vc2, friction)
    vd1, vd2 = v1 + h * d1, v2 + h * d2
    e1, e2 = _slope(b, l, arm, law, E1, q1 + h * vc1, q2 + h * vc2, vd1, vd2, friction)
    sixth = h / 6.0
    b[Q1 * LANES + l] = q1 + sixth * (v1 + 2.0 * (vb1 + vc1) + vd1)
    b[Q2 * LANES + l] = q2 + sixth * (v2 + 2.0 * (vb2 + vc2) + vd2)
    v1, v2 = v1 + sixth * (a1 + 2.0 * (b1 + d1) + e1), v2 + sixth * (a2 + 2.0 * (b2 + d2) + e2)
    b[V1 * LANES + l], b[V2 * LANES + l] = 0.0 if rest1 else v1, 0.0 if rest2 else v2


@compiled
def _advance(b, x, friction, width):
    """One physics step of a block's first `width` lanes."""
    h = x[at.PHYSICS_DT]
    viscous1, viscous2 = x[at.VISCOUS], x[at.VISCOUS + 1]
    c1, c2, k1, k2 = x[at.COULOMB], x[at.COULOMB + 1], x[at.STICTION], x[at.STICTION + 1]
    w1, w2 = x[at.V_S], x[at.V_S + 1]
    if friction == at.NO_FRICTION:
        for l in range(width):
            _runge_kutta(b, l, h, viscous1, viscous2, c1, c2, k1, k2, w1, w2, at.NO_FRICTION)
    elif friction == at.EXACT_FRICTION:
        for l in range(width):
            _runge_kutta(b, l, h, viscous1, viscous2, c1, c2, k1, k2, w1, w2, at.EXACT_FRICTION)
    else:
        for l in range(width):
            _runge_kutta(b, l, h, viscous1, viscous2, c1, c2, k1, k2, w1, w2, at.LITERAL_FRICTION)


@compiled
def _acceleration_and_friction(b, l, x):
    """The acceleration of a lane at this instant, and its friction torque; both joints of each."""
    q1, q2, v1, v2 = b[Q1 * LANES + l], b[Q2 * LANES + l], b[V1 * LANES + l], b[V2 * LANES + l]
    m11, m12, m22, r1, r2 = _load_on_joints(
        b[P1 * LANES + l], b[P2 * LANES + l], b[P3 * LANES + l], b[P4 * LANES + l], b[P5 * LANES + l],
        q1, q2, v1, v2, b[T1 * LANES + l] - b[D1 * LANES + l], b[T2 * LANES + l] - b[D2 * LANES + l],
    )  # fmt: skip
    bound1 = dry_friction(v1, x[at.COULOMB], x[at.STICTION], x[at.V_S])
    bound2 = dry_friction(v2, x[at.COULOMB + 1], x[at.STICTION + 1], x[at.V_S + 1])
    # A joint that moves has its friction; one at rest takes what holds it, up to breakaway.
    f1 = x[at.VISCOUS] * v1 + bound1 * sign(v1)
    f2 = x[at.VISCOUS + 1] * v2 + bound2 * sign(v2)
    if x[at.FRICTION] == at.EXACT_FRICTION:
        hold1, hold2 = bound1 if v1 == 0.0 else 0.0, bound2 if v2 == 0.0 else 0.0
        a1, a2, held1, held2 = resist(m11, m12, m22, r1 - f1, r2 - f2, hold1, hold2)
        return a1, a2, f1 + (held1 if v1 == 0.0 else 0.0), f2 + (held2 if v2 == 0.0 else 0.0)
    a1, a2 = solve_terms(m11, m12, m22, r1 - f1, r2 - f2)
    return a1, a2, f1, f2


# The torque on the joints.


@compiled
def _command(b, x, actions, first, count):
    """Torque commands from actions; lanes beyond the batch keep theirs."""
    limit1, limit2 = x[at.TORQUE_LIMIT], x[at.TORQUE_LIMIT + 1]
    depth = int(x[at.QUEUE_DEPTH])
    for age in range(depth, 0, -1):
        for l in range(2 * LANES):
            b[(QUEUE + 2 * age) * LANES + l] = b[(QUEUE + 2 * age - 2) * LANES + l]
    for l in range(count):
        b[ACTION1 * LANES + l] = max(min(actions[first + l, 0], x[at.ACTION_LIMIT]), -x[at.ACTION_LIMIT])
        b[ACTION2 * LANES + l] = max(min(actions[first + l, 1], x[at.ACTION_LIMIT + 1]), -x[at.ACTION_LIMIT + 1])
    mode = int(x[at.ACTION])
    for l in range(LANES):
        u1, u2 = b[ACTION1 * LANES + l], b[ACTION2 * LANES + l]
        if mode == at.FRACTION:
            u1, u2 = u1 * limit1, u2 * limit2
        elif mode == at.ACCELERATION:
            u1, u2 = _nominal_torque(b, l, x, u1, u2)
        u1, u2 = max(min(u1, limit1), -limit1), max(min(u2, limit2), -limit2)
        b[CHATTER * LANES + l] = abs(u1 - b[U1 * LANES + l]) / limit1 + abs(u2 - b[U2 * LANES + l]) / limit2
        b[U1 * LANES + l], b[U2 * LANES + l] = u1, u2
        b[QUEUE * LANES + l], b[(QUEUE + 1) * LANES + l] = u1, u2


@inline
def _nominal_torque(b, l, x, a1, a2):
    """The nominal feedback linearisation mapping at the measured state."""
    p1, p2, p3, p4, p5 = lumped_terms(
        x[at.ARM_M1], x[at.ARM_M2], x[at.ARM_L1], x[at.ARM_L2], x[at.GRAVITY], x[at.CENTRE], x[at.INERTIA]
    )
    q1, q2, v1, v2 = b[Y1 * LANES + l], b[Y2 * LANES + l], b[Y3 * LANES + l], b[Y4 * LANES + l]
    m11, m12, m22, r1, r2 = _load_on_joints(p1, p2, p3, p4, p5, q1, q2, v1, v2, 0.0, 0.0)
    return m11 * a1 + m12 * a2 - r1, m12 * a1 + m22 * a2 - r2


@inline
def _pick_disturbance(clock, l, x, tables, substep):
    """Disturbance of the kinds that are held over a physics step: piecewise-constant, pulses, the user's array."""
    kind = int(x[at.DISTURBANCE])
    now = float(np.int64(clock[STEP * LANES + l])) * x[at.SUBSTEPS] + substep
    d1, d2 = 0.0, 0.0
    if kind == at.PIECEWISE_CONSTANT:
        level = np.uint64(np.floor(now / x[at.PUSH_EVERY]))
        a, c, _, _ = uniforms(clock[SEED * LANES + l], _STREAM_DISTURBANCE, clock[EPISODE * LANES + l], level, _NONE)
        d1, d2 = (2.0 * a - 1.0) * x[at.PUSH], (2.0 * c - 1.0) * x[at.PUSH + 1]
    elif kind == at.PULSES:
        since = now - x[at.PUSH_START]
        phase = since - np.floor(since / x[at.PUSH_EVERY]) * x[at.PUSH_EVERY]
        on = 1.0 if since >= 0.0 and phase < x[at.PUSH_WIDTH] else 0.0
        d1, d2 = on * x[at.PUSH], on * x[at.PUSH + 1]
    elif kind == at.ARRAY:
        row = int(min(np.floor(now / x[at.PUSH_EVERY]), x[at.PUSH_ROWS] - 1.0))
        place = int(x[at.PUSH_TABLE]) + 2 * row
        d1, d2 = tables[place], tables[place + 1]
    return d1, d2


@compiled
def _apply_torque(b, clock, x, tables, substep):
    """Applied torque less disturbance at the start, the half and the end of a physics step."""
    # The command that the delay lets through now, and the lag behind it.
    depth = int(x[at.QUEUE_DEPTH])
    age = depth if substep < x[at.QUEUE_SWITCH] or depth == 0 else depth - 1
    start, half, end = x[at.LAG_START], x[at.LAG_HALF], x[at.LAG_END]
    for l in range(LANES):
        u1, u2 = b[(QUEUE + 2 * age) * LANES + l], b[(QUEUE + 2 * age + 1) * LANES + l]
        gap1, gap2 = b[T1 * LANES + l] - u1, b[T2 * LANES + l] - u2
        b[S1 * LANES + l], b[S2 * LANES + l] = u1 + start * gap1, u2 + start * gap2
        b[H1 * LANES + l], b[H2 * LANES + l] = u1 + half * gap1, u2 + half * gap2
        b[E1 * LANES + l], b[E2 * LANES + l] = u1 + end * gap1, u2 + end * gap2
        b[T1 * LANES + l], b[T2 * LANES + l] = b[E1 * LANES + l], b[E2 * LANES + l]
    if x[at.DISTURBANCE] == at.SINE:
        _apply_sine(b, clock, x, substep)
    elif x[at.DISTURBANCE] != at.NO_DISTURBANCE:
        for l in range(LANES):
            d1, d2 = _pick_disturbance(clock, l, x, tables, substep)
            b[D1 * LANES + l], b[D2 * LANES + l] = d1, d2
            for row in range(3):
                b[(S1 + 2 * row) * LANES + l] -= d1
                b[(S2 + 2 * row) * LANES + l] -= d2


@compiled
def _apply_sine(b, clock, x, substep):
    for l in range(LANES):
        now = float(np.int64(clock[STEP * LANES + l])) * x[at.SUBSTEPS] + substep
        for half_steps in range(3):
            t = (now + 0.5 * half_steps) * x[at.PHYSICS_DT]
            s1, _ = sincos(x[at.PUSH_RATE] * t + b[PHASE1 * LANES + l])
            s2, _ = sincos(x[at.PUSH_RATE + 1] * t + b[PHASE2 * LANES + l])
            d1, d2 = x[at.PUSH] * s1, x[at.PUSH + 1] * s2
            b[(S1 + 2 * half_steps) * LANES + l] -= d1
            b[(S2 + 2 * half_steps) * LANES + l] -= d2
            b[D1 * LANES + l], b[D2 * LANES + l] = d1, d2


@compiled
def _carry_payload(b, clock, x, substep):
    """Put the payload on the tip while it is carried."""
    for l in range(LANES):
        now = float(np.int64(clock[STEP * LANES + l])) * x[at.SUBSTEPS] + substep
        carried = x[at.LOAD_MASS] if x[at.LOAD_ON] <= now and now < x[at.LOAD_OFF] else 0.0
        if carried != b[LOAD * LANES + l]:
            b[LOAD * LANES + l] = carried
            _lump(b, l, x)


@compiled
def _lump(b, l, x):
    """The true lumped parameters of a lane, with the payload it carries."""
    m1, m2, l1, l2 = b[M1 * LANES + l], b[M2 * LANES + l], b[L1 * LANES + l], b[L2 * LANES + l]
    load, g = b[LOAD * LANES + l], x[at.GRAVITY]
    p1, p2, p3, p4, p5 = lumped_terms(m1, m2, l1, l2, g, x[at.CENTRE], x[at.INERTIA])
    b[P1 * LANES + l] = p1 + load * l1 * l1
    b[P2 * LANES + l] = p2 + load * l2 * l2
    b[P3 * LANES + l] = p3 + load * l1 * l2
    b[P4 * LANES + l] = p4 + load * l1 * g
    b[P5 * LANES + l] = p5 + load * l2 * g


# What is seen.


@inline
def _within(value, bound):
    """`value` cut to [-bound, bound]; NaN becomes -bound."""
    value = value if value > -bound else -bound
    return value if value < bound else bound


@inline
def _sense(b, clock, x, first, last):
    """The readings of the lanes from `first` up to `last`."""
    if x[at.SENSES_ACCELERATION] != 0.0:
        for l in range(first, last):
            a1, a2, _, _ = _acceleration_and_friction(b, l, x)
            b[A1 * LANES + l], b[A2 * LANES + l] = a1, a2
    for row in range(6):
        for l in range(first, last):
            b[(Y1 + row) * LANES + l] = b[(Q1 + row) * LANES + l]
    if x[at.NOISY] != 0.0:
        _disturb_reading(b, clock, x, 0, _STREAM_POSITION, first, last)
        _disturb_reading(b, clock, x, 2, _STREAM_VELOCITY, first, last)
        _disturb_reading(b, clock, x, 4, _STREAM_ACCELERATION, first, last)
    # A sensor reads no further than its range.
    position, velocity, acceleration = 2.0 * x[at.MAX_POSITION], 2.0 * x[at.MAX_VELOCITY], x[at.MAX_ACCELERATION]
    for l in range(first, last):
        b[Y1 * LANES + l] = _within(b[Y1 * LANES + l], position)
        b[Y2 * LANES + l] = _within(b[Y2 * LANES + l], position)
        b[Y3 * LANES + l] = _within(b[Y3 * LANES + l], velocity)
        b[Y4 * LANES + l] = _within(b[Y4 * LANES + l], velocity)
        b[Y5 * LANES + l] = _within(b[Y5 * LANES + l], acceleration)
        b[Y6 * LANES + l] = _within(b[Y6 * LANES + l], acceleration)


@compiled
def _disturb_reading(b, clock, x, sensor, stream, first, last):
    """Bias, noise and quantization of one sensor's two joints."""
    y1, y2 = (Y1 + sensor) * LANES, (Y2 + sensor) * LANES
    sigma1, sigma2 = x[at.SIGMA + sensor], x[at.SIGMA + sensor + 1]
    bias1, bias2 = x[at.BIAS + sensor], x[at.BIAS + sensor + 1]
    if sigma1 != 0.0 or sigma2 != 0.0:
        for l in range(first, last):
            a, c = normals(clock[SEED * LANES + l], stream, clock[EPISODE * LANES + l], clock[STEP * LANES + l], _NONE)
            b[y1 + l] += sigma1 * a
            b[y2 + l] += sigma2 * c
    for l in range(first, last):
        b[y1 + l] += bias1
        b[y2 + l] += bias2
    for joint in range(2):
        quantum, y = x[at.QUANTUM + sensor + joint], y1 + joint * LANES
        if quantum > 0.0:
            for l in range(first, last):
                b[y + l] = np.floor(b[y + l] / quantum + 0.5) * quantum


@compiled
def _reference(b, l, x, tables, step):
    """The reference of a lane at a control step: position, velocity and acceleration of both joints."""
    kind, row, points = int(x[at.REFERENCE]), int(x[at.REFERENCE_ROW]), int(x[at.POINTS])
    place = int(x[at.POINT_TABLE])
    if kind == at.REFERENCE_TABLE:
        place += 6 * min(step, points - 1)
        return (
            tables[place],
            tables[place + 1],
            tables[place + 2],
            tables[place + 3],
            tables[place + 4],
            tables[place + 5],
        )
    t = step * x[at.CONTROL_DT]
    if kind == at.HARMONICS:
        return _harmonics(b, l, x, tables, row, points, place, t)
    # Between way-point (or level) i and the next; the last segment goes on for ever.
    i = min(int(np.floor(t / x[at.POINT_TIME] + 1e-9)), max(points - 2, 0))
    j = min(i + 1, points - 1)
    tau = t - i * x[at.POINT_TIME]
    from1, from2 = b[(row + 2 * i) * LANES + l], b[(row + 2 * i + 1) * LANES + l]
    to1, to2 = b[(row + 2 * j) * LANES + l], b[(row + 2 * j + 1) * LANES + l]
    if kind == at.MINIMUM_JERK:
        move = x[at.MOVE_TIME]
        s = min(tau / move, 1.0)
        share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        rate = 30.0 * s * s * (1.0 + s * (s - 2.0)) / move
        bend = 60.0 * s * (1.0 + s * (2.0 * s - 3.0)) / (move * move)
        d1, d2 = to1 - from1, to2 - from2
        return from1 + share * d1, from2 + share * d2, rate * d1, rate * d2, bend * d1, bend * d2
    if kind == at.STEPS:
        return to1, to2, 0.0, 0.0, 0.0, 0.0
    # Filtered steps: r = to + (a + c tau) exp(-w tau).
    w = x[at.BANDWIDTH]
    fade = exp(-w * tau)
    own = row + 2 * points + 4 * i
    a1, a2 = b[own * LANES + l], b[(own + 1) * LANES + l]
    c1, c2 = b[(own + 2) * LANES + l], b[(own + 3) * LANES + l]
    r1, r2 = (a1 + c1 * tau) * fade, (a2 + c2 * tau) * fade
    v1, v2 = c1 * fade - w * r1, c2 * fade - w * r2
    return to1 + r1, to2 + r2, v1, v2, -2.0 * w * v1 - w * w * r1, -2.0 * w * v2 - w * w * r2


@compiled
def _harmonics(b, l, x, tables, row, points, place, t):
    q1, q2, v1, v2, a1, a2 = x[at.MIDDLE], x[at.MIDDLE + 1], 0.0, 0.0, 0.0, 0.0
    for i in range(points):
        w = (i + 1) * x[at.BASE_RATE]
        size1, size2 = tables[place + 2 * i], tables[place + 2 * i + 1]
        s1, c1 = sincos(w * t + b[(row + 2 * i) * LANES + l])
        s2, c2 = sincos(w * t + b[(row + 2 * i + 1) * LANES + l])
        q1, q2 = q1 + size1 * s1, q2 + size2 * s2
        v1, v2 = v1 + w * size1 * c1, v2 + w * size2 * c2
        a1, a2 = a1 - w * w * size1 * s1, a2 - w * w * size2 * s2
    return q1, q2, v1, v2, a1, a2


@compiled
def _refer(b, clock, x, tables):
    """The reference of a block, now."""
    for l in range(LANES):
        r1, r2, r3, r4, r5, r6 = _reference(b, l, x, tables, np.int64(clock[STEP * LANES + l]))
        b[R1 * LANES + l], b[R2 * LANES + l], b[R3 * LANES + l] = r1, r2, r3
        b[R4 * LANES + l], b[R5 * LANES + l], b[R6 * LANES + l] = r4, r5, r6


@compiled
def _observe(b, l, x, tables, step, out, i):
    """The observation of a lane, written to row i of `out`."""
    position, velocity, acceleration = 2.0 * x[at.MAX_POSITION], 2.0 * x[at.MAX_VELOCITY], x[at.MAX_ACCELERATION]
    n = 0
    for joint in range(2):
        out[i, n + joint] = b[(Y1 + joint) * LANES + l]
    n += 2
    if x[at.SENSES_VELOCITY] != 0.0:
        for joint in range(2):
            out[i, n + joint] = b[(Y3 + joint) * LANES + l]
        n += 2
    if x[at.SENSES_ACCELERATION] != 0.0:
        for joint in range(2):
            out[i, n + joint] = b[(Y5 + joint) * LANES + l]
        n += 2
    for joint in range(2):
        out[i, n + joint] = _within(b[(R1 + joint) * LANES + l], position)
        out[i, n + 2 + joint] = _within(b[(R3 + joint) * LANES + l], velocity)
        out[i, n + 4 + joint] = _within(b[(R5 + joint) * LANES + l], acceleration)
    n += 6
    if x[at.OBSERVES_ACTION] != 0.0:
        out[i, n], out[i, n + 1] = b[ACTION1 * LANES + l], b[ACTION2 * LANES + l]
        n += 2
    for ahead in range(int(x[at.PREVIEW])):
        r1, r2, r3, r4, r5, r6 = _reference(b, l, x, tables, step + ahead + 1)
        out[i, n], out[i, n + 1] = _within(r1, position), _within(r2, position)
        out[i, n + 2], out[i, n + 3] = _within(r3, velocity), _within(r4, velocity)
        out[i, n + 4], out[i, n + 5] = _within(r5, acceleration), _within(r6, acceleration)
        n += 6


@inline
def _reward(b, l, x):
    """The reward of a lane that has not diverged; see `reward.py`."""
    error = abs(b[R1 * LANES + l] - b[Q1 * LANES + l]) + abs(b[R2 * LANES + l] - b[Q2 * LANES + l])
    tracking = x[at.REWARD_SCALE] * error
    if x[at.REWARD_LOG] != 0.0:
        tracking = x[at.REWARD_NORM] * log(1.0 + tracking)
    limit1, limit2 = x[at.TORQUE_LIMIT], x[at.TORQUE_LIMIT + 1]
    effort = 0.5 * (abs(b[U1 * LANES + l]) / limit1 + abs(b[U2 * LANES + l]) / limit2)
    chatter = 0.25 * b[CHATTER * LANES + l]
    loss = x[at.W_TRACKING] * min(tracking, 1.0) + x[at.W_EFFORT] * effort + x[at.W_CHATTER] * chatter
    return max(1.0 - loss, 0.0)


@inline
def _diverged(b, l, x):
    """Whether a lane has left its limits (or the numbers)."""
    return not (
        abs(b[Q1 * LANES + l] - b[START1 * LANES + l]) <= x[at.MAX_POSITION]
        and abs(b[Q2 * LANES + l] - b[START2 * LANES + l]) <= x[at.MAX_POSITION]
        and abs(b[V1 * LANES + l]) <= x[at.MAX_VELOCITY]
        and abs(b[V2 * LANES + l]) <= x[at.MAX_VELOCITY]
    )


# The start of an episode.


@compiled
def _start(b, clock, l, x, tables):
    """Draw a lane's arm and motion, and put the arm on its reference."""
    seed, episode = clock[SEED * LANES + l], clock[EPISODE * LANES + l]
    clock[STEP * LANES + l] = _NONE
    clock[ENDED * LANES + l] = _NONE
    draws = uniforms(seed, _STREAM_PARAMETERS, episode, _NONE, _NONE)
    for i in range(4):
        draw = draws[0] if x[at.TOGETHER] != 0.0 else draws[i]
        factor = exp((2.0 * draw - 1.0) * x[at.LOG_RADIUS + i]) if x[at.LOG_RADIUS + i] > 0.0 else 1.0
        b[(M1 + i) * LANES + l] = x[at.ARM_M1 + i] * x[at.RATIO + i] * factor
    b[LOAD * LANES + l] = x[at.LOAD_MASS] if x[at.LOAD_ON] == 0.0 else 0.0
    _lump(b, l, x)
    start1, start2 = _draw_reference(b, l, x, tables, seed, episode)
    r1, r2, r3, r4, r5, r6 = _reference(b, l, x, tables, 0)
    b[R1 * LANES + l], b[R2 * LANES + l], b[R3 * LANES + l] = r1, r2, r3
    b[R4 * LANES + l], b[R5 * LANES + l], b[R6 * LANES + l] = r4, r5, r6
    if x[at.REFERENCE] != at.STEPS:
        start1, start2 = r1, r2
    start1, start2 = start1 + x[at.INITIAL_ERROR], start2 + x[at.INITIAL_ERROR + 1]
    b[Q1 * LANES + l], b[Q2 * LANES + l] = start1, start2
    b[START1 * LANES + l], b[START2 * LANES + l] = start1, start2
    b[V1 * LANES + l], b[V2 * LANES + l] = r3, r4
    _hold_still(b, l, x)
    b[D1 * LANES + l], b[D2 * LANES + l] = 0.0, 0.0
    if x[at.DISTURBANCE] == at.SINE:
        b[PHASE1 * LANES + l], b[PHASE2 * LANES + l] = x[at.PUSH_PHASE], x[at.PUSH_PHASE + 1]
        if x[at.PUSH_DRAWN] != 0.0:
            a, c, _, _ = uniforms(seed, _STREAM_DISTURBANCE, episode, _NONE, _NONE)
            b[PHASE1 * LANES + l], b[PHASE2 * LANES + l] = 6.283185307179586 * a, 6.283185307179586 * c
        b[D1 * LANES + l] = x[at.PUSH] * sincos(b[PHASE1 * LANES + l])[0]
        b[D2 * LANES + l] = x[at.PUSH + 1] * sincos(b[PHASE2 * LANES + l])[0]
    elif x[at.DISTURBANCE] != at.NO_DISTURBANCE:
        d1, d2 = _pick_disturbance(clock, l, x, tables, 0)
        b[D1 * LANES + l], b[D2 * LANES + l] = d1, d2


@compiled
def _hold_still(b, l, x):
    """Before the first action, the torque that holds the nominal arm still where it starts, within the limit."""
    b[Y1 * LANES + l], b[Y2 * LANES + l] = b[Q1 * LANES + l], b[Q2 * LANES + l]
    b[Y3 * LANES + l], b[Y4 * LANES + l] = 0.0, 0.0
    u1, u2 = _nominal_torque(b, l, x, 0.0, 0.0)
    limit1, limit2 = x[at.TORQUE_LIMIT], x[at.TORQUE_LIMIT + 1]
    if x[at.ACTION] == at.TORQUE:  # an unlimited arm's box of torques has bounds all the same
        limit1, limit2 = x[at.ACTION_LIMIT], x[at.ACTION_LIMIT + 1]
    u1, u2 = max(min(u1, limit1), -limit1), max(min(u2, limit2), -limit2)
    b[U1 * LANES + l], b[U2 * LANES + l] = u1, u2
    b[T1 * LANES + l], b[T2 * LANES + l] = u1, u2
    for age in range(int(x[at.QUEUE_DEPTH]) + 1):
        b[(QUEUE + 2 * age) * LANES + l], b[(QUEUE + 2 * age + 1) * LANES + l] = u1, u2
    mode = int(x[at.ACTION])
    b[ACTION1 * LANES + l], b[ACTION2 * LANES + l] = 0.0, 0.0  # no acceleration
    if mode == at.FRACTION:
        b[ACTION1 * LANES + l], b[ACTION2 * LANES + l] = u1 / limit1, u2 / limit2
    elif mode == at.TORQUE:
        b[ACTION1 * LANES + l], b[ACTION2 * LANES + l] = u1, u2


@compiled
def _draw_reference(b, l, x, tables, seed, episode):
    """Way-points, levels or phases of a lane; returns the first way-point."""
    kind, row, points, place = int(x[at.REFERENCE]), int(x[at.REFERENCE_ROW]), int(x[at.POINTS]), int(x[at.POINT_TABLE])
    if kind == at.REFERENCE_TABLE:
        return 0.0, 0.0
    for i in range(points):
        a, c, _, _ = uniforms(seed, _STREAM_REFERENCE, episode, np.uint64(i), _NONE)
        if kind == at.HARMONICS:
            value1, value2 = 6.283185307179586 * a, 6.283185307179586 * c
            if x[at.PHASES_DRAWN] == 0.0:
                value1, value2 = tables[place + 2 * points], tables[place + 2 * points + 1]
        elif place < 0:
            value1 = x[at.LOW] + a * (x[at.HIGH] - x[at.LOW])
            value2 = x[at.LOW + 1] + c * (x[at.HIGH + 1] - x[at.LOW + 1])
        else:
            value1, value2 = tables[place + 2 * i], tables[place + 2 * i + 1]
        b[(row + 2 * i) * LANES + l], b[(row + 2 * i + 1) * LANES + l] = value1, value2
    if kind == at.FILTERED_STEPS:
        _chain_filter(b, l, x, row, points)
    return b[row * LANES + l], b[(row + 1) * LANES + l]


@compiled
def _chain_filter(b, l, x, row, points):
    """The state of the reference's filter at the start of each segment, from the end of the one before."""
    w, time = x[at.BANDWIDTH], x[at.POINT_TIME]
    fade = exp(-w * time)
    for joint in range(2):
        r, v = b[(row + joint) * LANES + l], 0.0
        for i in range(points):
            to = b[(row + 2 * min(i + 1, points - 1) + joint) * LANES + l]
            a = r - to
            c = v + w * a
            b[(row + 2 * points + 4 * i + joint) * LANES + l] = a
            b[(row + 2 * points + 4 * i + 2 + joint) * LANES + l] = c
            r = to + (a + c * time) * fade
            v = (c - w * (a + c * time)) * fade


@compiled
def _settle_start(b, clock, x, tables, l):
    """Start a lane and take its first readings."""
    _start(b, clock, l, x, tables)
    _sense(b, clock, x, l, l + 1)


# What `batch.py` calls, through `compiled.py`.


@compiled
def reset(state, clock, x, tables, mask, out):
    """Start an episode in each lane of `mask`; write the observations of the first len(out) lanes to `out`.

    `mask` may reach beyond the batch, to the lanes of the last block that no environment uses.
    """
    size, ticks = int(x[at.ROWS]) * LANES, CLOCK_ROWS * LANES
    for i in range(len(mask)):
        block, l = i // LANES, i % LANES
        b, c = state[block * size : (block + 1) * size], clock[block * ticks : (block + 1) * ticks]
        if mask[i]:
            _settle_start(b, c, x, tables, l)
        if i < len(out):
            _observe(b, l, x, tables, np.int64(c[STEP * LANES + l]), out, i)


@compiled
def first_bad(actions, clock, autoreset):
    """The first lane whose action is not finite, or -1; and the first that has ended and is not reset by itself, or -1."""
    bad, ended = -1, -1
    for i in range(len(actions) - 1, -1, -1):
        block, l = i // LANES, i % LANES
        if autoreset != NEXT_STEP and clock[(block * CLOCK_ROWS + ENDED) * LANES + l] != _NONE:
            ended = i
        if not (np.isfinite(actions[i, 0]) and np.isfinite(actions[i, 1])):
            bad = i
    return bad, ended


@compiled
def step(state, clock, x, tables, actions, autoreset, out, final, rewards, terminated, truncated):
    """One control interval of every lane.

    actions: [n x 2]; out, final: [n x size], the observations returned, and those of episodes that ended where SAME_STEP
    has already started the next; rewards, terminated, truncated: [n].
    """
    size, ticks = int(x[at.ROWS]) * LANES, CLOCK_ROWS * LANES
    n = len(actions)
    for block in range((n + LANES - 1) // LANES):
        b, c = state[block * size : (block + 1) * size], clock[block * ticks : (block + 1) * ticks]
        first = block * LANES
        count = min(LANES, n - first)
        _interval(b, c, x, tables, actions, first, count)
        for l in range(count):
            i = first + l
            if autoreset == NEXT_STEP and c[ENDED * LANES + l] != _NONE:
                c[EPISODE * LANES + l] += _ONE
                _settle_start(b, c, x, tables, l)
                rewards[i], terminated[i], truncated[i] = 0.0, False, False
            else:
                gone = _diverged(b, l, x)
                rewards[i] = 0.0 if gone else _reward(b, l, x)
                terminated[i] = gone
                truncated[i] = not gone and c[STEP * LANES + l] >= np.uint64(x[at.LAST_STEP])
                if terminated[i] or truncated[i]:
                    c[ENDED * LANES + l] = _ONE
                    if autoreset == SAME_STEP:
                        _observe(b, l, x, tables, np.int64(c[STEP * LANES + l]), final, i)
                        c[EPISODE * LANES + l] += _ONE
                        _settle_start(b, c, x, tables, l)
            _observe(b, l, x, tables, np.int64(c[STEP * LANES + l]), out, i)


@compiled
def _interval(b, c, x, tables, actions, first, count):
    """A block through one control interval, up to its readings and its reference."""
    _command(b, x, actions, first, count)
    friction = int(x[at.FRICTION])
    width = LANES if count > LANES // 2 else LANES // 2  # a single environment pays for half a block
    varies, loaded = x[at.VARIES] != 0.0, x[at.LOAD_MASS] != 0.0
    for substep in range(int(x[at.SUBSTEPS])):
        if substep == 0 or varies:
            _apply_torque(b, c, x, tables, substep)
        if loaded:
            _carry_payload(b, c, x, substep)
        _advance(b, x, friction, width)
    for l in range(LANES):
        c[STEP * LANES + l] += _ONE
    _sense(b, c, x, 0, LANES)
    _refer(b, c, x, tables)


@compiled
def inspect(state, x, lanes, out):
    """The true acceleration and friction torque of each lane, [n x 4], for plots and checks."""
    size = int(x[at.ROWS]) * LANES
    for i in range(lanes):
        block, l = i // LANES, i % LANES
        b = state[block * size : (block + 1) * size]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = _acceleration_and_friction(b, l, x)
