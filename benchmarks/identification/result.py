"""The scenario of an identified arm, as a TOML file whose numbers are distributions."""

import os
from collections.abc import Sequence
from pathlib import Path
from statistics import mode
from string import Template

import numpy as np

from benchmarks.identification.fit import Fit
from benchmarks.identification.logs import Log
from benchmarks.identification.model import INDEX, PARAMETERS, V_S, arm_of
from fbl_gym.scenarios import Scenario
from fbl_gym.scenarios.files import split

TEMPLATE = Template(Path(__file__).with_name("scenario.template").read_text(encoding="utf-8"))
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
    control = float(f"{logs[0].sample:.3g}")
    zero = np.sqrt(3.0) * np.sqrt((fit.zero**2).mean(axis=0))
    arm = vars(arm_of(fit.parameters, start.arm)).items()
    lines = [
        f"# {name:10} {value:.4g} [{low:.4g}, {high:.4g}]"
        + (f", hardly told by these logs: needs {fit.weak[name]}" if name in fit.weak else "")
        for name, value, (low, high) in fit.estimates()
    ]
    names = {
        name.split()[0]: [each for each in PARAMETERS if each.split()[0] == name.split()[0]] for name in PARAMETERS
    }
    return TEMPLATE.substitute(
        {name: _spread(fit, *each) for name, each in names.items()}, v_s=V_S, radius=f"{_radius(fit):.4g}",
        command=command, scale=scale_of(fit), estimates="\n".join(lines), base=base,
        logs=f"{len(logs)} log{'s' * (len(logs) > 1)}", inertia=f"{fit.parameters[0]:.3g}", control_dt=f"{control:g}",
        physics_dt=control / int(np.ceil(control / start.physics_dt - 1e-9)),
        duration=f"{round(start.duration / control) * control:.10g}", sensors=_sensors(logs, start),
        zeros=", ".join(f"{{ uniform = [{-z:.4g}, {z:.4g}] }}" for z in zero),
        arm="\n".join(f"{name} = {list(value) if isinstance(value, tuple) else value}" for name, value in arm),
    )  # fmt: skip


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
    file, entry, _ = split(base)
    return os.path.relpath(file, path.parent).replace(os.sep, "/") + f":{entry}" * bool(entry) if file else base
