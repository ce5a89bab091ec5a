"""Slotine and Li's adaptive law on the lumped parameters of the arm, and its composite form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.passivity import drift_regressor, momentum_regressor, slotine_li_regressor
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, inertia_matrix
from fbl_gym.checks import Pair
from fbl_gym.records import number, pair


@dataclass(frozen=True)
class SlotineLi(TorqueLaw):
    """Slotine and Li's adaptive law.

        torque = Y p^ + K s,    p^' = Gamma Y' s,    s = e' + slope e

    Y is the regressor along the reference motion v_r = r' + slope e, a_r = r'' + slope e'. Gains
    scale with the nominal arm: K = damping M(q), Gamma_i = adaptation p_i^2 / p_1. The inertia of
    the rotors is known: they add their torque to Y p^.
    V = s'Ms/2 + (p^ - p)'Gamma^-1 (p^ - p)/2 has V' = -s'Ks, so the error goes to zero for every
    constant arm without friction and disturbance; the estimates need an exciting motion to
    converge. Estimates stay physical and within a factor `reach` of the nominal ones. Where the
    torque saturates, they are held.

    With `composite` > 0 the error of predicting the filtered torque drives the estimates too,
    normalised by the regressor's size (Slotine and Li, "Composite adaptive control of robot
    manipulators", Automatica 25(4), 1989). The prediction uses momentum in place of acceleration.

    Sensors: position and velocity. Source: Slotine and Li, "On the adaptive control of robot
    manipulators", Int. J. Robotics Research 6(3), 1987; "Applied Nonlinear Control", 1991, §9.2.

    Args:
        slope: of the sliding surface [1/s], per joint.
        damping: K over the nominal inertia [1/s].
        adaptation: gain of the estimates.
        composite: gain of the prediction error [1/s]; 0: none.
        filtering: bandwidth of the filter of the prediction [rad/s].
        reach: largest factor between an estimate and its nominal value.
    """

    slope: Pair | float = pair(10.0, unit="1/s", above=0, tune=(2.0, 80.0))
    damping: float = number(15.0, unit="1/s", above=0, tune=(5.0, 150.0))
    adaptation: float = number(1.0, low=0, tune=(0.1, 300.0))
    composite: float = number(0.0, unit="1/s", low=0)
    filtering: float = number(20.0, unit="rad/s", above=0)
    reach: float = number(16.0, above=1)

    @property
    def rates(self) -> Array:
        """Diagonal of Gamma [5]."""
        nominal = self.interface.nominal.lumped
        return self.adaptation * nominal**2 / nominal[0]

    def initial(self, observation: Array) -> State:
        """Return the state; see the comments for its parts."""
        n = len(observation)
        q, v = self.read(observation, "position", "velocity")
        return (
            np.broadcast_to(self.interface.nominal.lumped, (n, 5)).copy(),  # estimate
            momentum_regressor(q, v),  # at the last sample
            drift_regressor(q, v),  # at the last sample
            np.zeros((n, 2, 5)),  # filtered regressor
            np.zeros((n, 2)),  # filtered torque, without the rotors' part
            np.zeros((n, 2)),  # torque applied since the last sample
            np.zeros(n, dtype=bool),  # False before the first sample
        )

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        estimate, momentum, drift, w, filtered, applied, started = state
        q, v = self.read(observation, "position", "velocity")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        slope, dt = np.array(self.slope), self.interface.control_dt
        v_r, a_r = r_dot + slope * (r - q), r_ddot + slope * (r_dot - v)
        s = v_r - v
        y = slotine_li_regressor(q, v, v_r, a_r)
        gain = self.damping * inertia_matrix(self.interface.nominal, q)
        rotor = np.array(self.interface.nominal.rotor)
        torque = np.einsum("nij,nj->ni", y, estimate) + np.einsum("nij,nj->ni", gain, s) + rotor * a_r

        # Over the interval that ends now, torque = d/dt (M v) + (G - C'v); both sides are filtered.
        new_momentum, new_drift = momentum_regressor(q, v), drift_regressor(q, v)
        mean = (new_momentum - momentum) / dt + 0.5 * (new_drift + drift)
        keep = np.where(started, np.exp(-self.filtering * dt), 1.0)[:, None]
        w = keep[..., None] * w + (1.0 - keep[..., None]) * mean
        turned = rotor * (v - _velocity(momentum)) / dt
        filtered = keep * filtered + (1.0 - keep) * (applied - turned)

        change = np.einsum("nij,ni->nj", y, s) * self.rates
        if self.composite > 0.0:
            missed = np.einsum("nij,nj->ni", w, estimate) - filtered
            shares = w * np.sqrt(self.rates)
            size = 1.0 + np.einsum("nij,nij->n", shares, shares)[:, None]
            change = change - self.composite * np.einsum("nij,ni->nj", w, missed) * self.rates / size
        applied = self.interface.saturate(torque)
        free = np.all(applied == torque, axis=-1, keepdims=True)
        estimate = self.project(estimate + dt * np.where(free, change, 0.0))
        return torque, (estimate, new_momentum, new_drift, w, filtered, applied, np.ones_like(started))

    def project(self, estimate: Array) -> Array:
        """Return the estimate [n x 5], clipped to be within reach and physical: p1 p2 > p3^2."""
        nominal = self.interface.nominal.lumped
        projected = np.clip(estimate, nominal / self.reach, nominal * self.reach)
        projected[:, 2] = np.minimum(projected[:, 2], 0.95 * np.sqrt(projected[:, 0] * projected[:, 1]))
        return projected


def _velocity(momentum: Array) -> Array:
    """Return the velocity [n x 2]; the first columns of a momentum regressor are v1 and v1 + v2."""
    return np.stack([momentum[:, 0, 0], momentum[:, 0, 1] - momentum[:, 0, 0]], axis=-1)


@dataclass(frozen=True)
class CompositeSlotineLi(SlotineLi):
    """`SlotineLi` with the prediction error on, and its gain tuned.

    Args:
        slope, damping, adaptation, filtering, reach: as in `SlotineLi`.
        composite: gain of the prediction error [1/s].
    """

    composite: float = number(3.0, unit="1/s", low=0, tune=(0.1, 100.0))
