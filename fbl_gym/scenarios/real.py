"""Scenarios of arms that stand in laboratories, as their sources describe them.

Arms and sources of their numbers are in `fbl_gym/model/real_arms.py`. A number that could not be
verified in a public file is left out; `docs/reference/arms.md` lists these. References are moves
within 2 rad of hanging in 1 s, for which the nominal arms need at most two thirds of their torque
limits.
"""

import math
from typing import Any

from fbl_gym.model.real_arms import CICESE, DFKI_A0, DFKI_C1
from fbl_gym.options import Actuator, Friction, Limits, MinimumJerk, Noise, SensorError
from fbl_gym.scenarios.scenario import Scenario

_WIDE = MinimumJerk(low=(-math.pi / 2 - 2.0, -2.0), high=(-math.pi / 2 + 2.0, 2.0), move_time=1.0)

# Both designs: torque limit in model_parameters.yml. Position: the 16 bits of +-12.5 rad on the
# CAN bus (mini-cheetah-tmotor-python-can, commit 0ef9f89a, canmotorlib.py). Velocity noise: 0.053
# to 0.062 rad/s in data/experiment_records/design_A.0/20220812/noise. Speed at which the loop
# stops the arm: 20 rad/s (hardware_control_loop_tmotors.py).
_DFKI: dict[str, Any] = {
    "noise": Noise(position=SensorError(quantization=25.0 / 65535.0), velocity=0.057),
    "actuator": Actuator(torque_limit=10.0),
    "sensors": ("position", "velocity"),
    "physics_dt": 0.0005,
    "limits": Limits(velocity=20.0),
    "reference": _WIDE,
}


def _dfki_friction(cf1: float, cf2: float) -> Friction:
    """Return the friction of model_parameters.yml, b v + cf arctan(100 v): Coulomb is cf pi/2."""
    return Friction(viscous=0.001, coulomb=(cf1 * math.pi / 2, cf2 * math.pi / 2))


_SCENARIOS = (
    Scenario(
        "dfki-c1", "DFKI's double pendulum, design C.1, model 1.0: friction, torque limit, bus and noise of its files",
        arm=DFKI_C1, friction=_dfki_friction(0.16, 0.12), **_DFKI,
        control_dt=0.002,  # leaderboard/*/real_hardware_v2/exp_parameters.py
    ),
    Scenario(
        "dfki-a0", "DFKI's double pendulum, design A.0, model 2.0: friction, torque limit, bus and noise of its files",
        arm=DFKI_A0, friction=_dfki_friction(0.093, 0.078), **_DFKI,
        control_dt=0.0025,  # src/python/double_pendulum/experiments/design_A.0/tmotors_tvlqr.py
    ),
    Scenario(
        "cicese", "the direct-drive arm of CICESE and BUAP: viscous friction, torque limits and rate of its files",
        arm=CICESE, physics_dt=0.0005, sensors=("position", "velocity"), reference=_WIDE,
        friction=Friction(viscous=(2.288, 0.175)),  # robot2gdl.m
        actuator=Actuator(torque_limit=(150.0, 15.0)),  # Tercer_Informe/Matlab/alg_control.m
        control_dt=0.0025,  # the same file
    ),
)  # fmt: skip

REAL = {scenario.name: scenario for scenario in _SCENARIOS}
"""The scenario of each laboratory's arm, by name."""
