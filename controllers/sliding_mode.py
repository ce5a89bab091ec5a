"""Super-twisting sliding mode on the nominal linearisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.feedback_linearization import linearize, winds_up
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.checks import Pair, check_number, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class SuperTwisting(TorqueLaw):
    """a = r'' + slope e' + k1 |s|^(1/2) sign(s) + z,  z' = k2 sign(s),  with  s = e' + slope e.

    Levant, "Sliding order and sliding accuracy in sliding mode control", Int. J. Control 58(6), 1993; gains k1 = 1.5 L^(1/2)
    and k2 = 1.1 L, for which a quadratic strict Lyapunov function exists while the perturbation's derivative stays below
    0.96 L: Moreno and Osorio, "Strict Lyapunov functions for the super-twisting algorithm", IEEE TAC 57(4), 2012. A sampled
    sign chatters; within the boundary layer it is replaced by s / layer, which trades the finite-time convergence for calm.

    Args:
        slope: of the sliding surface [1/s], per joint.
        bound: L [rad/s^3], per joint.
        layer: half width of the boundary layer [rad/s]; 0: the plain sign.
    """

    slope: Pair | float = 15.0
    bound: Pair | float = 150.0
    layer: float = 0.1

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"slope": (2.0, 80.0), "bound": (5.0, 5000.0), "layer": (0.005, 1.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        set_fields(
            self,
            slope=check_pair("slope", self.slope, above=0),
            bound=check_pair("bound", self.bound, above=0),
            layer=check_number("layer", self.layer, low=0),
        )

    def initial(self, observation: Array) -> State:
        return (np.zeros((len(observation), 2)),)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        (z,) = state
        q, v = self.read(observation, "position", "velocity")
        r, dr, ddr = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        slope, bound = np.array(self.slope), np.array(self.bound)
        s = dr - v + slope * (r - q)
        sign = np.sign(s) if self.layer == 0.0 else np.clip(s / self.layer, -1.0, 1.0)
        a = ddr + slope * (dr - v) + 1.5 * np.sqrt(bound * np.abs(s)) * sign + z
        torque = linearize(self.interface.nominal, q, v, a)
        pause = winds_up(self.interface, self.interface.nominal, q, v, a, torque, sign)
        return torque, (z + np.where(pause, 0.0, 1.1 * bound * sign * self.interface.control_dt),)
