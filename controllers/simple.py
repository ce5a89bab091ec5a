"""The floor of the board: no torque at all, and PD with gravity compensation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, gravity_torque, inertia_matrix
from fbl_gym.checks import Pair, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class Zero(TorqueLaw):
    """No torque. What an arm does that nobody drives."""

    needs: ClassVar[tuple[str, ...]] = ()
    access: ClassVar[str] = "none"

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        return np.zeros((len(observation), 2)), ()


@dataclass(frozen=True)
class PdGravity(TorqueLaw):
    """torque = Kp e + Kd e' + G(q), with the nominal gravity torque (Takegaki and Arimoto 1981).

    The gains are those of a critically damped (by default) second-order system of the given frequency on the diagonal of the
    stretched arm's nominal inertia: Kp = w^2 M_ii, Kd = 2 damping w M_ii.

    Args:
        frequency: w [rad/s], per joint.
        damping: ratio, per joint.
    """

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"frequency": (2.0, 100.0), "damping": (0.3, 3.0)}
    )

    frequency: Pair | float = 10.0
    damping: Pair | float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        set_fields(self, frequency=check_pair("frequency", self.frequency), damping=check_pair("damping", self.damping))

    @cached_property
    def inertia(self) -> Array:
        """M_ii of the stretched nominal arm [2], kg m^2."""
        return np.diagonal(inertia_matrix(self.interface.nominal, (0.0, 0.0)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        q, v, r, r_dot = self.read(observation, "position", "velocity", "reference_position", "reference_velocity")
        w = np.array(self.frequency)
        kp, kd = w**2 * self.inertia, 2.0 * np.array(self.damping) * w * self.inertia
        return kp * (r - q) + kd * (r_dot - v) + gravity_torque(self.interface.nominal, q), ()
