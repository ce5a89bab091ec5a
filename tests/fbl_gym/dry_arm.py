"""An arm with dry friction: what holds it, and from which load on it moves."""

import numpy as np

from fbl_gym import ArmParameters, TwoLinkArmEnv

FLAT = ArmParameters(gravity=0.0)
STILL = {"kind": "minimum-jerk", "points": ((0.4, 0.7),)}
DRY = {"coulomb": (20.0, 8.0), "stiction": (10.0, 4.0), "v_s": 1e-3}
BREAKAWAY = np.array([30.0, 12.0])


def flat(**options):
    """An arm without gravity, at rest, under torques: a static load is just what one applies."""
    return TwoLinkArmEnv(arm=FLAT, action="torque", actuator=None, reference=STILL, friction=DRY, **options)
