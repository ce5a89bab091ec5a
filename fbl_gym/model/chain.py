"""The dynamics of an arm whose links bend: a chain of four rigid segments.

Each link has a passive hinge near its root, and each of its two segments has half of its mass. The
derivation is in `docs/explanation/links-that-bend.md`, with the names of this file: the segments'
moments of inertia J and first moments of mass f, the inertia matrix M of the coordinates
(q1, b1, q2, b2), the angles q of the joints and b of the hinges. The terms are the only copy, as in
`arm.py`: the kernel compiles them, and `chain_dynamics` applies them to arrays.
"""

from typing import Any

import numpy as np

from fbl_gym.model.arm import Array

#: Place of the hinge of a link that bends, as a fraction of its length, as in the pseudo-rigid-body
#: model of a beam (Howell, "Compliant Mechanisms", 2001, §5.1).
HINGE = 0.15


def segment_terms(m1, m2, L1, L2, centre, inertia, payload, reach, radius):
    """Return J [kg m^2] and f [kg m] of the four segments.

    The first arguments are fields of `ArmParameters`. Then come the payload's mass [kg], the
    distance of its centre from the second joint, and its radius of gyration [m]. Each half of a
    link has the centre and the radius of gyration of the whole link, so that straight links have
    the dynamics of `arm.py`.
    """
    half1, half2, root1, root2 = 0.5 * m1, 0.5 * m2, HINGE * L1, HINGE * L2
    rest1, tip = L1 - root1, reach - root2
    centre1, centre2 = centre[0] * L1, centre[1] * L2
    own1, own2 = half1 * inertia[0] * L1 * L1, half2 * inertia[1] * L2 * L2
    end1, end2, end3 = half1 + m2 + payload, m2 + payload, half2 + payload  # masses on the segments' ends
    j1 = own1 + half1 * centre1 * centre1 + end1 * root1 * root1
    j2 = own1 + half1 * (centre1 - root1) * (centre1 - root1) + end2 * rest1 * rest1
    j3 = own2 + half2 * centre2 * centre2 + end3 * root2 * root2
    j4 = own2 + half2 * (centre2 - root2) * (centre2 - root2) + payload * (tip * tip + radius * radius)
    f1, f2 = half1 * centre1 + end1 * root1, half1 * (centre1 - root1) + end2 * rest1
    f3, f4 = half2 * centre2 + end3 * root2, half2 * (centre2 - root2) + payload * tip
    return (j1, j2, j3, j4), (f1, f2, f3, f4)


def chain_inertia(inertia, moment, L1, L2, sines, cosines):
    """Return the inertia matrix M, and the products T that the velocities meet.

    `inertia` and `moment` are J and f of the segments, L1 and L2 the lengths of the links [m],
    `sines` and `cosines` those of the segments' absolute angles.

    Returns:
        Mqq of the joints: M11, M13, M33; Mqb, row by row: M12, M14, M23, M34; Mbb of the hinges:
        M22, M24, M44; and T12, T13, T14, T23, T24, T34.
    """
    j1, j2, j3, j4 = inertia
    _, f2, f3, f4 = moment
    l1, l2, l3 = HINGE * L1, L1 - HINGE * L1, HINGE * L2
    (s1, s2, s3, s4), (c1, c2, c3, c4) = sines, cosines
    h12, h13, h14 = l1 * f2 * (c1 * c2 + s1 * s2), l1 * f3 * (c1 * c3 + s1 * s3), l1 * f4 * (c1 * c4 + s1 * s4)
    h23, h24, h34 = l2 * f3 * (c2 * c3 + s2 * s3), l2 * f4 * (c2 * c4 + s2 * s4), l3 * f4 * (c3 * c4 + s3 * s4)
    t12, t13, t14 = l1 * f2 * (s1 * c2 - c1 * s2), l1 * f3 * (s1 * c3 - c1 * s3), l1 * f4 * (s1 * c4 - c1 * s4)
    t23, t24, t34 = l2 * f3 * (s2 * c3 - c2 * s3), l2 * f4 * (s2 * c4 - c2 * s4), l3 * f4 * (s3 * c4 - c3 * s4)
    # An angle turns all segments beyond it: M_ij is the sum of H over the segments beyond both.
    m34 = j4 + h34
    m33 = j3 + h34 + m34
    m24 = m34 + h24
    m23 = h23 + h24 + m33
    m22 = j2 + h23 + h24 + m23
    m14 = m34 + (h24 + h14)
    m13 = m23 + (h13 + h14)
    m12 = m22 + h12 + (h13 + h14)
    m11 = j1 + h12 + (h13 + h14) + m12
    return (m11, m13, m33), (m12, m14, m23, m34), (m22, m24, j4), (t12, t13, t14, t23, t24, t34)


