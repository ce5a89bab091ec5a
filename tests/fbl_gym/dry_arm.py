"""An arm with dry friction, and its breakaway torques."""

import numpy as np

from fbl_gym import ArmParameters
from tests.fbl_gym.episodes import started

FLAT = ArmParameters(gravity=0.0)
STILL = {"kind": "minimum-jerk", "points": ((0.4, 0.7),)}
DRY = {"coulomb": (20.0, 8.0), "stiction": (10.0, 4.0), "v_s": 1e-3}
BREAKAWAY = np.array([30.0, 12.0])


def flat(**options):
    """Return an arm at rest without gravity; its load is the applied torque alone."""
    still = {"arm": FLAT, "action": "torque", "actuator": None, "reference": STILL, "friction": DRY}
    return started(**{**still, **options})
