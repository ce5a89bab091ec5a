"""Soft gain scheduling against stiction, equation (46) of the paper."""

from __future__ import annotations

import numpy as np

from fbl_gym.arm import Array


def schedule(velocity: Array, alpha: Array, v_s: float) -> Array:
    """Return the factor on each inner loop [n x 2].

        GS_i = alpha_i1 exp(-v_1^2 / v_s) + alpha_i2 exp(-v_2^2 / v_s) + 1

    The velocity v is [n x 2] rad/s, alpha [2 x 2], and v_s in (rad/s)^2. The factor is large where
    joints hardly move and stiction acts, and goes to 1 with speed. Velocity noise makes it smaller.
    """
    near_rest = np.exp(-(velocity**2) / v_s)
    return 1.0 + near_rest @ np.asarray(alpha).T
