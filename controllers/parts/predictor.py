"""The predictor of a late drive."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from controllers.numerics.dynamics import forward_dynamics
from controllers.parts.drive import Acting, Drive
from controllers.preview import Places, between, places
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array
from fbl_gym.records.record import Record, number


@dataclass(frozen=True)
class Predictor(Record):
    """The predictor: a law gets motion and reference of the time at which its torque acts.

    The nominal model is integrated through the age of the readings, the delay and the lag, with the
    torques under way. With an exact model the law acts as if there were no delay (Smith, "A
    controller to overcome dead time", ISA J. 6(2), 1959, in the state-space form of Manitius and
    Olbrot, IEEE TAC 24(4), 1979). The reference comes from the preview as far as it reaches; beyond
    (or without preview), the reference's acceleration is held.

    A share of the lag may be inverted in place of predicted: torque + k (wanted - torque) is
    commanded, and the torque on the joints approaches the wanted one with the time constant
    (1 - lead) lag. A large share amplifies the noise.

    Args:
        interface: of the policy.
        lead: share of the lag that is inverted.
    """

    interface: Interface = field(repr=False)
    lead: float = number(0.5, low=0, high=1, tune=(0.05, 1.0))

    @cached_property
    def drive(self) -> Drive:
        """The known drive."""
        return Drive.of(self.interface)

    @cached_property
    def gain(self) -> float:
        """k, from the torque wanted less the present one to the command; 1 without lead."""
        lag, dt, left = self.drive.lag, self.drive.dt, (1.0 - self.lead) * self.drive.lag
        if lag == 0.0:
            return 1.0
        return (1.0 if left == 0.0 else -math.expm1(-dt / left)) / -math.expm1(-dt / lag)

    @cached_property
    def lateness(self) -> float:
        """Mean time by which the torque on the joints follows the wanted one [s]."""
        lag, dt = self.drive.lag, self.drive.dt
        if lag == 0.0:
            return 0.0
        gap = -math.expm1(-dt / lag)
        # Area between the wanted torque and a step's response in the first interval; the later
        # ones are smaller by the same factor each.
        area = dt - self.gain * (dt - lag * gap)
        return area / (self.gain * gap)

    def motion(self, motion: dict[str, Array], f: Array, acting: Acting) -> tuple[dict[str, Array], Array]:
        """Return the motion at which a torque acts, and the torque due before it [n x 2] N m.

        Args:
            motion: position, velocity and acceleration at the last reading, [n x 2] each.
            f: the acceleration that the model does not explain [n x 2] rad/s^2.
            acting: the torques at that reading.
        """
        arm, drive, (q, v, a) = self.interface.nominal, self.drive, motion.values()
        q_due, v_due, due = drive.predict(arm, q, v, f, acting.torque, drive.coming(acting.queue))
        q_then, v_then, torque = drive.predict(arm, q_due, v_due, f, due, [(self.lateness, acting.queue[:, 0])])
        a = forward_dynamics(arm, q_then, v_then, torque) + (a - forward_dynamics(arm, q, v, acting.torque))
        return {"position": q_then, "velocity": v_then, "acceleration": a}, due

    def reference(self, known: Array) -> Array:
        """Return the reference at that time and later [n x k x 6], from that of an observation."""
        return between(known, self._places, self.drive.dt)

    @cached_property
    def _places(self) -> Places:
        """Places of the law's reference in that of an observation."""
        samples = len(self.interface.layout.reference) // 6
        ahead = self.drive.delay - self.interface.latency + self.lateness
        return places(self.drive.dt, samples, ahead + self.drive.dt * np.arange(samples, dtype=float))
