"""`fbl-gym train`."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.agents.adapter import AdapterSettings
from benchmarks.cli.common import command_line
from benchmarks.text import reason_of, say
from benchmarks.training.training_settings import TrainingSettings
from fbl_gym import scenarios
from fbl_gym.options import SENSORS
from fbl_gym.reading import read_text
from fbl_gym.records.record import declarations


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
    kinds = arguments.moves, arguments.arms, arguments.seed
    settings = TrainingSettings(arguments.algorithm, adapter, tasks, *kinds, *length, hyperparameters)
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
            if not known:
                return single
            raise ValueError(f"--severity must be one of {', '.join(map(str, known))} for {tier}, got {severity}")
    return scenarios.in_tier(tier, severities)
