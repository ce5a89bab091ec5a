"""Training of an agent, `fbl-gym train`.

A run writes to its folder:

    agent.json, weights.npz  the agent with the smallest validation error so far
    curve.csv                  the learning curve
    run.json, checkpoint.pt    settings and state, from which a stopped run goes on
    tensorboard/               logs of stable-baselines3
"""

import json
import reprlib
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from benchmarks.files import write_text
from benchmarks.text import refusing
from benchmarks.training.off_policy import OffPolicy
from benchmarks.training.ppo import PPO
from benchmarks.training.progress import CHECKPOINT, Learner, Progress
from benchmarks.training.training_settings import TrainingSettings, training_seeds
from benchmarks.training.vec_env import ArmVecEnv, VectorAdapter
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.reading import read_text


def train(settings: TrainingSettings, folder: Path, command: str = "", evaluations: int = 40) -> None:
    """Train an agent, or continue a run of the same settings that was stopped or shall be longer.

    Args:
        settings: of the run.
        folder: for the agent with the smallest validation error, and the run's own files.
        command: for `agent.json`.
        evaluations: number of validations and checkpoints.

    Raises:
        ValueError: the folder holds a run of other settings, or one that is damaged, or another
            process trains in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / ".lock", timeout=0):
            _train(settings, folder, command, evaluations)
    except Timeout:
        raise ValueError(f"another `fbl-gym train` runs in {folder}; give another --out") from None


def _train(settings: TrainingSettings, folder: Path, command: str, evaluations: int) -> None:
    text, run_file = json.dumps(asdict(settings), indent=1) + "\n", folder / "run.json"
    began = (folder / CHECKPOINT).is_file()
    old, new = (_without_length(each) for each in (read_text(run_file) if began else text, text))
    if other := [name for name in new if old.get(name) != new[name]]:
        has = f"the run in {str(folder)!r} has {other[0]} {reprlib.repr(old.get(other[0]))}"
        may = f"only steps and minutes of a run may change, not {', '.join(other)}"
        raise ValueError(f"{may}; {has}: give the same, or another --out")

    # Lane i draws its episodes from the stream of seed first + i.
    first = training_seeds(settings.seed)[0]
    lanes, ahead, reward = settings.lanes, settings.adapter.previewed, settings.hyperparameters.get("reward")
    make = partial(TwoLinkArmVectorEnv, lanes, autoreset_mode="SameStep", reward=reward)
    envs = [VectorAdapter(make(x, preview=ahead(x.control_dt)), settings.adapter) for x in settings.practice]
    progress, algorithm = Progress(settings, folder, command, evaluations), settings.algorithm
    arguments, logs = settings.hyperparameters["arguments"], str(folder / "tensorboard")
    learner: Learner
    with refusing(f"hyperparameters.arguments must fit {algorithm}"):  # SB3 checks some, torch some, and neither others
        if algorithm == "ppo":
            learner = PPO(envs, first, **arguments)
        else:
            learner = OffPolicy(algorithm, ArmVecEnv(*envs), first, logs, arguments, progress)
    write_text(run_file, text)
    if began:
        with refusing(f"{folder} cannot be resumed, give another --out"):  # errors of torch, pickle, zipfile or SB3
            progress.resume(learner)
    if progress.fraction(learner.steps) < 1.0:
        learner.learn(progress)
        progress.pause(learner)
    else:
        print(f"the run has {learner.steps:,} steps already; more --steps extend it", file=sys.stderr)


def _without_length(text: str) -> dict[str, Any]:
    """Return the settings of a run without its length; none if the text has none."""
    try:
        return {**json.loads(text), "steps": None, "minutes": None}
    except (ValueError, TypeError, RecursionError):
        return {}
