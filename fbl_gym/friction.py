"""Friction in the joints: the paper's equation (43), and the exact rule of a joint that sticks.

    F_i(v) = f_i1 v + (f_i2 + f_s exp(-v^2 / v_s)) sign(v)        v_s in (rad/s)^2

As printed, sign(0) = 0: at rest there is no friction, and nothing ever sticks. A real joint at rest holds any load up to
the breakaway torque f_i2 + f_s. The exact rule keeps the printed curve while a joint moves, and at rest lets friction
take any value up to breakaway (the set-valued law; Glocker, "Set-Valued Force Laws", 2001).
"""

from fbl_gym.elementary import exp, inline


@inline
def dry_friction(v, coulomb, stiction, v_s):
    """Size of the friction torque without its viscous part, f_i2 + f_s exp(-v^2/v_s) [N m]."""
    return coulomb + stiction * exp(-v * v / v_s)


@inline
def sign(v):
    """-1, 0 or 1."""
    return (1.0 if v > 0.0 else 0.0) - (1.0 if v < 0.0 else 0.0)


@inline
def _shrink(x, bound):
    """x moved towards zero by `bound`, and exactly zero within it."""
    return max(x - bound, 0.0) + min(x + bound, 0.0)


@inline
def resist(m11, m12, m22, g1, g2, b1, b2):
    """What two coupled joints do under dry friction: the minimum of (w - f)' M (w - f) / 2 + b1 |w1| + b2 |w2|.

    M is the inertia matrix, g = M f the momentum (or load) the joints would have without friction, and b bounds
    the friction impulse (or torque) of each joint. Returns the velocity (or acceleration) w, where a joint that sticks has
    exactly zero, and the friction g - M w. The problem is strictly convex, so just one of its nine cases fits:
    both stick, one sticks while the other slides either way, or both slide.
    """
    # One joint at rest, the other sliding: the slider's momentum, shrunk by its friction.
    slide_1 = _shrink(g1, b1) / m11
    slide_2 = _shrink(g2, b2) / m22
    second_rests = abs(g2 - m12 * slide_1) <= b2
    first_rests = abs(g1 - m12 * slide_2) <= b1
    both_rest = (abs(g1) <= b1) & (abs(g2) <= b2)
    # Both sliding: the free velocity less the effect of both frictions, with the signs that agree with the outcome.
    scale = 1.0 / (m11 * m22 - m12 * m12)
    f1 = (m22 * g1 - m12 * g2) * scale
    f2 = (m11 * g2 - m12 * g1) * scale
    e11, e12, e21, e22 = m22 * b1 * scale, -m12 * b2 * scale, -m12 * b1 * scale, m11 * b2 * scale
    w1, w2 = f1 - e11 - e12, f2 - e21 - e22
    x1, x2 = f1 - e11 + e12, f2 - e21 + e22
    fits = (x1 > 0.0) & (x2 < 0.0)
    w1, w2 = x1 if fits else w1, x2 if fits else w2
    x1, x2 = f1 + e11 - e12, f2 + e21 - e22
    fits = (x1 < 0.0) & (x2 > 0.0)
    w1, w2 = x1 if fits else w1, x2 if fits else w2
    x1, x2 = f1 + e11 + e12, f2 + e21 + e22
    fits = (x1 < 0.0) & (x2 < 0.0)
    w1, w2 = x1 if fits else w1, x2 if fits else w2
    w1 = slide_1 if second_rests else w1
    w2 = 0.0 if second_rests else w2
    w1 = 0.0 if first_rests else w1
    w2 = slide_2 if first_rests else w2
    w1 = 0.0 if both_rest else w1
    w2 = 0.0 if both_rest else w2
    return w1, w2, g1 - m11 * w1 - m12 * w2, g2 - m12 * w1 - m22 * w2
