"""The energy of an arm, which friction and torques change alone."""

import numpy as np

from fbl_gym.model.arm import _joints, _lumped, inertia_terms


def energy(arm, q, v):
    """Return the kinetic and potential energy [J], [...]; zero for a horizontal arm at rest."""
    p1, p2, p3, p4, p5, r1, r2 = _lumped(arm)
    (q1, q2), (v1, v2) = _joints(q), _joints(v)
    m11, m12, m22 = inertia_terms(p1, p2, p3, r1, r2, np.cos(q2))
    kinetic = 0.5 * (m11 * v1 * v1 + 2.0 * m12 * v1 * v2 + m22 * v2 * v2)
    return kinetic + p4 * np.sin(q1) + p5 * np.sin(q1 + q2)
