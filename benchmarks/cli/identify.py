"""The command `fbl-gym identify`: from the logs of a robot to a scenario."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks.cli.common import add_file, add_option, add_plot, command_line
from benchmarks.files import write_text
from benchmarks.identification import excitation, logs, result
from benchmarks.identification.fit import TERMS, Fit, identify, refuse_meaningless, rollout_errors, standing_still
from benchmarks.identification.model import INDEX, parameters_of, windows
from benchmarks.report.plot import Line, Panel, plot_lines
from benchmarks.report.terminal import Screen, table
from benchmarks.run.traces import write_columns
from fbl_gym import scenarios
from fbl_gym.model.arm import Array

HORIZONS = (0.1, 0.5, 1.0)
"""Lengths of the rollouts of `--validate` [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "logs", nargs="*", type=Path, metavar="LOG", help="tables of one arm: text, perhaps .gz, .mat or .parquet"
    )
    meaning = "a similar arm with the true lengths: a name or a TOML file"
    add_option(parser, "--start", str, "servo-nominal", "SCENARIO", meaning)
    add = parser.add_argument
    add_file(parser, "--toml", "write the scenario of the identified arm", ".toml")
    columns = (
        "columns, units and signs of time, position, torque (commanded) and velocity: position=deg torque=-u1,0.1*i2"
    )
    add("--signals", nargs="+", default=(), metavar="SIGNAL=COLUMNS", help=columns)
    zero = "angles of this package where the logs' positions are zero, in rad; -1.5708 0 if they count from hanging"
    add("--zero", nargs=2, type=float, default=(0.0, 0.0), metavar=("Q1", "Q2"), help=zero)
    add("--validate", nargs="+", type=Path, default=(), metavar="LOG", help="logs on which to simulate it, open loop")
    add_plot(parser, "the first log of --validate: measured, simulated, residual")
    add_file(parser, "--plan", "plan a motion that excites the arm, with its scenario beside it", ".csv")
    distance = "largest distance of the planned motion from hanging, in rad (1 1)"
    add("--amplitude", nargs=2, type=float, default=(1.0, 1.0), metavar=("A1", "A2"), help=distance)
    add_option(parser, "--speed", float, 5.0, "V", "its largest velocity, in rad/s")


def run(arguments: argparse.Namespace) -> int:
    """Plan, identify and validate, as the arguments ask."""
    if arguments.plan is None and not arguments.logs and not arguments.validate:
        raise ValueError("give the logs of a robot, or --validate, or --plan")
    screen, start = Screen(), scenarios.get(arguments.start)
    if any(option is not None for option in (start.joint, start.link, start.plant)):
        raise ValueError(f"--start must have rigid joints and links, and this package's physics, got {arguments.start}")
    if arguments.plan is not None:
        _plan(arguments, start, screen)
    read = partial(logs.read, mapping=logs.columns(arguments.signals), zero=arguments.zero)
    runs, judged = [read(path) for path in arguments.logs], [read(path) for path in arguments.validate]
    for log in (*runs, *judged):
        screen.say(f"{log.name}: " + "\n    ".join(log.remarks))
    logs.refuse_twice(runs)
    parameters = parameters_of(start)
    if runs:
        with Progress(console=Screen(stderr=True)) as progress:
            task = progress.add_task("reading", total=len(TERMS) + 3)
            fit = identify(runs, start, lambda text: progress.update(task, advance=1, description=text))
        parameters = fit.parameters
        _print(fit, screen)
        refuse_meaningless(fit, start, [log.name for log in runs])
        if arguments.toml is not None:
            base = result.reached(arguments.start, arguments.toml)
            write_text(arguments.toml, result.text(fit, runs, start, base, command_line()))
            scenarios.get(str(arguments.toml))
            screen.say(f"scenario: {arguments.toml}")
    if judged:
        _validate(arguments, judged, parameters, parameters_of(start), screen)
    return 0


