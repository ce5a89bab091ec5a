"""The arm's motion over one physics step: friction by its law, the rest by Runge and Kutta."""

import numpy as np

from fbl_gym import arm as model
from fbl_gym import settings as at
from fbl_gym.fastmath import compiled, inline, sincos
from fbl_gym.friction import dry_friction, resist, sign
from fbl_gym.settings import (
    D1, D2, E1, E2, H1, H2, L1, L2, LOAD, M1, M2, P1, P2, P3, P4, P5, Q1, Q2, S1, S2, STEP, T1, T2, V1, V2,
)  # fmt: skip

inertia_terms = inline(model.inertia_terms)
coriolis_terms = inline(model.coriolis_terms)
gravity_terms = inline(model.gravity_terms)
lumped_terms = inline(model.lumped_terms)
solve_terms = inline(model.solve_terms)


@inline
def load_on_joints(p1, p2, p3, p4, p5, q1, q2, v1, v2, t1, t2):
    """The inertia matrix, and the torque left to accelerate it: t - C v - G."""
    s1, c1 = sincos(q1)
    s2, c2 = sincos(q2)
    m11, m12, m22 = inertia_terms(p1, p2, p3, c2)
    b1, b2 = coriolis_terms(p3, s2, v1, v2)
    g1, g2 = gravity_terms(p4, p5, c1, c1 * c2 - s1 * s2)
    return m11, m12, m22, t1 - b1 - g1, t2 - b2 - g2


@inline
def _slope(t1, t2, arm, law, q1, q2, v1, v2, friction):
    """The acceleration of one lane at a stage of a physics step, under torques t1 and t2."""
    p1, p2, p3, p4, p5 = arm
    viscous1, viscous2, c1, c2, k1, k2, w1, w2, dry1, dry2, free1, free2 = law
    t1, t2 = t1 - viscous1 * v1 - dry1, t2 - viscous2 * v2 - dry2
    if friction == at.LITERAL_FRICTION:
        t1 -= dry_friction(v1, c1, k1, w1) * sign(v1)
        t2 -= dry_friction(v2, c2, k2, w2) * sign(v2)
    m11, m12, m22, r1, r2 = load_on_joints(p1, p2, p3, p4, p5, q1, q2, v1, v2, t1, t2)
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
    q1, q2, v1, v2 = b[Q1 + l], b[Q2 + l], b[V1 + l], b[V2 + l]
    p1, p2, p3 = b[P1 + l], b[P2 + l], b[P3 + l]
    p4, p5 = b[P4 + l], b[P5 + l]
    dry1, dry2 = 0.0, 0.0  # friction torque held over the step
    free1, free2 = 1.0, 1.0  # 0 where a joint sticks throughout the step
    rest1, rest2 = False, False  # whether a joint ends the step at rest

    if friction == at.EXACT_FRICTION:
        m11, m12, m22, r1, r2 = load_on_joints(
            p1, p2, p3, p4, p5, q1, q2, v1, v2, b[S1 + l] - viscous1 * v1, b[S2 + l] - viscous2 * v2
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
    s1, s2, m1, m2 = b[S1 + l], b[S2 + l], b[H1 + l], b[H2 + l]
    a1, a2 = _slope(s1, s2, arm, law, q1, q2, v1, v2, friction)
    vb1, vb2 = v1 + half * a1, v2 + half * a2
    b1, b2 = _slope(m1, m2, arm, law, q1 + half * v1, q2 + half * v2, vb1, vb2, friction)
    vc1, vc2 = v1 + half * b1, v2 + half * b2
    d1, d2 = _slope(m1, m2, arm, law, q1 + half * vb1, q2 + half * vb2, vc1, vc2, friction)
    vd1, vd2 = v1 + h * d1, v2 + h * d2
    e1, e2 = _slope(b[E1 + l], b[E2 + l], arm, law, q1 + h * vc1, q2 + h * vc2, vd1, vd2, friction)
    sixth = h / 6.0
    b[Q1 + l] = q1 + sixth * (v1 + 2.0 * (vb1 + vc1) + vd1)
    b[Q2 + l] = q2 + sixth * (v2 + 2.0 * (vb2 + vc2) + vd2)
    v1, v2 = v1 + sixth * (a1 + 2.0 * (b1 + d1) + e1), v2 + sixth * (a2 + 2.0 * (b2 + d2) + e2)
    b[V1 + l], b[V2 + l] = 0.0 if rest1 else v1, 0.0 if rest2 else v2


@compiled
def advance(b, x, width):
    """One physics step of a block's first `width` lanes."""
    friction = int(x[at.FRICTION])
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


@inline
def acceleration_and_friction(b, l, x, friction):
    """The acceleration of a lane at this instant, and its friction torque; both joints of each."""
    q1, q2, v1, v2 = b[Q1 + l], b[Q2 + l], b[V1 + l], b[V2 + l]
    m11, m12, m22, r1, r2 = load_on_joints(
        b[P1 + l], b[P2 + l], b[P3 + l], b[P4 + l], b[P5 + l],
        q1, q2, v1, v2, b[T1 + l] - b[D1 + l], b[T2 + l] - b[D2 + l],
    )  # fmt: skip
    bound1, bound2 = 0.0, 0.0
    if friction != at.NO_FRICTION:
        bound1 = dry_friction(v1, x[at.COULOMB], x[at.STICTION], x[at.V_S])
        bound2 = dry_friction(v2, x[at.COULOMB + 1], x[at.STICTION + 1], x[at.V_S + 1])
    # A joint that moves has its friction; one at rest takes what holds it, up to breakaway.
    f1 = x[at.VISCOUS] * v1 + bound1 * sign(v1)
    f2 = x[at.VISCOUS + 1] * v2 + bound2 * sign(v2)
    if friction != at.EXACT_FRICTION:
        a1, a2 = solve_terms(m11, m12, m22, r1 - f1, r2 - f2)
        return a1, a2, f1, f2
    hold1, hold2 = bound1 if v1 == 0.0 else 0.0, bound2 if v2 == 0.0 else 0.0
    a1, a2, held1, held2 = resist(m11, m12, m22, r1 - f1, r2 - f2, hold1, hold2)
    return a1, a2, f1 + (held1 if v1 == 0.0 else 0.0), f2 + (held2 if v2 == 0.0 else 0.0)


@compiled
def carry_payload(b, clock, x, width, substep):
    """Put the payload on the tip while it is carried."""
    for l in range(width):
        now = float(np.int64(clock[STEP + l])) * x[at.SUBSTEPS] + substep
        carried = x[at.LOAD_MASS] if x[at.LOAD_ON] <= now and now < x[at.LOAD_OFF] else 0.0
        if carried != b[LOAD + l]:
            b[LOAD + l] = carried
            lump(b, l, x)


@compiled
def lump(b, l, x):
    """The true lumped parameters of a lane, with the payload it carries."""
    m1, m2, l1, l2 = b[M1 + l], b[M2 + l], b[L1 + l], b[L2 + l]
    load, g = b[LOAD + l], x[at.GRAVITY]
    p1, p2, p3, p4, p5 = lumped_terms(m1, m2, l1, l2, g, x[at.CENTRE], x[at.INERTIA])
    b[P1 + l] = p1 + load * l1 * l1
    b[P2 + l] = p2 + load * l2 * l2
    b[P3 + l] = p3 + load * l1 * l2
    b[P4 + l] = p4 + load * l1 * g
    b[P5 + l] = p5 + load * l2 * g
