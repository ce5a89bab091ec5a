"""Time-delay control: what the model missed a moment ago, it misses now.

Youcef-Toumi and Ito 1990, "A time delay controller for systems with unknown dynamics", J. Dyn. Sys. Meas. Control 112(1); Hsia
1989, "A new technique for robust control of servo systems", IEEE TIE 36(1). The same law flies as incremental nonlinear dynamic
inversion (Sieberling, Chu and Mulder 2010, "Robust flight control using incremental nonlinear dynamic inversion and angular
acceleration prediction", JGCD 33(6)).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, gravity_torque, inverse_dynamics
from fbl_gym.checks import Pair, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class TimeDelay(TorqueLaw):
    """torque = M a + C v + G + d with a = r'' + w^2 e + 2 w e', where d is the torque that the nominal model missed.

    The accelerometer tells what the last torque did: d = LP(tau_0 - (M a_0 + C v + G)), torque and acceleration through the
    same low-pass filter LP, so that neither runs ahead of the other. Without the filter d cancels C v + G, and what is left
    is the incremental law tau = tau_0 + M (a - a_0).

    With a real inertia of M / k the estimate has the pole 1 - k h per sample, h = 1 - exp(-g dt), and the loop (w^2 dt^2
    neglected) is stable for k < 2 / (h + 2 w dt - h w dt). Without the filter, and with slow poles, that is Hsia's k < 2.

    Args:
        frequency: w [rad/s], per joint: both poles of the tracking error.
        bandwidth: g of the filter [rad/s], per joint.
    """

    frequency: Pair | float = 15.0
    bandwidth: Pair | float = 12.0

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"frequency": (2.0, 40.0), "bandwidth": (5.0, 200.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("frequency", "bandwidth"):
            set_fields(self, **{name: check_pair(name, getattr(self, name), above=0)})

    def initial(self, observation: Array) -> State:
        # An arm starts under the torque that would hold the nominal one still.
        (q,) = self.read(observation, "position")
        return np.zeros_like(q), self.interface.saturate(gravity_torque(self.interface.nominal, q))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        missed, applied = state
        q, v, a = self.read(observation, "position", "velocity", "acceleration")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        nominal, w = self.interface.nominal, np.array(self.frequency)
        # d = d + (1 - exp(-g dt)) (tau_0 - (M a_0 + C v + G) - d)
        share = -np.expm1(-np.array(self.bandwidth) * self.interface.control_dt)
        missed = missed + share * (applied - inverse_dynamics(nominal, q, v, a) - missed)
        wished = r_ddot + w**2 * (r - q) + 2.0 * w * (r_dot - v)
        torque = inverse_dynamics(nominal, q, v, wished) + missed
        return torque, (missed, self.interface.saturate(torque))
