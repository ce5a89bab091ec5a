"""The progress of a training run: validation, the best agent, checkpoints, remaining time."""

from __future__ import annotations

import csv
import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from benchmarks.files import replacing, write_text
from benchmarks.rl.agent import Agent, write
from benchmarks.rl.export import export
from benchmarks.rl.training_settings import TrainingSettings
from benchmarks.rl.validation import validate
from fbl_gym import Scenario

COLUMNS = ("steps", "wall_s", "cpu_s", "validation_mrad")
PACKAGES = ("fbl-gym", "gymnasium", "numpy", "torch", "stable-baselines3", "sb3-contrib")


class Progress(BaseCallback):
    """A callback that validates the agent, saves the best one and writes checkpoints.

    `curve` has steps, wall time [s], processor time of the training [s] and error [mrad] of each
    validation so far. Validations and checkpoints do not count as processor time. Checkpoints take
    a twentieth of the wall time at most: an algorithm with a large buffer has fewer of them.
    """

    def __init__(self, settings: TrainingSettings, folder: Path, command: str, evaluations: int) -> None:
        super().__init__()
        self.settings, self.folder, self.command, self.evaluations = settings, folder, command, evaluations
        self.curve: list[tuple[int, float, float, float]] = []
        self._begin, self._cpu_begin = time.monotonic(), time.process_time()
        self._next_validation = self._next_save = 0.0

    def resume(self, steps: int) -> None:
        """Read the learning curve up to the checkpoint, which was written after `steps` steps."""
        with (self.folder / "curve.csv").open() as file:
            rows = [
                (int(n), float(wall), float(cpu), float(error)) for n, wall, cpu, error in list(csv.reader(file))[1:]
            ]
        self.curve = [row for row in rows if row[0] <= steps]
        self._begin -= self.curve[-1][1]
        self._cpu_begin -= self.curve[-1][2]
        self._next_validation = self.fraction(steps) + 1 / self.evaluations

    def fraction(self, steps: int) -> float:
        """Return the finished fraction of the run, in [0, 1], after a number of steps."""
        if self.settings.minutes is not None:
            return min(1.0, (time.process_time() - self._cpu_begin) / (60 * self.settings.minutes))
        return min(1.0, steps / self.settings.steps)  # type: ignore[operator]

    def _on_step(self) -> bool:
        return self.settings.minutes is None or self.fraction(self.num_timesteps) < 1.0

    def _on_rollout_start(self) -> None:
        fraction = self.fraction(self.num_timesteps)
        if fraction >= self._next_validation:
            self._next_validation = fraction + 1 / self.evaluations
            self._pause(fraction)

    def _on_training_end(self) -> None:
        self._next_save = 0.0
        self._pause(1.0)

    def _pause(self, fraction: float) -> None:
        """Validate the agent, and write a checkpoint if it is time."""
        cpu, start = time.process_time(), time.monotonic()
        self._validate(fraction, cpu - self._cpu_begin)
        if start >= self._next_save:
            begin = time.monotonic()
            self._save()
            self._next_save = time.monotonic() + 20 * (time.monotonic() - begin)
        self._cpu_begin += time.process_time() - cpu

    def _validate(self, fraction: float, cpu: float) -> None:
        settings, actor = self.settings, export(self.model)
        adapter = settings.adapter
        make = lambda env: Agent(env.interface, adapter, actor, env if adapter.context else None)  # noqa: E731
        error = validate(make, settings.scenarios)
        best = min((row[-1] for row in self.curve), default=np.inf)
        wall = time.monotonic() - self._begin
        self.curve.append((self.num_timesteps, round(wall, 2), round(cpu, 2), round(error, 4)))
        if error < best:
            write(self.folder, actor, self._description())
        lines = [",".join(COLUMNS), *(",".join(map(str, row)) for row in self.curve)]
        write_text(self.folder / "curve.csv", "\n".join(lines) + "\n")
        self.logger.record("validation/rms_mrad", error)
        remaining = f", {_clock(wall * (1 - fraction) / fraction)} left" if fraction > 0 else ""
        print(
            f"{100 * fraction:3.0f} %  {self.num_timesteps:>11,} steps  validation {error:8.3f} mrad  "
            f"best {min(error, best):8.3f} mrad  {_clock(wall)} elapsed{remaining}",
            file=sys.stderr,
            flush=True,
        )

    def _description(self) -> dict[str, Any]:
        settings = self.settings
        steps, wall, cpu, error = self.curve[-1]
        return {
            "algorithm": settings.algorithm,
            "interface": asdict(settings.adapter),
            "command": self.command,
            "seed": settings.seed,
            "steps": steps,
            "wall_s": wall,
            "cpu_s": cpu,
            "validation_mrad": error,
            **_trained_on(settings.scenarios),
            "hyperparameters": settings.hyperparameters,
            "packages": {name: version for name in PACKAGES if (version := _version(name))},
            "python": platform.python_version(),
            "machine": f"{platform.machine()} {platform.system()}, {torch.get_num_threads()} of {os.cpu_count()} cores",
            "licence": "MIT",
        }

    def _save(self) -> None:
        if isinstance(self.model, OffPolicyAlgorithm):
            with replacing(self.folder / "buffer.pkl") as beside:
                self.model.save_replay_buffer(beside)
        with replacing(self.folder / "checkpoint.zip") as beside:
            self.model.save(beside)


class LinearDecay:
    """A learning rate that falls linearly to zero over the run."""

    def __init__(self, begin: float, progress: Progress) -> None:
        self.begin, self.progress = begin, progress

    def __call__(self, _: float) -> float:
        """Return the learning rate now; SB3's measure of progress does not know `minutes`."""
        return self.begin * (1.0 - self.progress.fraction(self.progress.num_timesteps))

    def __reduce__(self) -> tuple[Any, ...]:
        return float, (self.begin,)  # a checkpoint holds the number only; training replaces it


def _trained_on(each: Sequence[Scenario]) -> dict[str, Any]:
    """Return one scenario as plain data, several by their names."""
    return {"scenario": each[0].to_dict()} if len(each) == 1 else {"scenarios": [scenario.name for scenario in each]}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
