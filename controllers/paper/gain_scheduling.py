"""Gain scheduling against stiction: equation (46) of the paper, and two other forms of it."""

import numpy as np

from fbl_gym.model.arm import Array

#: Forms of a schedule: (46), a switch, and linguistic rules.
FORMS = ("soft", "hard", "fuzzy")


def schedule(velocity: Array, alpha: Array, v_s: float, form: str = "soft") -> Array:
    """Return the factor on each inner loop [n x 2].

        GS_i = alpha_i1 m(v_1) + alpha_i2 m(v_2) + 1

        soft    m(v) = exp(-v^2 / v_s), equation (46)
        hard    m(v) = 1 if v^2 < v_s, else 0
        fuzzy   1, exp(-1) and 0 for the speeds abs(v) / sqrt(v_s) zero, small and large

    The velocity v is [n x 2] rad/s, alpha [2 x 2], and v_s in (rad/s)^2; the form is one of
    `FORMS`. The factor is large where joints hardly move and stiction acts, and goes to 1 with
    speed. Velocity noise makes it smaller. The fuzzy rules have triangular memberships around the
    speeds 0, 1 and 2, and are averaged by them (Takagi and Sugeno, IEEE Trans. SMC 15:116, 1985).
    """
    if form == "fuzzy":
        speed = np.abs(velocity) / np.sqrt(v_s)
        zero, small = np.maximum(1.0 - speed, 0.0), np.maximum(1.0 - np.abs(speed - 1.0), 0.0)
        large = np.clip(speed - 1.0, 0.0, 1.0)
        near_rest = (zero + np.exp(-1.0) * small) / (zero + small + large)
    else:
        near_rest = np.exp(-(velocity**2) / v_s) if form == "soft" else (velocity**2 < v_s).astype(float)
    return 1.0 + near_rest @ np.asarray(alpha).T
