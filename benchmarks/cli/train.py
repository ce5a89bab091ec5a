"""`fbl-gym train`."""

from __future__ import annotations

import argparse
import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np

import controllers
from benchmarks.cli.common import add_scenario, command_line, count, refuse_judged
from benchmarks.rl.adapter import ACTIONS, AdapterSettings
from benchmarks.rl.sb3 import ALGORITHMS
from benchmarks.rl.training_settings import TrainingSettings, at_radius
from fbl_gym import scenarios
from fbl_gym.interface import Interface
from fbl_gym.uncertainty import SENSORS
from fbl_gym.vector_env import TwoLinkArmVectorEnv

HARDEST = (3,)
"""Severities of a tier that is trained on, beside its nominal scenario."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("algorithm", choices=tuple(ALGORITHMS), help="algorithm of stable-baselines3 or sb3-contrib")
    parser.add_argument("--interface", choices=ACTIONS, default="torque", help="meaning of the agent's action (torque)")
    parser.add_argument(
        "--history", type=int, default=0, metavar="N", help="number of earlier steps that the agent observes (0)"
    )
    parser.add_argument("--base", metavar="LAW", help="law under a residual (computed-torque at 15 rad/s)")
    parser.add_argument("--drive", action="store_true", help="let the agent observe the drive's stated delay and lag")
    parser.add_argument(
        "--sensors", nargs="+", choices=SENSORS, default=SENSORS, help="sensors that the agent observes (all)"
    )
    parser.add_argument(
        "--scales", nargs=3, type=float, metavar=("RAD", "RAD/S", "RAD/S^2"), help="scales of the errors (0.1 1 10)"
    )
    parser.add_argument(
        "--context", action="store_true", help="let the agent observe the true parameters (privileged access)"
    )
    add_scenario(parser, "everything-2", "or a tier (practice), for training and validation, ")
    parser.add_argument(
        "--radius", type=float, metavar="R", help="radius of the parameter error, instead of the scenario's"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="K", help="training seed (0)")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--steps", type=int, metavar="N", help="steps of all arms together (from the hyperparameters)")
    length.add_argument("--minutes", type=float, metavar="M", help="processor time instead of steps")
    parser.add_argument(
        "--hyperparameters", type=Path, metavar="FILE", help="JSON file, instead of the shipped hyperparameters"
    )
    parser.add_argument("--threads", type=count, default=1, metavar="N", help="threads of torch (1)")
    parser.add_argument("--wandb", metavar="PROJECT", help="also report to this project of Weights & Biases")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the run (runs/ALGORITHM-INTERFACE-SEED)")


def run(arguments: argparse.Namespace) -> int:
    """Train an agent; return the exit status."""
    settings = _settings(arguments)
    import torch  # the extra `rl`

    from benchmarks.rl.train import train

    history = f"-history-{arguments.history}" if arguments.history else ""
    context = "-context" if arguments.context else ""
    name = f"{settings.algorithm}-{settings.adapter.action}{history}{context}-{settings.seed}"
    folder = arguments.out or Path("runs") / name
    torch.set_num_threads(arguments.threads)
    train(settings, folder, command_line(), 40 if len(settings.scenarios) == 1 else 15, arguments.wandb)
    with contextlib.suppress(ImportError):  # of the extra `bench`, which a training does not need
        _plot_curve(folder)
    print(f"agent: {folder}")
    return 0


def _plot_curve(folder: Path) -> None:
    """Draw the learning curve of a run into its folder."""
    from benchmarks.report.plot import Line, Panel, plot_lines

    steps, *_, error = np.loadtxt(folder / "curve.csv", delimiter=",", skiprows=1, ndmin=2).T
    lines = (Line(steps, error, "error"), Line(steps, np.minimum.accumulate(error), "of the saved agent", style="--"))
    panel = Panel("", "steps of all arms", "error on the validation seeds [mrad]", lines, ("linear", "log"))
    plot_lines(f"Training of {folder.name}", (panel,), folder / "curve.png")


def _settings(arguments: argparse.Namespace) -> TrainingSettings:
    name = arguments.scenario
    names = scenarios.in_tier(name, HARDEST) if name in scenarios.TIERS else (name,)
    each = [scenarios.get(name) for name in names]
    for scenario in each:
        refuse_judged(scenario)
    if arguments.radius is not None:
        each = [at_radius(scenario, arguments.radius) for scenario in each]
    hyperparameters: dict[str, Any] = {}
    if arguments.hyperparameters is not None:
        hyperparameters = _hyperparameters(arguments.hyperparameters, arguments.algorithm)
    return TrainingSettings(
        algorithm=arguments.algorithm,
        adapter=_adapter(arguments, TwoLinkArmVectorEnv(1, each[0]).interface),
        scenarios=tuple(each),
        seed=arguments.seed,
        steps=arguments.steps,
        minutes=arguments.minutes,
        hyperparameters=hyperparameters,
    )


def _adapter(arguments: argparse.Namespace, interface: Interface) -> AdapterSettings:
    options: dict[str, Any] = {} if arguments.scales is None else {"scales": arguments.scales}
    if arguments.base is not None:
        law: Any = controllers.make(arguments.base, interface)
        gains = {name: value for name, value in vars(law).items() if name in law.__dataclass_fields__}
        del gains["interface"]
        options |= {"base": arguments.base.removesuffix("@tuned"), "gains": gains}
    return AdapterSettings(
        arguments.interface,
        history=arguments.history,
        drive=arguments.drive,
        context=arguments.context,
        sensors=arguments.sensors,
        **options,
    )


def _hyperparameters(path: Path, algorithm: str) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))[algorithm]
    except (ValueError, KeyError, TypeError, RecursionError) as problem:
        raise ValueError(
            f"{path} must be JSON with an entry {algorithm!r}: {type(problem).__name__}: {problem}"
        ) from None
