"""The scenario of an identified arm, as a TOML file whose numbers are distributions."""

import os
from collections.abc import Sequence
from pathlib import Path
from statistics import mode

import numpy as np

from benchmarks.identification.fit import Fit
from benchmarks.identification.logs import Log
from benchmarks.identification.model import INDEX, V_S, arm_of
from fbl_gym.scenarios import Scenario

MAX_RADIUS = 1.0  # largest radius of masses; beyond it, a number is not identified


def scale_of(fit: Fit) -> str:
    """Return a sentence on what fixes the scale of an arm."""
    known = 1 if 2 in fit.passive else 2
    unknown = "".join(f"; gain {joint} is unknown, since joint {joint} has no torque" for joint in fit.passive)
    return f"Masses, friction and gains share one scale, which gain {known} fixes{unknown}"


def text(fit: Fit, logs: Sequence[Log], start: Scenario, base: str, command: str) -> str:
    """Return the TOML file of an identified arm.

    Friction, gain, delay and lag are uniform over their 90 % intervals. A radius of both masses
    stands for the lumped parameters: it is as wide as the widest of their intervals. The bias of
    the positions stands for the zeros of the logs.

    Args:
        fit: of the arm.
        logs: of the fit.
        start: its start.
        base: name or file of `start`, as the new file reaches it.
        command: for the file's first line.
    """
    control = round(logs[0].sample, 4 if logs[0].sample > 1e-3 else 5)
    steps = int(np.ceil(control / start.physics_dt - 1e-9))
    zero = np.sqrt(3.0) * np.sqrt((fit.zero**2).mean(axis=0))
    arm = vars(arm_of(fit.parameters, start.arm)).items()
    fields = "\n".join(f"{name} = {list(value) if isinstance(value, tuple) else value}" for name, value in arm)
    return f"""# {command}
# Estimates with 90 % intervals; inertias in kg m^2, torques in N m, times in s. p1 includes rotor 1, from
# which no motion tells it apart. {scale_of(fit)}.
{_estimates(fit)}
base = "{base}"
description = "identified from {len(logs)} log{"s" * (len(logs) > 1)}: {fit.parameters[0]:.3g} kg m^2 about joint 1"
control_dt = {control:g}
physics_dt = {control / steps!r}
duration = {round(start.duration / control) * control:.10g}
# What the fit does not see apart from these numbers is none: a payload, errors of single links, friction under load.
parameter_error.radius = {_radius(fit):.4g}
parameter_error.parameters = ["m1", "m2"]
parameter_error.centre = 1.0
parameter_error.inertia = 1.0
parameter_error.rotor = 1.0
parameter_error.payload = false
noise.position.bias = [{", ".join(f"{{ uniform = [{-z:.4g}, {z:.4g}] }}" for z in zero)}]
{_sensors(logs, start)}

[friction]
coulomb = {_spread(fit, "coulomb 1", "coulomb 2")}
viscous = {_spread(fit, "viscous 1", "viscous 2")}
stiction = {_spread(fit, "stiction 1", "stiction 2")}
v_s = {V_S}
load = 0.0

[actuator]
gain = {_spread(fit, "gain 1", "gain 2")}
delay = {_spread(fit, "delay")}
lag = {_spread(fit, "lag")}
delay_samples = 0

[arm]
{fields}
"""


def _estimates(fit: Fit) -> str:
    """Return the comment lines with the estimates and their intervals."""
    return "\n".join(
        f"# {name:10} {value:.4g} [{low:.4g}, {high:.4g}]"
        + (f", hardly told by these logs: needs {fit.weak[name]}" if name in fit.weak else "")
        for name, value, (low, high) in fit.estimates()
    )


def _radius(fit: Fit) -> float:
    """Return the radius of the masses, by the widest interval of a lumped parameter."""
    lumped = [INDEX[name] for name in fit.free if name[0] == "p"]
    middle, (low, high) = fit.parameters[lumped], fit.interval[lumped].T
    return float(min(np.maximum(middle / np.maximum(low, 1e-9), high / middle).max() - 1.0, MAX_RADIUS))


def _spread(fit: Fit, *names: str) -> str:
    """Return the interval of a number as a distribution, or a pair of them."""
    parts = [
        f"{{ uniform = [{low:.6g}, {high:.6g}] }}" if high > low else f"{fit.parameters[INDEX[name]]:.6g}"
        for name, (low, high) in ((name, fit.interval[INDEX[name]]) for name in names)
    ]
    return f"[{', '.join(parts)}]" if len(parts) > 1 else parts[0]


def _sensors(logs: Sequence[Log], start: Scenario) -> str:
    """Return three lines on the encoder; a line is empty where the logs do not tell."""
    counts, difference = np.median([log.counts for log in logs], axis=0), mode(log.difference for log in logs)
    encoder = [f"counts = [{counts[0]:.6g}, {counts[1]:.6g}]"] * bool((counts > 0).all())
    lines = ["noise.position.quantization = 0.0" if encoder else ""]
    encoder += [f"difference = {difference}"] * (difference > 0)
    lines.append("noise.velocity = false" if difference and start.noise is not None else "")
    return "\n".join([*lines, f"encoder = {{ {', '.join(encoder)} }}" if encoder else ""])


def reached(base: str, path: Path) -> str:
    """Return the text by which a file names the base of another: files relative to it."""
    return os.path.relpath(base, path.parent).replace(os.sep, "/") if base.endswith(".toml") else base
