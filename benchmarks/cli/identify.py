"""The command `fbl-gym identify`: from the logs of a robot to a scenario."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks.cli.common import command_line, write
from benchmarks.files import write_text
from benchmarks.identification import excitation, logs, result
from benchmarks.identification.fit import TERMS, Fit, identify, refuse_meaningless, rollout_errors, standing_still
from benchmarks.identification.model import INDEX, parameters_of, windows
from benchmarks.report.plot import COLORS, Line, Panel, plot_lines
from benchmarks.report.terminal import Screen, show
from benchmarks.run.traces import write_columns
from benchmarks.text import say
from fbl_gym import scenarios
from fbl_gym.model.arm import Array
from fbl_gym.scenarios.files import split

#: Lengths of the rollouts of `--validate` [s].
HORIZONS = (0.1, 0.5, 1.0)
#: Errors of a log's zeros above that are printed [rad].
NOTABLE = 0.03


def run(arguments: argparse.Namespace) -> int:
    """Plan, identify and validate, as the arguments ask."""
    if arguments.plan is None and not arguments.logs and not arguments.validate:
        raise ValueError("give the logs of a robot, or --validate, or --plan")
    start, file = scenarios.get(arguments.start), split(arguments.start)[0]
    for path in filter(None, (arguments.toml, arguments.plan and arguments.plan.with_suffix(".toml"))):
        if file and path.resolve() == Path(file).resolve():
            raise ValueError(f"{path} is --start, which would be lost: give another name")
    if any(option is not None for option in (start.joint, start.link, start.plant)):
        raise ValueError(f"--start must have rigid joints and links, and this package's physics, got {arguments.start}")
    if arguments.plan is not None:
        _plan(arguments, start)
    read = partial(logs.read, mapping=logs.columns(arguments.signals), zero=arguments.zero)
    runs, judged = [read(path) for path in arguments.logs], [read(path) for path in arguments.validate]
    for log in (*runs, *judged):
        say(f"{log.name}: " + "\n    ".join(log.remarks))
    logs.refuse_twice(runs)
    parameters = parameters_of(start)
    if runs:
        with Progress(console=Screen(stderr=True)) as progress:
            task = progress.add_task("reading", total=len(TERMS) + 3)
            fit = identify(runs, start, lambda text: progress.update(task, advance=1, description=text))
        parameters = fit.parameters
        _print(fit)
        for log, zero in zip(runs, fit.zero, strict=True):
            if np.abs(zero).max() > NOTABLE:
                say(f"{log.name}: its zeros are off by {zero[0]:.4f} and {zero[1]:.4f} rad, to be added to --zero")
        refuse_meaningless(fit, start, [log.name for log in runs])
        if arguments.toml is not None:
            base = result.reached(arguments.start, arguments.toml)
            write_text(arguments.toml, result.text(fit, runs, start, base, command_line()))
            scenarios.get(str(arguments.toml))
            say(f"scenario: {arguments.toml}")
    if judged:
        _validate(arguments, judged, parameters, parameters_of(start))
    return 0


def _print(fit: Fit) -> None:
    rows = [
        (name, f"{value:.4g}", f"{low:.4g} - {high:.4g}", f"needs {fit.weak[name]}" if name in fit.weak else "")
        for name, value, (low, high) in fit.estimates()
    ]
    show("identified arm", ("number", "estimate", "90 % interval", "hardly told by these logs"), rows, "left")
    trials = []
    for term, ratio in fit.trials.items():
        kept = " and ".join(f"{fit.parameters[INDEX[name]]:.3g}" for name in TERMS[term])
        verdict = "stays" if TERMS[term][0] in fit.free else f"left out: {kept} in the scenario"
        trials.append(f"{term} {100 * ratio - 100:+.0f} % ({verdict})")
    say(f"error on windows that were not fitted, with each term: {', '.join(trials)}")
    say(f"Not identifiable by any motion: the first rotor apart from p1. {result.scale_of(fit)}.")
    errors = [(model, _errors(each)) for model, each in fit.errors.items()]
    show("error after 0.5 s on these logs, joints 1 and 2: RMS (median) [mrad]", ("model", "error"), errors)


def _errors(errors: Array) -> str:
    """Return RMS and median of the errors of both joints [n x 2], in mrad."""
    rms, median = 1e3 * np.sqrt((errors**2).mean(axis=0)), 1e3 * np.median(np.abs(errors), axis=0)
    return f"{rms[0]:.0f} {rms[1]:.0f} ({median[0]:.0f} {median[1]:.0f})"


def _validate(arguments: argparse.Namespace, judged: list[logs.Log], parameters: Array, start: Array) -> None:
    """Print the errors of open-loop rollouts, and draw those of the first log."""
    models: dict[str, Callable[[logs.Log, float], Array]] = {
        "this model": lambda log, length: rollout_errors(log, parameters, length)[0],
        "this model, zeros as given": lambda log, length: rollout_errors(log, parameters, length, zeros=False)[0],
        "starting model": lambda log, length: rollout_errors(log, start, length)[0],
        "standing still": lambda log, length: standing_still(windows([log], length)),
    }
    rows = [
        (log.name, name, *(_errors(errors(log, length)) for length in HORIZONS))
        for log in judged for name, errors in models.items()
    ]  # fmt: skip
    header = ("log", "model", *(f"after {length:g} s" for length in HORIZONS))
    show("open-loop error, joints 1 and 2: RMS (median) [mrad]", header, rows)
    say("Windows start each 0.25 s in the measured state.")
    say("A log's zeros are estimated from its windows that ended before.")
    draw = partial(plot_lines, f"Rollouts of 0.5 s on {judged[0].name}", width=arguments.width)
    write(arguments.plot, "plot", lambda path: draw(_rollouts(judged[0], parameters), path))


def _rollouts(log: logs.Log, parameters: Array) -> list[Panel]:
    """Return measured and simulated angles of both joints, and their differences."""
    _, data, simulated = rollout_errors(log, parameters, 0.5)
    # Windows that do not overlap; a NaN ends the line of each.
    x = (data.time[::2, None] + np.append(data.keep * data.dt, np.nan)).ravel()
    both = np.pad([simulated[::2], data.measured[::2]], ((0, 0), (0, 0), (0, 1), (0, 0)), constant_values=np.nan)
    y, z = both.reshape(2, -1, 2).swapaxes(1, 2)
    time = np.linspace(0.0, log.dt * (len(log.position) - 1), len(log.position))
    panels = []
    for j in (0, 1):
        lines = Line(x, y[j], "simulated", COLORS[1], "-"), Line(time, log.position[:, j], "measured", "black", ":")
        panels.append(Panel(f"joint {j + 1}", "time [s]", "angle [rad]", lines))
    for residual in 1e3 * (y - z):
        panels.append(Panel("", "time [s]", "residual [mrad]", (Line(x, residual, "_", COLORS[0], "-"),)))
    return panels


def _plan(arguments: argparse.Namespace, start: scenarios.Scenario) -> None:
    """Write an exciting motion as CSV and as a scenario."""
    hanging = (-np.pi / 2, 0.0) if start.arm.gravity > 0 else (0.0, 0.0)
    motion, condition = excitation.plan(start, hanging, arguments.amplitude, arguments.speed)
    columns = {"time_s": motion["time"]}
    for name, unit in (("position", "rad"), ("velocity", "rad_s"), ("acceleration", "rad_s2"), ("torque", "Nm")):
        columns |= {f"{name}_{j + 1}_{unit}": motion[name][:, j] for j in (0, 1)}
    write_columns(arguments.plan, columns)
    path, every = arguments.plan.with_suffix(".toml"), max(1, round(0.02 / start.control_dt))
    points = ", ".join(f"[{q1:.5f}, {q2:.5f}]" for q1, q2 in motion["position"][::every])
    write_text(
        path,
        f'base = "{result.reached(arguments.start, path)}"\ndescription = "a motion that excites the arm"\n'
        f"duration = {motion['time'][-1]:g}\n"
        f'reference = {{ kind = "array", dt = {every * start.control_dt:g}, position = [{points}] }}\n',
    )
    scenarios.get(str(path))
    peak = np.abs(motion["torque"]).max(axis=0)
    say(f"plan: {arguments.plan} and {path}, condition number {condition:.0f}, torques up to {peak.round(3)} N m")