def chain_load(moment, gravity, products, cosines, rates):
    """Return the torques that gravity and velocities leave to accelerate q1, b1, q2, b2 [N m].

    Args:
        moment: f of the segments.
        gravity: [m/s^2].
        products: T of `chain_inertia`.
        cosines: of the segments' absolute angles.
        rates: absolute angular velocities of the segments [rad/s].
    """
    t12, t13, t14, t23, t24, t34 = products
    (w1, w2, w3, w4), (c1, c2, c3, c4), (f1, f2, f3, f4) = rates, cosines, moment
    w1, w2, w3, w4 = w1 * w1, w2 * w2, w3 * w3, w4 * w4
    # The load of an angle is that of the angle beyond it, and that of its own segment.
    load4 = t14 * w1 + t24 * w2 + t34 * w3 - gravity * f4 * c4
    load3 = load4 + t13 * w1 + t23 * w2 - t34 * w4 - gravity * f3 * c3
    load2 = load3 + t12 * w1 - t23 * w3 - t24 * w4 - gravity * f2 * c2
    load1 = load2 - t12 * w2 - t13 * w3 - t14 * w4 - gravity * f1 * c1
    return load1, load2, load3, load4


def reduce_terms(Mqq, Mqb, Mbb, load_q, load_b):
    """Take the hinges out of M (q'', b'') = load: return the inertia and load that the joints feel.

    The first three arguments are those of `chain_inertia`, the others the right-hand side, of
    joints and of hinges [N m].

    Returns:
        The Schur complement of Mbb, S11, S12, S22, and its load; then X and y, with which
        `bend_terms` finds the hinges' acceleration.
    """
    (m11, m13, m33), (m12, m14, m23, m34), (m22, m24, m44) = Mqq, Mqb, Mbb
    (load1, load3), (load2, load4) = load_q, load_b
    scale = 1.0 / (m22 * m44 - m24 * m24)
    # X = Mbb^-1 Mqb' and y = Mbb^-1 load_b
    x11, x21 = (m44 * m12 - m24 * m14) * scale, (m22 * m14 - m24 * m12) * scale
    x12, x22 = (m44 * m23 - m24 * m34) * scale, (m22 * m34 - m24 * m23) * scale
    y1, y2 = (m44 * load2 - m24 * load4) * scale, (m22 * load4 - m24 * load2) * scale
    # S = Mqq - Mqb X, and its load is load_q - Mqb y
    schur = m11 - m12 * x11 - m14 * x21, m13 - m12 * x12 - m14 * x22, m33 - m23 * x12 - m34 * x22
    return schur, (load1 - m12 * y1 - m14 * y2, load3 - m23 * y1 - m34 * y2), (x11, x12, x21, x22, y1, y2)


def bend_terms(eliminated, a1, a2):
    """Return the acceleration y - X a of the hinges when the joints accelerate by a [rad/s^2]."""
    x11, x12, x21, x22, y1, y2 = eliminated
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
    Mqq, Mqb, Mbb, products = chain_inertia(inertia, moment, L1, L2, sines, cosines)
    load1, load2, load3, load4 = chain_load(moment, gravity, products, cosines, rates)
    (m11, m13, m33), (m12, m14, m23, m34), (m22, m24, m44) = Mqq, Mqb, Mbb
    rows = (m11, m13, m12, m14), (m13, m33, m23, m34), (m12, m23, m22, m24), (m14, m34, m24, m44)
    matrix = [np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows]
    return np.stack(matrix, axis=-2), np.stack([load1, load3, load2, load4], axis=-1)
