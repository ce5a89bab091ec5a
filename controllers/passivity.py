"""Regressors: torques linear in five lumped parameters p, or in four parameters of friction."""

from __future__ import annotations

import numpy as np

from fbl_gym.arm import Array


def slotine_li_regressor(q: Array, v: Array, v_r: Array, a_r: Array) -> Array:
    """Return Y [n x 2 x 5] with Y p = M(q) a_r + C(q, v) v_r + G(q).

    v_r and a_r are velocity and acceleration of the reference motion. C is that of the Christoffel
    symbols. Slotine and Li, "Applied Nonlinear Control", 1991, §9.2. With v_r = v and a_r = a it is
    `arm.regressor`.
    """
    c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
    c1, c12 = np.cos(q[:, 0]), np.cos(q[:, 0] + q[:, 1])
    both, none = a_r[:, 0] + a_r[:, 1], np.zeros(len(q))
    # C v_r of the Christoffel symbols, over p3: (-s2 (v2 vr1 + (v1 + v2) vr2), s2 v1 vr1).
    first = c2 * (a_r[:, 0] + both) - s2 * (v[:, 1] * v_r[:, 0] + (v[:, 0] + v[:, 1]) * v_r[:, 1])
    second = c2 * a_r[:, 0] + s2 * v[:, 0] * v_r[:, 0]
    rows = ((a_r[:, 0], both, first, c1, c12), (none, both, second, none, c12))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def momentum_regressor(q: Array, v: Array) -> Array:
    """Return Y [n x 2 x 5] with Y p = M(q) v."""
    c2, both, none = np.cos(q[:, 1]), v[:, 0] + v[:, 1], np.zeros(len(q))
    rows = ((v[:, 0], both, c2 * (v[:, 0] + both), none, none), (none, both, c2 * v[:, 0], none, none))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def drift_regressor(q: Array, v: Array) -> Array:
    """Return Y [n x 2 x 5] with Y p = G(q) - C'(q, v) v, so torque = d/dt (M v) + Y p."""
    c1, c12, none = np.cos(q[:, 0]), np.cos(q[:, 0] + q[:, 1]), np.zeros(len(q))
    rows = ((none, none, none, c1, c12), (none, none, np.sin(q[:, 1]) * v[:, 0] * (v[:, 0] + v[:, 1]), none, c12))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def friction_regressor(v: Array, turn: float) -> Array:
    """Return Y [n x 2 x 4] with Y p = viscous friction v + Coulomb friction tanh(v / turn).

    p has both joints' viscous friction, then both joints' Coulomb friction.
    """
    return np.concatenate([v[..., None] * np.eye(2), np.tanh(v / turn)[..., None] * np.eye(2)], axis=-1)
