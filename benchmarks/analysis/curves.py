"""Learning curves of training runs, grouped over their training seeds."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.analysis.statistics import Estimate, geometric_mean, interval, resample
from benchmarks.run.expansion import training
from benchmarks.text import reason_of
from fbl_gym.model.arm import Array
from fbl_gym.reading import read_text


@dataclass(frozen=True)
class Group:
    """Runs whose settings differ in the training seed alone.

    Attributes:
        name: of the first run's folder, without the seed at its end.
        runs: columns of `curve.csv` by name, of each run; each [n].
    """

    name: str
    runs: tuple[dict[str, Array], ...]

    def ends(self, axis: str) -> Array:
        """Return the last value of an axis, "steps" or "cpu_s", of each run."""
        return np.array([run[axis][-1] for run in self.runs])

    def errors(self, axis: str, points: Array) -> Array:
        """Return the validation error of each run's best agent so far [runs x points, mrad]."""
        best = [np.minimum.accumulate(run["validation_mrad"]) for run in self.runs]
        places = [np.searchsorted(run[axis], points, side="right") - 1 for run in self.runs]
        return np.array([errors[np.maximum(place, 0)] for errors, place in zip(best, places, strict=True)])

    def estimate(self, axis: str, points: Array) -> Estimate:
        """Return the geometric mean of the errors over the runs, with its 95 % interval."""
        errors = self.errors(axis, points).T[:, None]
        return interval(geometric_mean(errors, resample(len(self.runs), 0)))


def read_groups(folders: Sequence[Path]) -> tuple[Group, ...]:
    """Return the runs in some folders of `fbl-gym train`, grouped by their settings.

    Raises:
        ValueError: a folder has no run, or a group has a training seed twice.
    """
    groups: dict[str, dict[int, tuple[Path, dict[str, Array]]]] = {}
    for folder in folders:
        try:
            settings, seed = training(folder)
            table = pd.read_csv(io.StringIO(read_text(folder / "curve.csv")))
            run = {name: table[name].to_numpy(float) for name in ("steps", "cpu_s", "validation_mrad")}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as problem:
            reason = reason_of(problem)
            raise ValueError(f"RUN must be a folder of fbl-gym train, got {str(folder)!r} ({reason})") from None
        runs = groups.setdefault(settings, {})
        if seed in runs:
            raise ValueError(f"RUN must differ in settings or seed, got {str(runs[seed][0])!r} and {str(folder)!r}")
        runs[seed] = folder, run
    named = []
    for runs in groups.values():
        seed, (folder, _) = next(iter(runs.items()))
        named.append(Group(folder.resolve().name.removesuffix(f"-{seed}"), tuple(run for _, run in runs.values())))
    return tuple(named)
