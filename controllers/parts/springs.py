"""The reference of motors behind springs."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from controllers.numerics.dynamics import inverse_dynamics
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array
from fbl_gym.records.record import Record, number


@dataclass(frozen=True)
class Springs(Record):
    """The motion of the motors at which elastic joints carry the reference of the links.

    Where the encoders are on the motors, a law follows the motors, and the links stay behind by the
    deflection of the springs. The law therefore gets the reference r + d of the motors, with the
    deflection d = share K^-1 (M(r) r'' + C(r, r') r' + G(r)) under the nominal torque on the links
    and the stiffness K, the geometric middle of the datasheet (De Luca and Book, "Robots with
    flexible elements", Springer Handbook of Robotics, chapter 11: the inverse dynamics of elastic
    joints). Rate and acceleration of d are differences from sample to sample. With rigid joints, or
    encoders on the links, the reference stays.

    Args:
        interface: of the policy.
        share: of the deflection that the motors lead by.
    """

    interface: Interface = field(repr=False)
    share: float = number(1.0, low=0, high=2, tune=(0.5, 1.5))

    @cached_property
    def softness(self) -> Array | None:
        """The share over the stiffness [2] rad/(N m); None: nothing is left to do."""
        stiffness = self.interface.stiffness
        if stiffness is None or self.interface.encoder != "motor":
            return None
        return self.share / np.sqrt(np.prod(np.array(stiffness), axis=0))

    def moved(self, reference: Array, memory: Array) -> tuple[Array, Array]:
        """Return the reference of the motors.

        Args:
            reference: of the links, now and at coming samples [n x k x 6].
            memory: deflection and its rate at the last sample [n x 2 x 2]; infinite: none.

        Returns:
            The reference [n x k x 6] and the memory for the next sample.
        """
        if self.softness is None:
            return reference, memory
        dt, (r, r_dot, r_ddot) = self.interface.control_dt, np.split(reference, 3, axis=-1)
        # The rotors turn before the springs: the links alone bend them.
        bend = self.softness * inverse_dynamics(self.interface.nominal.lumped, r, r_dot, r_ddot)
        rate = np.diff(np.concatenate([memory[:, :1], bend], axis=1), axis=1) / dt
        change = np.diff(np.concatenate([memory[:, 1:], rate], axis=1), axis=1) / dt
        moved = np.concatenate([bend, *(np.where(np.isfinite(x), x, 0.0) for x in (rate, change))], axis=-1)
        return reference + moved, np.stack([bend[:, 0], rate[:, 0]], axis=1)
