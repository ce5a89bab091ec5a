"""Training of an agent with stable-baselines3, `fbl-gym train`.

A run writes to its folder:

    agent.json, weights-*.npz  the agent with the smallest validation error so far
    curve.csv                  the learning curve
    run.json, checkpoint.zip   settings and state, from which a killed run resumes; off-policy
                               algorithms have buffer.pkl too
    tensorboard/               logs, if TensorBoard is installed
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from importlib import util
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from benchmarks.files import write_text
from benchmarks.rl.progress import LinearDecay, Progress
from benchmarks.rl.sb3 import find_class
from benchmarks.rl.training_settings import LANES, TrainingSettings
from benchmarks.rl.vec_env import ArmVecEnv
from benchmarks.rl.vector_adapter import SideBySide, VectorAdapter
from benchmarks.seeds import SPLITS
from fbl_gym.vector_env import TwoLinkArmVectorEnv

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def train(
    settings: TrainingSettings, folder: Path, command: str = "", evaluations: int = 40, wandb: str | None = None
) -> Path:
    """Train an agent, or continue a run of the same settings that was killed or shall be longer.

    `command` is written to `agent.json`. There are as many checkpoints as evaluations. `wandb` is a
    project of Weights & Biases to report to. The folder is returned, with the agent whose
    validation error was smallest.

    Raises:
        ValueError: the folder holds a run of other settings, or another process works in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder):
        _train(settings, folder, command, evaluations, wandb)
    return folder


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Refuse a folder in which another process works; a killed process releases its lock."""
    with (folder / ".lock").open("w") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ValueError(
                    f"folder must be one that no other run works in, got {str(folder)!r}, in which another run works; "
                    "give another --out or --seed"
                ) from None
            except OSError:
                pass  # the file system has no locks
        yield


def _without_length(text: str) -> dict[str, Any] | None:
    """Return the settings of a run without its length; None: the text has none."""
    try:
        return {**json.loads(text), "steps": None, "minutes": None}
    except (ValueError, TypeError, RecursionError):
        return None


def _train(settings: TrainingSettings, folder: Path, command: str, evaluations: int, wandb: str | None) -> None:
    text = json.dumps(asdict(settings), indent=1) + "\n"
    run_file = folder / "run.json"
    if run_file.exists() and _without_length(run_file.read_text(encoding="utf-8")) != _without_length(text):
        raise ValueError(
            f"folder must be new or hold a run of the same settings, got {str(folder)!r}, whose run.json has others; "
            "only steps and minutes may change"
        )
    write_text(run_file, text)

    # The environment: lane i draws its episodes from the stream of seed first + i.
    first = SPLITS["training"][settings.seed * LANES]
    arms = [TwoLinkArmVectorEnv(settings.lanes, each, autoreset_mode="SameStep") for each in settings.scenarios]
    env = ArmVecEnv(SideBySide([VectorAdapter(each, settings.adapter) for each in arms]))
    env.seed(first)

    # The model: new, or from the checkpoint.
    progress = Progress(settings, folder, command, evaluations)
    arguments = {**copy.deepcopy(settings.hyperparameters["arguments"]), "device": "cpu"}  # SB3 adds to dicts in it
    arguments["learning_rate"] = LinearDecay(arguments["learning_rate"], progress)
    algorithm = find_class(settings.algorithm)
    checkpoint = folder / "checkpoint.zip"
    if checkpoint.exists():
        try:
            model = algorithm.load(checkpoint, env=env, custom_objects=arguments)
            if isinstance(model, OffPolicyAlgorithm):
                model.load_replay_buffer(folder / "buffer.pkl")
            progress.resume(model.num_timesteps)
        except Exception as problem:  # of SB3, torch, zipfile, pickle or csv
            raise ValueError(
                f"{folder} holds a run that cannot be resumed ({type(problem).__name__}: {problem}); give another --out"
            ) from None
        for _ in range(model.num_timesteps // (env.num_envs * settings.scenarios[0].steps)):
            env.reset()  # skip the episodes that the run has trained on
    else:
        logs = str(folder / "tensorboard") if util.find_spec("tensorboard") else None
        try:
            model = algorithm("MlpPolicy", env, seed=first, tensorboard_log=logs, **arguments)
        except Exception as problem:  # SB3 checks some arguments, torch some, and neither others
            raise ValueError(
                f"hyperparameters.arguments must be those of {algorithm.__name__}: {type(problem).__name__}: {problem}"
            ) from None

    if model.tensorboard_log is None:
        model.set_logger(Logger(None, []))  # the default one makes a folder in /tmp
    if wandb is not None:
        importlib.import_module("wandb").init(project=wandb, config=json.loads(text), dir=folder, sync_tensorboard=True)
    remaining = (settings.steps or sys.maxsize) - model.num_timesteps
    if remaining > 0:
        model.learn(remaining, callback=progress, reset_num_timesteps=False, tb_log_name="run")
    else:
        print(f"the run has {model.num_timesteps:,} steps already; more --steps extend it", file=sys.stderr)
