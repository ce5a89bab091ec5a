"""Friction in the joints: the paper's equation (43), and the exact rule of a joint that sticks.

    F_i(v) = f_i1 v + (f_i2 + f_s exp(-v^2 / v_s)) sign(v)        v_s in (rad/s)^2

As printed, sign(0) = 0: at rest there is no friction, and nothing ever sticks. A real joint at rest holds any load up to
the breakaway torque f_i2 + f_s. The exact rule keeps the printed curve while a joint moves, and at rest lets friction
take any value up to breakaway (the set-valued law; Glocker, "Set-Valued Force Laws", 2001).
"""

from fbl_gym.fastmath import exp, inline_njit


@inline_njit
def dry_friction(v, coulomb, stiction, v_s):
    """Size of the friction torque without its viscous part, f_i2 + f_s exp(-v^2/v_s) [N m]."""
    return coulomb + stiction * exp(-v * v / v_s)


@inline_njit
def sign(v):
    """-1, 0 or 1."""
    return (1.0 if v > 0.0 else 0.0) - (1.0 if v < 0.0 else 0.0)


@inline_njit
def _shrink(x, bound):
    """x moved towards zero by `bound`, and exactly zero within it."""
    return max(x - bound, 0.0) + min(x + bound, 0.0)


@inline_njit
def resist(m11, m12, m22, g1, g2, b1, b2):
    """What two coupled joints do under dry friction: the minimum of (w - f)' M (w - f) / 2 + b1 |w1| + b2 |w2|.

    M is the inertia matrix, g = M f the momentum (or load) the joints would have without friction, and b bounds
    the friction impulse (or torque) of each joint. Returns the velocity (or acceleration) w, where a joint that sticks has
    exactly zero, and the friction g - M w.

    Each joint rests, or slides either way: nine cases, told apart one joint at a time. Minimised over w1, the problem stays
    convex in w2, and its slope at w2 = 0 is the load left on a resting second joint by the first one alone: within b2 it
    rests, beyond it slides the way of that load. Likewise for w1. So just one case is taken, however close to the border.
    """
    alone1, alone2 = _shrink(g1, b1) / m11, _shrink(g2, b2) / m22
    left1, left2 = g1 - m12 * alone2, g2 - m12 * alone1
    rests1, rests2 = abs(left1) <= b1, abs(left2) <= b2
    s1, s2 = (1.0 if left1 > 0.0 else -1.0), (1.0 if left2 > 0.0 else -1.0)
    # Both slide, with their frictions against these directions.
    h1, h2 = g1 - s1 * b1, g2 - s2 * b2
    scale = 1.0 / (m11 * m22 - m12 * m12)
    w1 = s1 * max(s1 * (m22 * h1 - m12 * h2) * scale, 0.0)
    w2 = s2 * max(s2 * (m11 * h2 - m12 * h1) * scale, 0.0)
    # One rests, and the other goes as if alone (which is at rest, too, where its load is within its bound).
    w1 = 0.0 if rests1 else (alone1 if rests2 else w1)
    w2 = 0.0 if rests2 else (alone2 if rests1 else w2)
    return w1, w2, g1 - m11 * w1 - m12 * w2, g2 - m12 * w1 - m22 * w2
