"""`fbl-gym train`: an agent of stable-baselines3 on the uncertain arm, from its hyper-parameters to a folder of plain data.

A run's folder holds `agent.json` and `weights.npz` (the best agent so far, chosen on validation seeds) and `curve.csv`; with
`run.json` and `checkpoint.zip` a run that was killed goes on where it was; TensorBoard's logs, where it is installed.
"""

from __future__ import annotations

import contextlib
import csv
import importlib
import json
import os
import platform
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from importlib import metadata, util
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from benchmarks.rl import policy
from benchmarks.rl.interface import VectorBody
from benchmarks.rl.policy import Actor, Agent
from benchmarks.rl.settings import Settings
from benchmarks.rl.vec_env import ArmVecEnv
from benchmarks.seeds import SPLITS
from controllers import Policy
from fbl_gym.arm import Array
from fbl_gym.vector_env import TwoLinkArmVectorEnv

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

VALIDATION = SPLITS["validation"][:16]
LANES = 1000
"""Training seed k has the episode seeds of so many lanes to itself."""
COLUMNS = ("steps", "wall_s", "validation_mrad")
PACKAGES = ("fbl-gym", "gymnasium", "numpy", "torch", "stable-baselines3", "sb3-contrib")


def train(settings: Settings, folder: Path, command: str = "", evaluations: int = 40, wandb: str | None = None) -> Path:
    """Train an agent, or go on with a run that was killed.

    Args:
        settings: what to train.
        folder: of the run. If it holds a run of the same settings, that goes on.
        command: with which the run was started, to be written beside the agent.
        evaluations: how often it is validated, and a checkpoint written.
        wandb: the project of Weights & Biases to report to; None: none.

    Returns:
        The folder, with the agent whose error on the validation seeds was smallest.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _alone(folder):
        _train(settings, folder, command, evaluations, wandb)
    return folder


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Refuse a folder that another live run works in. The lock goes with its process, however that ends."""
    with (folder / ".lock").open("w") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ValueError(
                    f"folder must be one that no other run works in, got {str(folder)!r}, in which one does now; "
                    "give another --out or --seed"
                ) from None
            except OSError:
                pass  # a file system that knows no locks
        yield


