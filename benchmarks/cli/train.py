"""`fbl-gym train`."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.agents.adapter import ACTIONS, AdapterSettings
from benchmarks.cli.common import add_option, command_line
from benchmarks.text import reason_of, say
from benchmarks.training.training_settings import ALGORITHMS, TrainingSettings
from fbl_gym import scenarios
from fbl_gym.options import SENSORS
from fbl_gym.reading import read_text
from fbl_gym.records.record import declarations


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add = parser.add_argument
    add("algorithm", choices=ALGORITHMS, help="ppo, or one of stable-baselines3 or sb3-contrib")
    add("--interface", choices=ACTIONS, default="torque", help="meaning of the agent's action (torque)")
    add_option(parser, "--history", int, 0, "N", "number of earlier steps that the agent observes")
    add("--reach", type=float, default=0.0, metavar="S", help="age of the oldest of these steps [s] (as many steps)")
    add("--base", metavar="LAW", help="law under a residual or blend (computed-torque at 15 rad/s)")
    add("--second", metavar="LAW", help="other law of a blend, which needs one")
    add("--drive", action="store_true", help="observe the drive's stated delay and lag, and the class of robots")
    add("--arm", action="store_true", help="observe what the datasheet states of arm, springs and sensors")
    add("--period", type=float, default=0.0, metavar="S", help="time between two decisions [s] (each step)")
    add("--sensors", nargs="+", choices=SENSORS, help="sensors that the agent observes (those of all scenarios)")
    add("--scales", nargs=3, type=float, metavar=("RAD", "RAD/S", "RAD/S^2"), help="scales of the errors (0.1 1 10)")
    fine = "observe asinh(e / s) of an error e, with these s (e)"
    add("--fine", nargs=2, type=float, metavar=("RAD", "RAD/S"), help=fine)
    add("--integral", type=float, default=0.0, metavar="S", help="observe the mean error over this time [s] (none)")
    add("--memory", type=float, default=0.0, metavar="S", help="observe mean squares over this time [s] (none)")
    add("--preview", type=float, default=0.0, metavar="S", help="observe the reference so far ahead [s] (not at all)")
    tasks = "to train and validate on: scenarios, .toml files, or tiers such as servo-practice (everything-2)"
    add("--scenario", nargs="+", default=["everything-2"], metavar="S", help=tasks)
    add("--severity", nargs="+", type=int, default=[3], metavar="N", help="of a tier, beside its nominal scenario (3)")
    add("--moves", action="store_true", help="train also on a slow motion, and on moves with rests")
    add_option(parser, "--seed", int, 0, "K", "training seed")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--steps", type=int, metavar="N", help="steps of all arms together (from the hyperparameters)")
    length.add_argument("--minutes", type=float, metavar="M", help="processor time instead of steps")
    add("--hyperparameters", type=Path, metavar="FILE", help="JSON file, instead of the shipped hyperparameters")
    add("--out", type=Path, metavar="DIR", help="folder of the run (runs/ALGORITHM-INTERFACE-SEED)")


def run(arguments: argparse.Namespace) -> int:
    """Train an agent; return the exit status."""
    tasks = tuple(
        scenarios.get(task)
        for name in arguments.scenario
        for task in (_in_tier(name, arguments.severity) if name in scenarios.TIERS else (name,))
    )
    fields = declarations(AdapterSettings).keys() & vars(arguments).keys()
    given = {name: value for name in fields if (value := getattr(arguments, name)) is not None}
    present = tuple(name for name in SENSORS if all(name in task.sensors for task in tasks))
    adapter = AdapterSettings(arguments.interface, **{"sensors": present, **given})
    path, length = arguments.hyperparameters, (arguments.steps, arguments.minutes)
    hyperparameters = _hyperparameters(path, arguments.algorithm) if path else {}
    moves, seed = arguments.moves, arguments.seed
    settings = TrainingSettings(arguments.algorithm, adapter, tasks, moves, seed, *length, hyperparameters)
    import torch  # the extra `rl`

    from benchmarks.training.train import train

    torch.set_num_threads(1)  # small networks learn fastest so
    folder = arguments.out or Path("runs", f"{arguments.algorithm}-{arguments.interface}-{arguments.seed}")
    try:
        train(settings, folder, command_line(), round(40 / len(tasks) ** 0.5))
    except (ArithmeticError, AttributeError, LookupError, NameError, RuntimeError, TypeError) as problem:
        if path is None:
            raise
        reason = f"{path} must have arguments that fit {arguments.algorithm}: {reason_of(problem)}"  # SB3 checks few
        raise ValueError(reason) from problem
    say(f"agent: {folder}")
    return 0


def _hyperparameters(path: Path, algorithm: str) -> Any:
    try:
        return json.loads(read_text(path))[algorithm]
    except (ValueError, KeyError, TypeError, RecursionError) as problem:
        raise ValueError(f"{path} must be JSON with an entry {algorithm!r}: {reason_of(problem)}") from None


def _in_tier(tier: str, severities: Sequence[int]) -> tuple[str, ...]:
    """Return a tier's nominal scenario and those of some severities."""
    single = scenarios.in_tier(tier, ())
    for severity in severities:
        if scenarios.in_tier(tier, (severity,)) == single:
            known = [each for each in range(4) if scenarios.in_tier(tier, (each,)) != single]
            raise ValueError(f"--severity must be one of {', '.join(map(str, known))} for {tier}, got {severity}")
    return scenarios.in_tier(tier, severities)
