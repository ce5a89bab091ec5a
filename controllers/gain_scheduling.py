"""Soft gain scheduling against stiction, equation (46) of the paper."""

from __future__ import annotations

import numpy as np

from fbl_gym.arm import Array


def schedule(velocity: Array, alpha: Array, v_s: float) -> Array:
    """GS_i = alpha_i1 exp(-v_1^2 / v_s) + alpha_i2 exp(-v_2^2 / v_s) + 1, the factor on each inner loop.  [n x 2].

    It is large where joints hardly move, which is where stiction acts, and fades to 1 with speed. Velocity noise shrinks it.

    Args:
        velocity: [n x 2] rad/s.
        alpha: [2 x 2], alpha_ij.
        v_s: [(rad/s)^2], the velocity scale.
    """
    near_rest = np.exp(-(velocity**2) / v_s)
    return 1.0 + near_rest @ np.asarray(alpha).T
