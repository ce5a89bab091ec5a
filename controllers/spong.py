"""Spong's robust law: parameters within a bound, and a torque that beats the worst of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.passivity import slotine_li_regressor
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, inertia_matrix
from fbl_gym.checks import Pair, check_number, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class SpongRobust(TorqueLaw):
    """torque = Y (p^ + u) + K s, where u_i is the bound of parameter i, signed as (Y's)_i, and fades within a boundary layer.

    Spong, "On the robust control of robot manipulators", IEEE TAC 37(11), 1992, in the form with a bound for each parameter:
    u_i = bound p^_i sat((Y's)_i p^_i / (epsilon p1)). Where every parameter is within its bound, V = s'Ms/2 has
    V' <= -s'Ks + (5/4) bound epsilon p1, so that s ends in a set that shrinks with epsilon.

    Args:
        slope: of the surface s = e' + slope e [1/s], per joint.
        damping: K over the nominal inertia [1/s].
        bound: how far each lumped parameter may be off, as a share of the nominal one.
        epsilon: of the boundary layer, over the nominal inertia p1 [1/s^3]: a power for a unit of inertia.
    """

    slope: Pair | float = 10.0
    damping: float = 20.0
    bound: float = 1.0
    epsilon: float = 1.0

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"slope": (2.0, 80.0), "damping": (5.0, 150.0), "bound": (0.1, 8.0), "epsilon": (0.03, 100.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        set_fields(
            self,
            slope=check_pair("slope", self.slope, above=0),
            damping=check_number("damping", self.damping, above=0),
            bound=check_number("bound", self.bound, low=0),
            epsilon=check_number("epsilon", self.epsilon, above=0),
        )

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        q, v = self.read(observation, "position", "velocity")
        r, dr, ddr = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        slope, nominal = np.array(self.slope), self.interface.nominal.lumped
        v_r, a_r = dr + slope * (r - q), ddr + slope * (dr - v)
        s = v_r - v
        y = slotine_li_regressor(q, v, v_r, a_r)
        power = np.einsum("nij,ni->nj", y, s) * nominal
        u = self.bound * nominal * np.clip(power / (self.epsilon * nominal[0]), -1.0, 1.0)
        gain = self.damping * inertia_matrix(self.interface.nominal, q)
        return np.einsum("nij,nj->ni", y, nominal + u) + np.einsum("nij,nj->ni", gain, s), state
