"""The dynamics of an arm whose links bend: a chain of four rigid segments.

Each link has a passive hinge near its root, and each of its two segments has half of its mass. The
coordinates are the angles q of the joints and b of the hinges. With the segments' absolute angles
a = (q1, q1 + b1, q1 + b1 + q2, q1 + b1 + q2 + b2), the kinetic energy is a' H a / 2 with

    H_kk = J_k        H_kj = l_k f_j cos(a_k - a_j), k < j        U = g sum f_k sin a_k

J_k is the moment of inertia and f_k the first moment of mass about the segment's root, each with
all that hangs on its end as a point mass; l_k is the segment's length. The terms are the only copy,
as in `arm.py`: the kernel compiles them, and `chain_dynamics` applies them to arrays.
"""

from typing import Any

import numpy as np

from fbl_gym.model.arm import Array

HINGE = 0.15
"""Place of the hinge of a link that bends, as a fraction of its length, as in the pseudo-rigid-body
model of a beam (Howell, "Compliant Mechanisms", 2001, §5.1)."""


def segment_terms(m1, m2, L1, L2, centre, inertia, payload, reach, radius):
    """Return J [kg m^2] and f [kg m] of the four segments.

    The first arguments are fields of `ArmParameters`. Then come the payload's mass [kg], the
    distance of its centre from the second joint, and its radius of gyration [m]. Each half of a
    link has the centre and the radius of gyration of the whole link, so that straight links have
    the dynamics of `arm.py`.
    """
    e1, e2, half1, half2, tip = HINGE * L1, HINGE * L2, 0.5 * m1, 0.5 * m2, reach - HINGE * L2
    c1, c2 = centre[0] * L1, centre[1] * L2
    own1, own2 = half1 * inertia[0] * L1 * L1, half2 * inertia[1] * L2 * L2
    beyond1, beyond2, beyond3, l2 = half1 + m2 + payload, m2 + payload, half2 + payload, L1 - e1
    j1 = own1 + half1 * c1 * c1 + beyond1 * e1 * e1
    j2 = own1 + half1 * (c1 - e1) * (c1 - e1) + beyond2 * l2 * l2
    j3 = own2 + half2 * c2 * c2 + beyond3 * e2 * e2
    j4 = own2 + half2 * (c2 - e2) * (c2 - e2) + payload * (tip * tip + radius * radius)
    f1, f2 = half1 * c1 + beyond1 * e1, half1 * (c1 - e1) + beyond2 * l2
    f3, f4 = half2 * c2 + beyond3 * e2, half2 * (c2 - e2) + payload * tip
    return (j1, j2, j3, j4), (f1, f2, f3, f4)


def chain_inertia(inertia, moment, L1, L2, sines, cosines):
    """Return the inertia matrix, and the products l_k f_j sin(a_k - a_j) that the velocities meet.

    `inertia` and `moment` are J and f of the segments, L1 and L2 the lengths of the links [m],
    `sines` and `cosines` those of the segments' absolute angles.

    Returns:
        M11, M12, M22 of the joints; M_qb, row by row; those of the hinges; and the six products.
    """
    j1, j2, j3, j4 = inertia
    _, f2, f3, f4 = moment
    l1, l2, l3 = HINGE * L1, L1 - HINGE * L1, HINGE * L2
    (s1, s2, s3, s4), (c1, c2, c3, c4) = sines, cosines
    h12, h13, h14 = l1 * f2 * (c1 * c2 + s1 * s2), l1 * f3 * (c1 * c3 + s1 * s3), l1 * f4 * (c1 * c4 + s1 * s4)
    h23, h24, h34 = l2 * f3 * (c2 * c3 + s2 * s3), l2 * f4 * (c2 * c4 + s2 * s4), l3 * f4 * (c3 * c4 + s3 * s4)
    turns = (
        l1 * f2 * (s1 * c2 - c1 * s2), l1 * f3 * (s1 * c3 - c1 * s3), l1 * f4 * (s1 * c4 - c1 * s4),
        l2 * f3 * (s2 * c3 - c2 * s3), l2 * f4 * (s2 * c4 - c2 * s4), l3 * f4 * (s3 * c4 - c3 * s4),
    )  # fmt: skip
    # An angle turns all segments beyond it: its entries are sums of H over them.
    m_22, m_21 = j4 + h34, h24 + h14  # of joint 2 and hinge 2; of both with the segments before
    m22 = j3 + h34 + m_22
    b12, m12 = h23 + h24 + m22, h13 + h14
    d12, a12 = m_22 + h24, m_22 + m_21
    d11 = j2 + h23 + h24 + b12
    b11 = d11 + h12 + m12
    return (j1 + h12 + m12 + b11, b12 + m12, m22), (b11, a12, b12, m_22), (d11, d12, j4), turns


