"""The safety filter."""

import math
from dataclasses import dataclass, field

import numpy as np

from controllers.numerics.dynamics import forward_dynamics, inverse_dynamics
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import Pair
from fbl_gym.records.record import Record, number, pair


@dataclass(frozen=True)
class Barrier(Record):
    """The safety filter: the torque nearest to the wanted one that keeps the constraints.

    Each bound has a control barrier function h, which is positive inside: the distance to the
    bound. A position's h obeys h'' + 2 d h' + d^2 h >= 0, a velocity's h' + d h >= 0, with the
    decay d (Nguyen and Sreenath, "Exponential control barrier functions", ACC 2016; Ames et al.,
    "Control barrier functions: theory and applications", ECC 2019). The gains below place the poles
    of the sampled motion at z = exp(-d dt), since the torque is held for dt. All bounds together
    are a box for the acceleration. "Nearest" refers to the acceleration under the nominal model, so
    the solution of the quadratic program is the nearest point of a box: the wanted acceleration,
    clipped. Within the constraints of the interface, the torque is returned unchanged.

    The bounds hold for an exact model, exact readings, a drive without delay that can give the
    torque, and a fast rate. They also need a start inside, slow enough to brake: h' + d h >= 0.

    Args:
        interface: of the policy. Without constraints in it, no torque is changed.
        decay: d. A larger one brakes later and harder.
        margin: distance that is kept from the bounds of the position.
    """

    interface: Interface = field(repr=False)
    decay: float = number(10.0, unit="1/s", above=0, tune=(2.0, 50.0))
    margin: Pair | float = pair(0.0, unit="rad", low=0)

    def filtered(self, torque: Array, position: Array, velocity: Array) -> Array:
        """Return the nearest safe torque [n x 2] N m to a torque at a state, [n x 2] each."""
        if self.interface.constraints is None:
            return torque
        arm, (low, high) = self.interface.nominal, self.accelerations(position, velocity)
        wanted = forward_dynamics(arm, position, velocity, self.interface.saturate(torque))
        nearest = np.minimum(np.maximum(wanted, low), high)
        changes = (nearest != wanted).any(axis=-1, keepdims=True)
        return np.where(changes, inverse_dynamics(arm, position, velocity, nearest), torque)

    def accelerations(self, position: Array, velocity: Array) -> tuple[Array, Array]:
        """Return the least and the largest safe acceleration [n x 2] at a state, [n x 2] each.

        Outside of the constraints the box may be empty; then the bounds of the position count.
        """
        low, high, fastest = self.interface.constraints.bounds  # type: ignore[union-attr]
        low, high, dt = low + np.array(self.margin), high - np.array(self.margin), self.interface.control_dt
        z = math.exp(-self.decay * dt)
        # det(s I - F + G K) = (s - z)^2 of the double integrator held between samples
        k1, k2, k = (1.0 - z) ** 2 / dt**2, (1.0 - z) * (3.0 + z) / (2.0 * dt), (1.0 - z) / dt
        least, most = (k1 * (bound - position) - k2 * velocity for bound in (low, high))
        slowest, quickest = -k * (fastest + velocity), k * (fastest - velocity)
        return np.minimum(np.maximum(least, slowest), most), np.maximum(np.minimum(most, quickest), least)
