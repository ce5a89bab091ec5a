"""Computed torque: the textbook's law for an arm whose model is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.feedback_linearization import linearize
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.checks import Pair, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class ComputedTorque(TorqueLaw):
    """torque = M(q) a + C v + G  with  a = r'' + w^2 e + 2 w e', critically damped.

    Siciliano, Sciavicco, Villani and Oriolo, "Robotics: Modelling, Planning and Control", 2009, §8.5.2. With an exact model
    the error obeys e'' + 2 w e' + w^2 e = 0.

    Args:
        frequency: w [rad/s], per joint.
    """

    frequency: Pair | float = 20.0

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({"frequency": (2.0, 150.0)})

    def __post_init__(self) -> None:
        super().__post_init__()
        set_fields(self, frequency=check_pair("frequency", self.frequency, above=0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        q, v = self.read(observation, "position", "velocity")
        return linearize(self.interface.nominal, q, v, self.wished(observation, q, v)), state

    def wished(self, observation: Array, q: Array, v: Array) -> Array:
        """The acceleration a [n x 2]."""
        r, dr, ddr = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        w = np.array(self.frequency)
        return ddr + w**2 * (r - q) + 2.0 * w * (dr - v)
