"""Adaptive computed torque after Craig, Hsu and Sastry."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.base import State
from controllers.laws.passivity import SlotineLi, SlotineLiState, friction_regressor
from fbl_gym.model.arm import Array, inertia_matrix, regressor, with_rotors


@dataclass(frozen=True)
class ComputedTorqueAdaptive(SlotineLi):
    """Computed torque on an estimated model, whose estimates follow the tracking error.

        torque = M^ a + C^ v + G^ + friction^,    a = r'' + (slope + damping) e' + slope damping e
        p^' = Gamma Y(q, v, q'')' M^^-1 W s,    s = e' + slope e

    The error obeys s' + damping s = M^^-1 Y (p - p^). With W the diagonal of the stretched nominal
    inertia, V = (s'W s + (p - p^)' Gamma^-1 (p - p^)) / 2 falls by damping s'W s. Parameters, box
    and gains are those of `SlotineLi`. M^ is inverted, so p3 stays below 0.95 (p1 p2)^(1/2), which
    keeps it positive definite.

    Sensors: position, velocity and acceleration. Source: Craig, Hsu and Sastry, "Adaptive control
    of mechanical manipulators", Int. J. Robotics Research 6(2), 1987.

    Args:
        slope, damping, adaptation, friction, reach: as in `SlotineLi`. The poles of the error are
            -slope and -damping.
    """

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next estimates."""
        q, v, acceleration = self.read(observation, "position", "velocity", "acceleration")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        slope, estimate, rotor = np.array(self.slope), state.estimate, np.array(self.interface.nominal.rotor)
        s = r_dot - v + slope * (r - q)
        a = r_ddot + slope * (r_dot - v) + self.damping * s
        friction = friction_regressor(v)
        y, measured = (np.concatenate([regressor(q, v, x), friction], axis=-1) for x in (a, acceleration))
        torque = np.einsum("nij,nj->ni", y, estimate) + rotor * a
        inertia = inertia_matrix(with_rotors(estimate[:, :5], rotor), q)
        weighted = np.linalg.solve(inertia, (self.stretched * s)[..., None])[..., 0]
        change = self.rates * np.einsum("nij,ni->nj", measured, weighted)
        free = np.all(self.interface.saturate(torque) == torque, axis=-1, keepdims=True)
        estimate = np.clip(estimate + self.interface.control_dt * np.where(free, change, 0.0), *self.box)
        most = 0.95 * np.sqrt(estimate[:, 0] * estimate[:, 1])
        estimate[:, 2] = np.clip(estimate[:, 2], -most, most)
        return torque, SlotineLiState(estimate)
