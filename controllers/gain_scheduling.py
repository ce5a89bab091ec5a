"""Gain scheduling against stiction: equation (46) of the paper, and two other forms of it."""

import numpy as np

from fbl_gym.arm import Array

FORMS = ("soft", "hard", "fuzzy")
"""Forms of a schedule: (46), a switch, and linguistic rules."""


def schedule(velocity: Array, alpha: Array, v_s: float, form: str = "soft") -> Array:
    """Return the factor on each inner loop [n x 2].

        GS_i = alpha_i1 m(v_1) + alpha_i2 m(v_2) + 1

        soft    m(v) = exp(-v^2 / v_s), equation (46)
        hard    m(v) = 1 if v^2 < v_s, else 0
        fuzzy   the rules of `fuzzy_rest`

    The velocity v is [n x 2] rad/s, alpha [2 x 2], and v_s in (rad/s)^2; the form is one of
    `FORMS`. The factor is large where joints hardly move and stiction acts, and goes to 1 with
    speed. Velocity noise makes it smaller.
    """
    if form == "fuzzy":
        near_rest = fuzzy_rest(np.abs(velocity) / np.sqrt(v_s))
    else:
        near_rest = np.exp(-(velocity**2) / v_s) if form == "soft" else (velocity**2 < v_s).astype(float)
    return 1.0 + near_rest @ np.asarray(alpha).T


def fuzzy_rest(speed: Array) -> Array:
    """Return the raise of a gain by linguistic rules, between 0 and 1, [n x 2].

    Speeds are zero, small or large, with triangular memberships around 0, 1 and 2. If the speed is
    zero, the raise is full; if small, exp(-1); if large, none. The rules are averaged by their
    memberships (Takagi and Sugeno, IEEE Trans. SMC 15:116, 1985). The speed is [n x 2], in shares
    of sqrt(v_s).
    """
    zero, small = np.maximum(1.0 - speed, 0.0), np.maximum(1.0 - np.abs(speed - 1.0), 0.0)
    large = np.clip(speed - 1.0, 0.0, 1.0)
    return (zero + np.exp(-1.0) * small) / (zero + small + large)
