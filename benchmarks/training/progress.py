"""The progress of a training run: validations, the best agent, and the checkpoint to go on from."""

import os
import platform
import sys
import time
from dataclasses import asdict
from datetime import timedelta
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import torch

from benchmarks.agents.agent import write
from benchmarks.files import replacing, write_text
from benchmarks.training.training_settings import TrainingSettings
from benchmarks.training.validation import validate

if TYPE_CHECKING:
    from benchmarks.training.off_policy import OffPolicy
    from benchmarks.training.ppo import PPO

Learner: TypeAlias = "PPO | OffPolicy"
CHECKPOINT = "checkpoint.pt"
PACKAGES = ("fbl-gym", "gymnasium", "numpy", "torch", "stable-baselines3", "sb3-contrib")


class Validation(NamedTuple):
    """A validation, a row of `curve.csv`: steps so far, wall time, processor time, and error.

    The processor time is that of the training, without validations and checkpoints.
    """

    steps: int
    wall_s: float
    cpu_s: float
    validation_mrad: float


class Progress:
    """The progress of a run: it validates the agent, saves the best one and writes checkpoints.

    Attributes:
        curve: the validations so far.
    """

    def __init__(self, settings: TrainingSettings, folder: Path, command: str, evaluations: int) -> None:
        self.settings, self.folder, self.command, self.evaluations = settings, folder, command, evaluations
        self.curve: list[Validation] = []
        self._wall_begin, self._cpu_begin = time.monotonic(), time.process_time()
        self._next_validation = 0.0

    def fraction(self, steps: int) -> float:
        """Return the finished fraction of the run after some steps, in [0, 1]."""
        if self.settings.minutes is not None:
            return min(1.0, (time.process_time() - self._cpu_begin) / (60 * self.settings.minutes))
        return min(1.0, steps / self.settings.steps)  # type: ignore[operator]

    def resume(self, learner: Learner) -> None:
        """Load the checkpoint into a new learner. It is plain data: loading it runs no code."""
        saved = torch.load(self.folder / CHECKPOINT, weights_only=True)
        learner.load(saved["learner"])
        self.curve = [Validation(*row) for row in saved["curve"]]
        last = self.curve[-1]
        self._wall_begin -= last.wall_s
        self._cpu_begin -= last.cpu_s
        self._next_validation = self.fraction(learner.steps) + 1 / self.evaluations

    def check(self, learner: Learner) -> None:
        """Pause if a validation is due."""
        if (fraction := self.fraction(learner.steps)) >= self._next_validation:
            self._next_validation = fraction + 1 / self.evaluations
            self.pause(learner, fraction)

    def pause(self, learner: Learner, fraction: float = 1.0) -> None:
        """Validate the agent, save the best one, and write the curve and a checkpoint."""
        begin, wall = time.process_time(), time.monotonic() - self._wall_begin
        adapter, tasks, actor = self.settings.adapter, self.settings.scenarios, learner.actor()
        for law in () if self.curve else adapter.uses:
            print(f"{law} alone: validation {validate(adapter, law, tasks):.3f} mrad", file=sys.stderr)
        error, best = validate(adapter, actor, tasks), min((row.validation_mrad for row in self.curve), default=np.inf)
        seconds = round(wall, 2), round(begin - self._cpu_begin, 2)
        self.curve.append(Validation(learner.steps, *seconds, round(error, 4)))
        if error < best:
            write(self.folder, actor, self._description())
        lines = (",".join(map(str, row)) + "\n" for row in (Validation._fields, *self.curve))
        write_text(self.folder / "curve.csv", "".join(lines))
        with replacing(self.folder / CHECKPOINT) as beside:
            torch.save({"curve": [tuple(row) for row in self.curve], "learner": learner.state()}, beside)
        left = f", {timedelta(seconds=int(wall * (1 - fraction) / fraction))} left" if fraction > 0 else ""
        done = f"{100 * fraction:3.0f} %  {learner.steps:>11,} steps"
        errors = f"validation {error:8.3f} mrad  best {min(error, best):8.3f} mrad"
        print(f"{done}  {errors}{left}", file=sys.stderr)
        self._cpu_begin += time.process_time() - begin

    def _description(self) -> dict[str, Any]:
        settings, tasks = self.settings, self.settings.scenarios
        trained_on = {"scenario": tasks[0].to_dict()} if len(tasks) == 1 else {"scenarios": [s.name for s in tasks]}
        machine = f"{platform.machine()} {platform.system()}, {torch.get_num_threads()} of {os.cpu_count()} cores"
        return {
            "algorithm": settings.algorithm, "interface": asdict(settings.adapter), "command": self.command,
            "seed": settings.seed, **self.curve[-1]._asdict(), **trained_on, "hyperparameters": settings.hyperparameters,
            "packages": {name: metadata.version(name) for name in PACKAGES}, "python": platform.python_version(),
            "machine": machine, "licence": "MIT",
        }  # fmt: skip
