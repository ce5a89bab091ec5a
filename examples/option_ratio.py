"""Print the error of five laws with an option, over that without it.

    python examples/option_ratio.py encoder.difference=3 actuator.lag=0.03

Each number is the geometric mean over 32 seeds. The arm has a sample of delay, a lag, encoders,
friction, uncertain parameters and a start beside its reference.
"""

import json
import sys

import numpy as np

from benchmarks.run.metrics import errors
from benchmarks.run.rollout import rollout
from fbl_gym import Scenario

BASE = {
    "actuator": {"delay_samples": 1, "lag": 0.01},
    "encoder": {"counts": 65536, "difference": 1},
    "parameter_error": {"radius": 0.25},
    "friction": {"viscous": (2, 1), "coulomb": (10, 10 / 3), "stiction": (10, 10 / 3)},
    "initial_error": {"uniform": [-0.02, 0.02]},
    "limits": {"error": 0.5},
}
LQG = {"integral": 9497, "position": 15.02, "velocity": 58.18, "position_sigma": 0.0001547}
LAWS = {
    "PD": ("pd-gravity", {"frequency": 5, "damping": 1}),
    "CT": ("computed-torque", {"frequency": 14}),
    "CF": ("cascade-flm", {"kp": 12, "velocity_p": 24, "velocity_i": 72}),
    "LQG": ("lqg", LQG),
    "SL": ("slotine-li", {"slope": 10, "damping": 15, "adaptation": 1, "friction": 0}),
}


def error(scenario, law, gains):
    """Return the mean error of each seed [rad]."""
    return errors(rollout(law, Scenario(**scenario), range(32), gains)).mean(axis=(0, 2))


base = {name: error(BASE, *law) for name, law in LAWS.items()}
print("base [mrad]:", {name: round(1e3 * float(np.exp(np.log(each).mean())), 2) for name, each in base.items()})
for option in sys.argv[1:]:
    path, _, text = option.partition("=")
    name, _, field = path.partition(".")
    value = json.loads(text)
    scenario = BASE | {name: BASE.get(name, {}) | {field: value} if field else value}
    ratios = {law: np.log(error(scenario, *LAWS[law]) / base[law]).mean() for law in LAWS}
    print(f"{option}:", {law: round(float(np.exp(ratio)), 2) for law, ratio in ratios.items()})
