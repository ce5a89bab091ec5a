"""The actor network of an agent in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fbl_gym.arm import Array
from fbl_gym.checks import check_choice

_ACTIVATIONS: dict[str, Callable[[Array], Array]] = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}
_OUTPUTS: dict[str, Callable[[Array], Array]] = {"clip": lambda x: np.clip(x, -1.0, 1.0), "tanh": np.tanh}

_BLOCK = 16
"""Observations that are multiplied at once."""


@dataclass(frozen=True, eq=False)
class Actor:
    """A multilayer perceptron from the agent's observation to its action in [-1, 1].

    Args:
        layers: weight [outputs x inputs] and bias [outputs] of each layer.
        activation: after every layer but the last: "tanh" or "relu".
        output: after the last layer: "clip" or "tanh".
    """

    layers: tuple[tuple[Array, Array], ...]
    activation: str
    output: str

    def __post_init__(self) -> None:
        check_choice("activation", self.activation, _ACTIVATIONS)
        check_choice("output", self.output, _OUTPUTS)

    def __call__(self, observation: Array) -> Array:
        """Return the action [n x 2]. A lane has the same bits alone and in a batch."""
        # The rounding of a product depends on the size of its matrices, so all have one size.
        count, inputs = observation.shape
        blocks = np.zeros((-(-count // _BLOCK), _BLOCK, inputs))
        blocks.reshape(-1, inputs)[:count] = observation
        *hidden, (weight, bias) = self.layers
        for w, b in hidden:
            blocks = _ACTIVATIONS[self.activation](blocks @ w.T + b)
        return _OUTPUTS[self.output](blocks @ weight.T + bias).reshape(-1, len(bias))[:count]
