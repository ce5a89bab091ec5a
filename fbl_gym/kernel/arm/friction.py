"""Friction in the joints: the paper's equation (43), and the exact rule of a joint that sticks.

    F_i(v) = f_i1 v + (f_i2 + f_s exp(-v^2 / v_s)) sign(v)        v_s in (rad/s)^2

As printed, sign(0) = 0: a joint at rest has no friction and never sticks. Under a load below
breakaway it creeps, some 0.5 mrad/s at a physics step of 1 ms and a hundredth of that at 10 us: the
creep is an effect of the step size. A real joint at rest holds any load up to the breakaway torque
f_i2 + f_s. The exact rule keeps the printed curve while a joint moves. At rest, friction takes any
value up to breakaway (the set-valued law; Glocker, "Set-Valued Force Laws", 2001).
"""

from fbl_gym.kernel.maths.fastmath import exp, inline_njit, larger, smaller


@inline_njit
def dry_friction(v, coulomb, stiction, v_s):
    """Return the size of the friction torque without the viscous part [N m]."""
    return coulomb + stiction * exp(-v * v / v_s)


@inline_njit
def sign(v):
    """Return -1, 0 or 1."""
    return (1.0 if v > 0.0 else 0.0) - (1.0 if v < 0.0 else 0.0)


@inline_njit
def shrink(x, bound):
    """Return x moved towards zero by `bound`, and exactly zero within it."""
    return larger(x - bound, 0.0) + smaller(x + bound, 0.0)


@inline_njit
def resist(m11, m12, m22, g1, g2, b1, b2):
    """Return the motion of two coupled joints under dry friction, and the friction.

    It minimises (w - f)' M (w - f) / 2 + b1 |w1| + b2 |w2|, with the inertia matrix M, the momentum
    (or load) g = M f that the joints would have without friction, and the bounds b1, b2 of each
    joint's friction impulse (or torque).

    Each joint rests or slides either way: nine cases, decided one joint at a time. Minimised over
    w1, the problem stays convex in w2. Its slope at w2 = 0 is the load that the first joint alone
    leaves on a resting second joint: within b2 that joint rests, beyond b2 it slides the way of the
    load. Likewise for w1. Therefore exactly one case is taken.

    Returns:
        The velocity (or acceleration) w1, w2, and the friction g - M w of both joints.
    """
    alone1, alone2 = shrink(g1, b1) / m11, shrink(g2, b2) / m22
    left1, left2 = g1 - m12 * alone2, g2 - m12 * alone1
    rests1, rests2 = abs(left1) <= b1, abs(left2) <= b2
    way1, way2 = (1.0 if left1 > 0.0 else -1.0), (1.0 if left2 > 0.0 else -1.0)
    # Both slide, with their frictions against these directions.
    h1, h2 = g1 - way1 * b1, g2 - way2 * b2
    scale = 1.0 / (m11 * m22 - m12 * m12)
    w1 = way1 * larger(way1 * (m22 * h1 - m12 * h2) * scale, 0.0)
    w2 = way2 * larger(way2 * (m11 * h2 - m12 * h1) * scale, 0.0)
    # One rests, and the other moves as if alone; it also rests if its load is within its bound.
    w1 = 0.0 if rests1 else (alone1 if rests2 else w1)
    w2 = 0.0 if rests2 else (alone2 if rests1 else w2)
    return w1, w2, g1 - m11 * w1 - m12 * w2, g2 - m12 * w1 - m22 * w2
