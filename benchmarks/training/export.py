"""The actor network of a stable-baselines3 model as plain arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from benchmarks.agents.network import Actor
from fbl_gym.model.arm import Array


def export(model: BaseAlgorithm) -> Actor:
    """Return the deterministic actor of an SB3 model whose policy is a multilayer perceptron."""
    modules, output = _modules(model.policy)
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
    activation = "tanh" if isinstance(modules[1], torch.nn.Tanh) else "relu"
    return Actor(tuple(layers), activation, output)


def _arrays(*tensors: torch.Tensor) -> tuple[Array, ...]:
    return tuple(tensor.detach().numpy().astype(float) for tensor in tensors)


def _modules(sb3_policy: Any) -> tuple[list[torch.nn.Module], str]:
    """Return the actor's modules from first to last, and the kind of its output."""
    if hasattr(sb3_policy, "mlp_extractor"):
        return [*sb3_policy.mlp_extractor.policy_net, sb3_policy.action_net], "clip"
    if hasattr(sb3_policy.actor, "latent_pi"):
        return [*sb3_policy.actor.latent_pi, sb3_policy.actor.mu], "tanh"
    return [*sb3_policy.actor.mu], "tanh"
