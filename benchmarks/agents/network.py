"""The actor network of an agent, compiled: it computes the same bits on every machine.

Libraries of linear algebra round a product of matrices differently. Here each sum has one order, as
in the kernel.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fbl_gym.kernel.maths.fastmath import cached_njit, exp, fma, kernel_njit
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import check_choice

_FUNCTIONS = ("clip", "relu", "tanh")


@kernel_njit
def _layer(x, weights, function, y):
    """Set y = function(bias + weight' x), by the index of one of `_FUNCTIONS`.

    The bias is the first row of the weights [1 + inputs x outputs].
    """
    for o in range(len(y)):
        y[o] = weights[0, o]
    for i in range(len(weights) - 1):
        for o in range(len(y)):
            y[o] = fma(x[i], weights[i + 1, o], y[o])
    for o in range(len(y)):
        if function == 0:
            y[o] = min(max(y[o], -1.0), 1.0)
        elif function == 1:
            y[o] = max(y[o], 0.0)
        else:  # tanh, within 3e-16
            power = exp(-2.0 * y[o])
            y[o] = (1.0 - power) / (1.0 + power)


@cached_njit
def _forward(observation, weights, sizes, functions):
    """Return the outputs of the last layer [n x sizes[-1]].

    Args:
        observation: [n x sizes[0]].
        weights: of each layer in turn, [inputs + 1 x outputs], the bias in the first row.
        sizes: number of inputs, then the number of outputs of each layer.
        functions: index in `_FUNCTIONS` of the function after each layer.
    """
    actions = np.empty((len(observation), sizes[-1]))
    hidden = np.empty((2, sizes.max()))
    for lane in range(len(observation)):
        x, place = observation[lane], 0
        for layer in range(len(functions)):
            rows, outputs = sizes[layer] + 1, sizes[layer + 1]
            y = actions[lane] if layer == len(functions) - 1 else hidden[layer % 2, :outputs]
            _layer(x, weights[place : place + rows * outputs].reshape(rows, outputs), functions[layer], y)
            x, place = y, place + rows * outputs
    return actions


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
        check_choice("activation", self.activation, ("tanh", "relu"))
        check_choice("output", self.output, ("clip", "tanh"))

    @cached_property
    def _compiled(self) -> tuple[Array, Any, Any]:
        """The arguments of the forward pass after the observation."""
        rows = [np.vstack([bias, weight.T]) for weight, bias in self.layers]
        functions = [_FUNCTIONS.index(name) for name in (*[self.activation] * (len(rows) - 1), self.output)]
        sizes = np.array([len(rows[0]) - 1, *(row.shape[1] for row in rows)])
        return np.concatenate([row.ravel() for row in rows]), sizes, np.array(functions)

    def __call__(self, observation: Array) -> Array:
        """Return the action [n x 2]. A lane has the same bits alone and in a batch."""
        inputs = self.layers[0][0].shape[1]
        if observation.shape[1] != inputs:
            raise ValueError(f"observation must have {inputs} entries for this network, got {observation.shape[1]}")
        return _forward(np.ascontiguousarray(observation), *self._compiled)