def _print(fit: Fit, screen: Screen) -> None:
    rows = [
        (name, f"{value:.4g}", f"{low:.4g} - {high:.4g}", f"needs {fit.weak[name]}" if name in fit.weak else "")
        for name, value, (low, high) in fit.estimates()
    ]
    header = ("number", "estimate", "90 % interval", "hardly told by these logs")
    screen.print(table("identified arm", header, rows, "left"))
    trials = ", ".join(
        f"{term} {100 * ratio - 100:+.0f} % ({'stays' if TERMS[term][0] in fit.free else _kept(fit, term)})"
        for term, ratio in fit.trials.items()
    )
    screen.say(f"error on windows that were not fitted, with each term: {trials}")
    screen.say(f"Not identifiable by any motion: the first rotor apart from p1. {result.scale_of(fit)}.")
    ends = [(model, _errors(errors)) for model, errors in fit.errors.items()]
    title = "error after 0.5 s on these logs, joints 1 and 2: RMS (median) [mrad]"
    screen.print(table(title, ("model", "error"), ends))


def _kept(fit: Fit, term: str) -> str:
    numbers = " and ".join(f"{fit.parameters[INDEX[name]]:.3g}" for name in TERMS[term])
    return f"left out: the scenario keeps the start's {numbers}"


def _errors(errors: Array) -> str:
    """Return RMS and median of the errors of both joints [n x 2], in mrad."""
    rms, median = 1e3 * np.sqrt((errors**2).mean(axis=0)), 1e3 * np.median(np.abs(errors), axis=0)
    return f"{rms[0]:.0f} {rms[1]:.0f} ({median[0]:.0f} {median[1]:.0f})"


def _validate(
    arguments: argparse.Namespace, judged: list[logs.Log], parameters: Array, start: Array, screen: Screen
) -> None:
    """Print the errors of open-loop rollouts, and draw those of the first log."""
    models: dict[str, Callable[[logs.Log, float], Array]] = {
        "this model": lambda log, length: rollout_errors(log, parameters, length)[0],
        "this model, zeros as given": lambda log, length: rollout_errors(log, parameters, length, zeros=False)[0],
        "starting model": lambda log, length: rollout_errors(log, start, length)[0],
        "standing still": lambda log, length: standing_still(windows([log], length)),
    }
    rows = [
        (log.name, model, *(_errors(errors(log, length)) for length in HORIZONS))
        for log in judged
        for model, errors in models.items()
    ]
    header = ("log", "model", *(f"after {length:g} s" for length in HORIZONS))
    screen.print(table("open-loop error, joints 1 and 2: RMS (median) [mrad]", header, rows))
    screen.say(
        "Windows start each 0.25 s in the measured state; a log's zeros are estimated from its windows that ended before."
    )
    if arguments.plot is not None:
        log = judged[0]
        _, data, simulated = rollout_errors(log, parameters, 0.5)
        some = slice(None, None, 2)  # windows that do not overlap
        x = data.time[some, None] + np.append(data.keep * data.dt, np.nan)  # NaN ends the line of a window
        ends = np.full((len(x), 1, 2), np.nan)
        y, z = (np.concatenate([part[some], ends], axis=1).reshape(-1, 2).T for part in (simulated, data.measured))
        time = np.linspace(0.0, log.dt * (len(log.position) - 1), len(log.position))
        real = [Line(time, angle, "measured", "black", ":") for angle in log.position.T]
        model = [Line(x.ravel(), angle, "simulated", "#D55E00", "-") for angle in y]
        panels = [Panel(f"joint {j + 1}", "time [s]", "angle [rad]", (model[j], real[j])) for j in (0, 1)]
        residuals = [Line(x.ravel(), angle, "_", "#0072B2", "-") for angle in 1e3 * (y - z)]
        panels += [Panel("", "time [s]", "residual [mrad]", (line,)) for line in residuals]
        plot_lines(f"Rollouts of 0.5 s on {log.name}", panels, arguments.plot, arguments.width)
        screen.say(f"plot: {arguments.plot}")


def _plan(arguments: argparse.Namespace, start: scenarios.Scenario, screen: Screen) -> None:
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
    screen.say(
        f"plan: {arguments.plan} and {path}, condition number {condition:.0f}, torques up to {peak.round(3)} N m"
    )