def _train(settings: Settings, folder: Path, command: str, evaluations: int, wandb: str | None) -> None:
    plain = json.loads(json.dumps(asdict(settings)))
    record = folder / "run.json"
    if record.exists() and json.loads(record.read_text()) != plain:
        raise ValueError(f"folder must be new or hold a run of the same settings, got {str(folder)!r} with another run")
    record.write_text(json.dumps(plain, indent=1) + "\n")

    # The training worlds: lane i draws its episodes from the stream of seed first + i.
    first = SPLITS["training"][settings.seed * LANES]
    arms = TwoLinkArmVectorEnv(settings.hyperparameters["lanes"], settings.scenario, autoreset_mode="SameStep")
    env = ArmVecEnv(VectorBody(arms, settings.interface))
    env.seed(first)

    # The learner: new, or as the checkpoint has it.
    progress = Progress(settings, folder, command, evaluations)
    arguments = {**settings.hyperparameters["arguments"], "device": "cpu"}
    arguments["learning_rate"] = Decay(arguments["learning_rate"], progress)
    algorithm = policy.find_class(settings.algorithm)
    checkpoint = folder / "checkpoint.zip"
    if checkpoint.exists():
        model = algorithm.load(checkpoint, env=env, custom_objects=arguments)
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(folder / "buffer.pkl")
        progress.resume(model.num_timesteps)
        for _ in range(model.num_timesteps // (env.num_envs * settings.scenario.steps)):
            env.reset()  # on to episodes that it has not seen
    else:
        logs = str(folder / "tensorboard") if util.find_spec("tensorboard") else None
        model = algorithm("MlpPolicy", env, seed=first, tensorboard_log=logs, **arguments)

    if wandb is not None:
        importlib.import_module("wandb").init(project=wandb, config=plain, dir=folder, sync_tensorboard=True)
    left = (settings.steps or sys.maxsize) - model.num_timesteps
    if left > 0:
        model.learn(left, callback=progress, reset_num_timesteps=False, tb_log_name="run")


class Progress(BaseCallback):
    """Validates the agent now and then, keeps the best, writes a checkpoint and says how long it will take."""

    def __init__(self, settings: Settings, folder: Path, command: str, evaluations: int) -> None:
        super().__init__()
        self.settings, self.folder, self.command, self.evaluations = settings, folder, command, evaluations
        self.curve: list[tuple[int, float, float]] = []
        self.begin = time.monotonic()
        self.next = 0.0

    def resume(self, steps: int) -> None:
        """Take up the curve as it was at the checkpoint."""
        with (self.folder / "curve.csv").open() as file:
            rows = [(int(n), float(wall), float(error)) for n, wall, error in list(csv.reader(file))[1:]]
        self.curve = [row for row in rows if row[0] <= steps]
        self.begin -= self.curve[-1][1]
        self.next = self.done(steps) + 1 / self.evaluations

    def done(self, steps: int) -> float:
        """The share of the run that is done, in [0, 1]."""
        if self.settings.minutes is not None:
            return min(1.0, (time.monotonic() - self.begin) / (60 * self.settings.minutes))
        return min(1.0, steps / self.settings.steps)  # type: ignore[operator]

    def _on_step(self) -> bool:
        return self.settings.minutes is None or self.done(self.num_timesteps) < 1.0

    def _on_rollout_start(self) -> None:
        done = self.done(self.num_timesteps)
        if done >= self.next:
            self.next = done + 1 / self.evaluations
            self._validate(done)
            self._save()

    def _on_training_end(self) -> None:
        self._validate(1.0)
        self._save()

    def _validate(self, done: float) -> None:
        settings, actor = self.settings, export(self.model)
        env = TwoLinkArmVectorEnv(len(VALIDATION), settings.scenario)
        agent = Agent(env.interface, settings.interface, actor, env if settings.interface.context else None)
        error = tracking_error(agent, env, VALIDATION).mean()
        best = min((row[2] for row in self.curve), default=np.inf)
        wall = time.monotonic() - self.begin
        self.curve.append((self.num_timesteps, round(wall, 2), round(float(error), 4)))
        if error < best:
            policy.write(self.folder, actor, self._description())
        lines = [",".join(COLUMNS), *(",".join(map(str, row)) for row in self.curve)]
        _replace(self.folder / "curve.csv", "\n".join(lines) + "\n")
        self.logger.record("validation/rms_mrad", float(error))
        left = f", {_clock(wall * (1 - done) / done)} left" if done > 0 else ""
        print(
            f"{100 * done:3.0f} %  {self.num_timesteps:>11,} steps  validation {error:8.3f} mrad  "
            f"best {min(error, best):8.3f} mrad  {_clock(wall)} gone{left}",
            file=sys.stderr,
            flush=True,
        )

    def _description(self) -> dict[str, Any]:
        settings = self.settings
        steps, wall, error = self.curve[-1]
        return {
            "algorithm": settings.algorithm,
            "interface": asdict(settings.interface),
            "command": self.command,
            "seed": settings.seed,
            "steps": steps,
            "wall_s": wall,
            "validation_mrad": error,
            "scenario": settings.scenario.to_dict(),
            "hyperparameters": settings.hyperparameters,
            "packages": {name: version for name in PACKAGES if (version := _version(name))},
            "python": platform.python_version(),
            "machine": f"{platform.machine()} {platform.system()}, {torch.get_num_threads()} of {os.cpu_count()} cores",
            "licence": "MIT",
        }

    def _save(self) -> None:
        if isinstance(self.model, OffPolicyAlgorithm):
            self.model.save_replay_buffer(self.folder / ".buffer.pkl")
            (self.folder / ".buffer.pkl").replace(self.folder / "buffer.pkl")
        self.model.save(self.folder / ".checkpoint.zip")
        (self.folder / ".checkpoint.zip").replace(self.folder / "checkpoint.zip")


class Decay:
    """A learning rate that falls to zero, straight, with what is left of the run."""

    def __init__(self, begin: float, progress: Progress) -> None:
        self.begin, self.progress = begin, progress

    def __call__(self, _: float) -> float:
        return self.begin * (1.0 - self.progress.done(self.progress.num_timesteps))

    def __reduce__(self) -> tuple[Any, ...]:
        return float, (self.begin,)  # in a checkpoint, where training puts a new one in its place


def export(model: BaseAlgorithm) -> Actor:
    """The deterministic actor of an SB3 model whose policy is an MLP."""
    modules, output = _modules(model.policy)
    layers: list[tuple[Array, Array]] = []
    norm: Any = None
    for module in modules:
        if hasattr(module, "ra_mean"):  # CrossQ's normalisation, an affine map that goes into the next layer
            norm = module
        if isinstance(module, torch.nn.Linear):
            weight, bias = (p.detach().numpy().astype(float) for p in (module.weight, module.bias))
            if norm is not None:
                mean, var, scale, shift = (
                    p.detach().numpy().astype(float) for p in (norm.ra_mean, norm.ra_var, norm.scale, norm.bias)
                )
                gain = scale / np.sqrt(var + norm.eps)
                bias = bias + weight @ (shift - gain * mean)
                weight, norm = weight * gain, None
            layers.append((weight, bias))
    activation = "tanh" if isinstance(modules[1], torch.nn.Tanh) else "relu"
    return Actor(tuple(layers), activation, output)


def _modules(learned: Any) -> tuple[list[torch.nn.Module], str]:
    """The actor's modules from first to last, and what bounds its output."""
    if hasattr(learned, "mlp_extractor"):
        return [*learned.mlp_extractor.policy_net, learned.action_net], "clip"
    if hasattr(learned.actor, "latent_pi"):
        return [*learned.actor.latent_pi, learned.actor.mu], "tanh"
    return [*learned.actor.mu], "tanh"


def tracking_error(actor: Policy, env: TwoLinkArmVectorEnv, seeds: Any) -> Array:
    """Root mean square tracking error of both joints over one episode of each seed [n] mrad; half a turn once diverged."""
    observation, _ = env.reset(seed=list(seeds))
    state: Any = None
    squares, alive = np.zeros(env.num_envs), np.ones(env.num_envs, dtype=bool)
    for _ in range(env.scenario.steps):
        action, state = actor.predict(observation, state, deterministic=True)
        observation, _, terminated, _, _ = env.step(action)
        alive &= ~terminated
        truth = env.truth
        error = np.minimum(np.abs(truth.reference - truth.position), np.pi)
        squares += np.where(alive, (error**2).mean(axis=-1), np.pi**2)
    return 1e3 * np.sqrt(squares / env.scenario.steps)


def _replace(path: Path, text: str) -> None:
    beside = path.with_name(f".{path.name}")
    beside.write_text(text)
    beside.replace(path)


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