def chain_load(moment, gravity, turns, cosines, rates):
    """Return the torques that gravity and velocities leave to accelerate q1, b1, q2, b2 [N m].

    Args:
        moment: f of the segments.
        gravity: [m/s^2].
        turns: the products of `chain_inertia`.
        cosines: of the segments' absolute angles.
        rates: absolute angular velocities of the segments [rad/s].
    """
    t12, t13, t14, t23, t24, t34 = turns
    (w1, w2, w3, w4), (c1, c2, c3, c4), (f1, f2, f3, f4) = rates, cosines, moment
    w1, w2, w3, w4 = w1 * w1, w2 * w2, w3 * w3, w4 * w4
    load4 = t14 * w1 + t24 * w2 + t34 * w3 - gravity * f4 * c4
    load3 = load4 + t13 * w1 + t23 * w2 - t34 * w4 - gravity * f3 * c3
    load2 = load3 + t12 * w1 - t23 * w3 - t24 * w4 - gravity * f2 * c2
    load1 = load2 - t12 * w2 - t13 * w3 - t14 * w4 - gravity * f1 * c1
    return load1, load2, load3, load4


def reduce_terms(joints, mixed, bends, load1, load2, bend1, bend2):
    """Take the hinges out of M (a_q, a_b) = load: return the inertia and load that the joints feel.

    The first three arguments are the parts of `chain_inertia`, the others the right-hand side, of
    joints and hinges [N m].

    Returns:
        M11, M12, M22 and the load of the joints (the Schur complement); and numbers with which
        `bend_terms` finds the hinges' acceleration.
    """
    (m11, m12, m22), (b11, b12, b21, b22), (d11, d12, d22) = joints, mixed, bends
    scale = 1.0 / (d11 * d22 - d12 * d12)
    x11, x21 = (d22 * b11 - d12 * b12) * scale, (d11 * b12 - d12 * b11) * scale  # of joint 1
    x12, x22 = (d22 * b21 - d12 * b22) * scale, (d11 * b22 - d12 * b21) * scale
    y1, y2 = (d22 * bend1 - d12 * bend2) * scale, (d11 * bend2 - d12 * bend1) * scale
    felt = m11 - b11 * x11 - b12 * x21, m12 - b11 * x12 - b12 * x22, m22 - b21 * x12 - b22 * x22
    left1, left2 = load1 - b11 * y1 - b12 * y2, load2 - b21 * y1 - b22 * y2
    return felt, (left1, left2), (x11, x12, x21, x22, y1, y2)


def bend_terms(rest, a1, a2):
    """Return the acceleration of the hinges when the joints accelerate by a1, a2 [rad/s^2]."""
    x11, x12, x21, x22, y1, y2 = rest
    return y1 - x11 * a1 - x12 * a2, y2 - x21 * a1 - x22 * a2


def chain_dynamics(
    segments: Any, lengths: Any, gravity: float, q: Array, b: Array, v: Array, u: Array
) -> tuple[Array, Array]:
    """Return inertia matrix and load of q1, q2, b1, b2, [... x 4 x 4] and [... x 4].

    Args:
        segments: J and f as of `segment_terms`, each four numbers or arrays [...].
        lengths: both links' likewise [m].
        gravity: [m/s^2].
        q: angles of the joints [... x 2] rad.
        b: of the hinges.
        v: velocities of the joints [... x 2] rad/s.
        u: of the hinges.
    """
    angles, rates = (
        np.cumsum(np.stack([x[..., 0], y[..., 0], x[..., 1], y[..., 1]]), axis=0) for x, y in ((q, b), (v, u))
    )
    (inertia, moment), (L1, L2), sines, cosines = segments, lengths, np.sin(angles), np.cos(angles)
    joints, mixed, bends, turns = chain_inertia(inertia, moment, L1, L2, sines, cosines)
    load1, bend1, load2, bend2 = chain_load(moment, gravity, turns, cosines, rates)
    (m11, m12, m22), (b11, b12, b21, b22), (d11, d12, d22) = joints, mixed, bends
    rows = (m11, m12, b11, b12), (m12, m22, b21, b22), (b11, b21, d11, d12), (b12, b22, d12, d22)
    matrix = [np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows]
    return np.stack(matrix, axis=-2), np.stack([load1, load2, bend1, bend2], axis=-1)
