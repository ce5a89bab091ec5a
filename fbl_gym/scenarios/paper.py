"""The scenarios of the paper's figures.

The paper omits many values. The description of each scenario names those that the project chose.
"""

import dataclasses
from typing import Any

from fbl_gym.model.arm import SECTION_2_2, ArmParameters
from fbl_gym.options import Actuator, Friction, Noise, PiecewiseConstantDisturbance
from fbl_gym.options.references import FilteredSteps, FourierReference, Steps
from fbl_gym.scenarios.scenario import Scenario

_HALF = ArmParameters(m1=0.35, m2=0.25, L1=10.0, L2=7.5)  # the estimates of figure 3b, half of §2.2's real arm
_LEVELS = ((0.0, 0.0), (1.0, 0.5), (0.2, 1.0), (0.8, -0.5), (0.0, 0.5), (1.0, 0.0))
_STEPS = FilteredSteps(points=_LEVELS, period=2.0, bandwidth=8.0)
_EXCITING = FourierReference(centre=(0.0, 0.0), frequency=0.2)
_STICTION = Friction(coulomb=(10.0, 5.0), stiction=(30.0, 15.0), v_s=1e-3)
_ROBUST: dict[str, Any] = {
    "arm": _HALF,
    "parameter_error": 2.0,
    "noise": Noise(position=0.01, velocity=0.01, acceleration=0.01),
    "disturbance": PiecewiseConstantDisturbance(amplitude=(50.0, 20.0), period=0.5),
    "reference": _STEPS,
}
_ROBUST_TEXT = (
    "§3.2: estimates at half the real values, sensor noise, piecewise-constant disturbance. Project's choice: "
    "sigma = 0.01 per 1 ms sample on every sensor, 50 and 20 N m every 0.5 s, steps behind a filter of 8 rad/s"
)
_ESTIMATION_TEXT = "no friction, no noise. Project's choice: exciting Fourier reference of 1 rad, no torque limit"


def _figure(name: str, description: str, **options: Any) -> Scenario:
    """Return the scenario of a figure: 1 kHz and no torque limit, unless its options differ."""
    usual: dict[str, Any] = {"actuator": Actuator(torque_limit=None), "control_dt": 1e-3, "physics_dt": 1e-3}
    return Scenario(name=name, description=description, **usual | options)


_FIGURES = (
    _figure(
        "paper-3a",
        "figure 3a: §2.2's arm as printed, perfect model. Project's choice: literal steps of up to 1.5 rad every "
        "4 s, 1 kHz, no torque limit",
        arm=SECTION_2_2, reference=Steps(points=_LEVELS, period=4.0), duration=20.0,
    ),
    _figure(
        "paper-3b", "figure 3b: as 3a, with every estimate at half the real value",
        arm=_HALF, parameter_error=2.0, reference=Steps(points=_LEVELS, period=4.0), duration=20.0,
    ),
    _figure("paper-4a", "figure 4a, without the Kalman filter. " + _ROBUST_TEXT, **_ROBUST),
    _figure("paper-4b", "figure 4b, with the Kalman filter. " + _ROBUST_TEXT, **_ROBUST),
    _figure(
        "paper-6a", f"figure 6a: every parameter ten times its estimate, {_ESTIMATION_TEXT}",
        parameter_error=10.0, reference=_EXCITING,
    ),
    _figure(
        "paper-6b", f"figure 6b: every parameter a tenth of its estimate, {_ESTIMATION_TEXT}, 10 kHz",
        parameter_error=0.1, reference=_EXCITING, control_dt=1e-4, physics_dt=1e-4, actuator=Actuator(),
    ),
    _figure(
        "paper-8",
        "figure 8: stiction that the model misses. Project's choice: Coulomb 10 and 5, stiction 30 and 15 N m, "
        "v_s = 1e-3 (rad/s)^2",
        friction=_STICTION, reference=_STEPS,
    ),
    _figure(
        "paper-10",
        "figure 10: every parameter ten times its estimate, stiction as in figure 8 by the printed formula, and a "
        "piecewise-constant disturbance. Project's choice: 200 and 100 N m every 2 s, steps behind a filter of 8 rad/s",
        parameter_error=10.0, friction=dataclasses.replace(_STICTION, law="literal"),
        disturbance=PiecewiseConstantDisturbance(amplitude=(200.0, 100.0), period=2.0), reference=_STEPS,
    ),
)  # fmt: skip

FIGURES = {scenario.name: scenario for scenario in _FIGURES}
"""The scenario of each figure, by name."""
