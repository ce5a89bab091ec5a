"""Computed torque with a momentum-based disturbance observer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.computed_torque import ComputedTorque
from controllers.feedback_linearization import linearize
from controllers.policy import State
from fbl_gym.arm import Array, coriolis_matrix, gravity_torque, inertia_matrix
from fbl_gym.checks import check_number
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class ComputedTorqueDob(ComputedTorque):
    """Computed torque, plus what the generalised momentum p = M(q) v says is missing.

    De Luca, Albu-Schaeffer, Haddadin and Hirzinger, "Collision detection and safe reaction with the DLR-III lightweight robot
    arm", IROS 2006: p' = torque + C'v - G - d, with the skew form of C, so that no acceleration is needed. The
    estimate of d is a first-order filter of what the momentum lacks over each interval, with the time constant 1 / bandwidth;
    it is driven by the torque that was applied, so it does not wind up. Errors of the model count as disturbance.

    Args:
        frequency: as in `ComputedTorque`.
        bandwidth: of the observer [rad/s].
    """

    bandwidth: float = 30.0

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {**ComputedTorque.ranges, "bandwidth": (2.0, 200.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        set_fields(self, bandwidth=check_number("bandwidth", self.bandwidth, above=0))

    def initial(self, observation: Array) -> State:
        zeros = np.zeros((len(observation), 2))
        # The disturbance, the momentum and the drift of the last sample, the torque since, and whether there was one.
        return zeros, zeros, zeros, zeros, np.zeros(len(observation), dtype=bool)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        disturbance, momentum, drift, applied, begun = state
        q, v = self.read(observation, "position", "velocity")
        model, dt = self.interface.nominal, self.interface.control_dt
        new_momentum = np.einsum("nij,nj->ni", inertia_matrix(model, q), v)
        new_drift = np.einsum("nji,nj->ni", coriolis_matrix(model, q, v, skew=True), v) - gravity_torque(model, q)
        # p' = torque + (C'v - G) - d, over the interval that ends now.
        missing = applied + 0.5 * (drift + new_drift) - (new_momentum - momentum) / dt
        keep = np.exp(-self.bandwidth * dt)
        disturbance = np.where(begun[:, None], keep * disturbance + (1.0 - keep) * missing, disturbance)
        torque = linearize(model, q, v, self.wished(observation, q, v)) + disturbance
        now = np.ones_like(begun)
        return torque, (disturbance, new_momentum, new_drift, self.interface.saturate(torque), now)
