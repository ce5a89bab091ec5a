"""The predictor of a late drive."""

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

from controllers.parts.drive import Drive
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
        drive: of the interface.
        lead: share of the lag that is inverted.
    """

    drive: Drive = dataclasses.field(repr=False)
    lead: float = number(0.5, low=0, high=1, tune=(0.05, 1.0))

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
