"""Slotine and Li's adaptive law, on the lumped parameters of the arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.passivity import drift_regressor, momentum_regressor, slotine_li_regressor
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, inertia_matrix
from fbl_gym.checks import Pair, check_number, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class SlotineLi(TorqueLaw):
    """torque = Y p^ + K s  and  p^' = Gamma Y' s  with  s = e' + slope e  and  v_r = r' + slope e, a_r = r'' + slope e'.

    Slotine and Li, "On the adaptive control of robot manipulators", Int. J. Robotics Research 6(3), 1987; "Applied Nonlinear
    Control", 1991, §9.2. With V = s'Ms/2 + (p^ - p)'Gamma^-1 (p^ - p)/2, V' = -s'Ks. Gains scale with the nominal arm:
    K = damping M(q), Gamma_i = adaptation p_i^2 / p_1. Estimates stay within a factor of `reach` of the nominal ones and
    those of an arm with positive inertia; where the torque saturates, nothing is learned.

    With `composite` > 0 the error of predicting the filtered torque drives the estimates too (Slotine and Li, "Composite
    adaptive control of robot manipulators", Automatica 25(4), 1989), normalised by the regressor's size; momentum in place of
    acceleration makes the prediction.

    Args:
        slope: of the sliding surface [1/s], per joint.
        damping: K over the nominal inertia [1/s].
        adaptation: gain of the estimates.
        composite: gain of the prediction error [1/s]; 0: none.
        filtering: bandwidth of the filter of the prediction [rad/s].
        reach: largest factor between an estimate and its nominal value.
    """

    slope: Pair | float = 10.0
    damping: float = 20.0
    adaptation: float = 3.0
    composite: float = 0.0
    filtering: float = 20.0
    reach: float = 16.0

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"slope": (2.0, 80.0), "damping": (5.0, 150.0), "adaptation": (0.1, 300.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        set_fields(
            self,
            slope=check_pair("slope", self.slope, above=0),
            damping=check_number("damping", self.damping, above=0),
            adaptation=check_number("adaptation", self.adaptation, low=0),
            composite=check_number("composite", self.composite, low=0),
            filtering=check_number("filtering", self.filtering, above=0),
            reach=check_number("reach", self.reach, above=1),
        )

    @property
    def rates(self) -> Array:
        """The diagonal of Gamma [5]."""
        nominal = self.interface.nominal.lumped
        return self.adaptation * nominal**2 / nominal[0]

    def initial(self, observation: Array) -> State:
        n = len(observation)
        q, v = self.read(observation, "position", "velocity")
        return (
            np.broadcast_to(self.interface.nominal.lumped, (n, 5)).copy(),
            momentum_regressor(q, v),  # of the last sample
            drift_regressor(q, v),  # likewise
            np.zeros((n, 2, 5)),  # filtered regressor
            np.zeros((n, 2)),  # filtered torque
            np.zeros((n, 2)),  # torque applied since the last sample
            np.zeros(n, dtype=bool),  # whether there was one
        )

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        estimate, momentum, drift, w, filtered, applied, begun = state
        q, v = self.read(observation, "position", "velocity")
        r, dr, ddr = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        slope, dt = np.array(self.slope), self.interface.control_dt
        v_r, a_r = dr + slope * (r - q), ddr + slope * (dr - v)
        s = v_r - v
        y = slotine_li_regressor(q, v, v_r, a_r)
        gain = self.damping * inertia_matrix(self.interface.nominal, q)
        torque = np.einsum("nij,nj->ni", y, estimate) + np.einsum("nij,nj->ni", gain, s)

        # Over the interval that ends now, the torque was d/dt (M v) + (G - C'v); both sides pass the same filter.
        now, now_drift = momentum_regressor(q, v), drift_regressor(q, v)
        lasted = (now - momentum) / dt + 0.5 * (now_drift + drift)
        keep = np.where(begun, np.exp(-self.filtering * dt), 1.0)[:, None]
        w = keep[..., None] * w + (1.0 - keep[..., None]) * lasted
        filtered = keep * filtered + (1.0 - keep) * applied

        change = np.einsum("nij,ni->nj", y, s) * self.rates
        if self.composite > 0.0:
            missed = np.einsum("nij,nj->ni", w, estimate) - filtered
            shares = w * np.sqrt(self.rates)
            size = 1.0 + np.einsum("nij,nij->n", shares, shares)[:, None]
            change = change - self.composite * np.einsum("nij,ni->nj", w, missed) * self.rates / size
        applied = self.interface.saturate(torque)
        free = np.all(applied == torque, axis=-1, keepdims=True)
        estimate = self.project(estimate + dt * np.where(free, change, 0.0))
        return torque, (estimate, now, now_drift, w, filtered, applied, np.ones_like(begun))

    def project(self, estimate: Array) -> Array:
        """The nearest parameters, one by one, within reach and of an arm: p1 p2 > p3^2.  [n x 5]."""
        nominal = self.interface.nominal.lumped
        found = np.clip(estimate, nominal / self.reach, nominal * self.reach)
        found[:, 2] = np.minimum(found[:, 2], 0.95 * np.sqrt(found[:, 0] * found[:, 1]))
        return found


@dataclass(frozen=True)
class CompositeSlotineLi(SlotineLi):
    """`SlotineLi` with the prediction error on."""

    composite: float = 3.0

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {**SlotineLi.ranges, "composite": (0.1, 100.0)}
    )
