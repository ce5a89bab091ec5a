"""Algorithms of stable-baselines3 and sb3-contrib as learners, and their actors as plain arrays."""

import copy
import sys
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from benchmarks.agents.network import Actor
from benchmarks.agents.sb3 import find_class
from benchmarks.training.progress import Progress
from benchmarks.training.vec_env import ArmVecEnv
from fbl_gym.model.arm import Array


class OffPolicy(BaseCallback):
    """A model of SB3 as a learner, and its callback.

    Args:
        algorithm: its name.
        env: the arms.
        seed: of the model, and of the first lane of each batch.
        logs: folder for TensorBoard.
        arguments: of the model's class; the learning rate falls to zero. `gradient_steps` are for
            the lanes of the hyperparameters; with more lanes there are more in proportion.
        progress: of the run.
    """

    def __init__(
        self, algorithm: str, env: ArmVecEnv, seed: int, logs: str, arguments: dict[str, Any], progress: Progress
    ) -> None:
        super().__init__()
        arguments, rate = copy.deepcopy(arguments), arguments["learning_rate"]  # SB3 adds to dicts in it
        # SB3's own measure of progress does not know `minutes`.
        arguments["learning_rate"] = lambda _: rate * (1.0 - progress.fraction(self.steps))
        make = find_class(algorithm)
        self.model = make("MlpPolicy", env, seed=seed, device="cpu", tensorboard_log=logs, **arguments)
        if getattr(self.model, "use_sde", False):
            raise ValueError("use_sde must be False, since the network alone is the agent, got True")
        if (updates := getattr(self.model, "gradient_steps", -1)) > 0:  # -1: as many as lanes
            share = env.num_envs / progress.settings.hyperparameters["lanes"]
            self.model.gradient_steps = max(1, round(updates * share))  # type: ignore[attr-defined]
        self._env, self._progress = env, progress

    @property
    def steps(self) -> int:
        """Return the number of steps so far."""
        return self.num_timesteps

    def actor(self) -> Actor:
        """Return the agent's network now."""
        return export(self.model)

    def state(self) -> dict[str, Any]:
        """Return all that `load` needs."""
        return {
            "parameters": self.model.get_parameters(), "tensors": self._tensors(), "updates": self.model._n_updates,
            "steps": self.steps, "position": (self._buffer.pos, self._buffer.full) if self._buffer else None,
        }  # fmt: skip

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a state; the arms begin their next episodes."""
        self.model.set_parameters(state["parameters"])
        if self._buffer:
            self._buffer.pos, self._buffer.full = state["position"]
        for name, tensor in self._tensors().items():
            tensor.data.copy_(state["tensors"][name])
        self.model._n_updates = state["updates"]
        self.num_timesteps = self.model.num_timesteps = state["steps"]
        both = zip(self._env.get_attr("scenario"), self._env.get_attr("decision"), strict=True)
        episode = round(min(scenario.duration / decision for scenario, decision in both))
        for _ in range(self.steps // (self._env.num_envs * episode)):
            self._env.reset()  # skip the episodes that the run has trained on

    def learn(self, progress: Progress) -> None:
        """Train until the run is over."""
        remaining = (progress.settings.steps or sys.maxsize) - self.steps
        self.model.learn(remaining, callback=self, reset_num_timesteps=False, tb_log_name="run")

    def _on_step(self) -> bool:
        return self._progress.fraction(self.steps) < 1.0

    def _on_rollout_start(self) -> None:
        self._progress.check(self)

    @property
    def _buffer(self) -> Any:
        """The replay buffer; None: the algorithm has none."""
        return getattr(self.model, "replay_buffer", None)

    def _tensors(self) -> dict[str, torch.Tensor]:
        """Return the tensors that are no parameters: SAC's entropy and the buffer's steps."""
        tensors = {name: getattr(self.model, name) for name in self.model._get_torch_save_params()[1]}
        if not self._buffer:
            return tensors
        arrays = {name: array for name, array in vars(self._buffer).items() if isinstance(array, np.ndarray)}
        return tensors | {name: torch.from_numpy(array[: self._buffer.size()]) for name, array in arrays.items()}


def export(model: BaseAlgorithm) -> Actor:
    """Return the deterministic actor of an SB3 model whose policy is a multilayer perceptron."""
    policy: Any = model.policy
    if on_policy := isinstance(model, OnPolicyAlgorithm):
        modules = [*policy.mlp_extractor.policy_net, policy.action_net]
    elif hasattr(policy.actor, "latent_pi"):
        modules = [*policy.actor.latent_pi, policy.actor.mu]
    else:
        modules = [*policy.actor.mu]
    layers: list[tuple[Array, Array]] = []
    norm: Any = None
    for module in modules:
        if hasattr(module, "ra_mean"):  # CrossQ's batch normalization, an affine map that goes into the next layer
            norm = module
        if isinstance(module, torch.nn.Linear):
            weight, bias = _arrays(module.weight, module.bias)
            if norm is not None:
                mean, variance, scale, shift = _arrays(norm.ra_mean, norm.ra_var, norm.scale, norm.bias)
                gain = scale / np.sqrt(variance + norm.eps)
                bias = bias + weight @ (shift - gain * mean)
                weight, norm = weight * gain, None
            layers.append((weight, bias))
    activation = "tanh" if isinstance(modules[min(1, len(modules) - 1)], torch.nn.Tanh) else "relu"
    return Actor(tuple(layers), activation, "clip" if on_policy else "tanh")


def _arrays(*tensors: torch.Tensor) -> tuple[Array, ...]:
    return tuple(tensor.detach().numpy().astype(float) for tensor in tensors)
