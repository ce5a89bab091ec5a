"""Spong's robust law: a torque that holds against all parameters within a bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.passivity import slotine_li_regressor
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, inertia_matrix
from fbl_gym.checks import Pair
from fbl_gym.records import number, pair


@dataclass(frozen=True)
class SpongRobust(TorqueLaw):
    """Spong's robust law, with a bound for each lumped parameter.

        torque = Y (p^ + u) + K s,    s = e' + slope e
        u_i = bound p^_i sat((Y's)_i p^_i / (epsilon p1))

    Y is the regressor along the reference motion v_r = r' + slope e, p^ the nominal lumped
    parameters, and sat clips to [-1, 1]. A known rotor inertia adds its torque rotor a_r. Where
    every parameter is within its bound, V = s'Ms/2 has V' <= -s'Ks + (5/4) bound epsilon p1, so s
    ends in a set that shrinks with epsilon.

    Sensors: position and velocity. Source: Spong, "On the robust control of robot manipulators",
    IEEE TAC 37(11), 1992.

    Args:
        slope: of the surface s = e' + slope e [1/s], per joint.
        damping: K over the nominal inertia [1/s].
        bound: largest deviation of a lumped parameter, as a share of the nominal one.
        epsilon: width of the boundary layer over the nominal inertia p1 [1/s^3]. A small one tracks
            closer and chatters more.
    """

    slope: Pair | float = pair(10.0, unit="1/s", above=0, tune=(2.0, 80.0))
    damping: float = number(15.0, unit="1/s", above=0, tune=(5.0, 150.0))
    bound: float = number(1.0, low=0, tune=(0.1, 8.0))
    epsilon: float = number(20.0, unit="1/s^3", above=0, tune=(0.03, 100.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m; there is no state."""
        q, v = self.read(observation, "position", "velocity")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        slope, nominal = np.array(self.slope), self.interface.nominal.lumped
        v_r, a_r = r_dot + slope * (r - q), r_ddot + slope * (r_dot - v)
        s = v_r - v
        y = slotine_li_regressor(q, v, v_r, a_r)
        power = np.einsum("nij,ni->nj", y, s) * nominal
        u = self.bound * nominal * np.clip(power / (self.epsilon * nominal[0]), -1.0, 1.0)
        gain = self.damping * inertia_matrix(self.interface.nominal, q)
        torque = np.einsum("nij,nj->ni", y, nominal + u) + np.einsum("nij,nj->ni", gain, s)
        return torque + np.array(self.interface.nominal.rotor) * a_r, state
