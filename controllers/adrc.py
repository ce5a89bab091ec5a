"""Active disturbance rejection: an observer sees what the model misses, and the law cancels it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.feedback_linearization import linearize
from controllers.observer import ExtendedStateObserver
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, forward_dynamics
from fbl_gym.checks import Pair, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class Adrc(TorqueLaw):
    """a = r'' + wc^2 (r - q) + 2 wc (r' - v) - f, through the nominal mapping, with q, v and f from the observer.

    Gao's linear form of Han's law, on the position sensor alone. Its b0 is the inverse of the full nominal inertia, at the
    estimated position, and nominal Coriolis and gravity torques are known parts: with an exact model f is then zero, and
    the joints are decoupled; with a diagonal b0 the observer would have to find the coupling, at the speed of the motion
    itself. The observer is driven by the torque within its limits, so that it does not take saturation for a disturbance.

    Args:
        controller_bandwidth: wc [rad/s], per joint: both poles of the tracking error.
        observer_bandwidth: w [rad/s], per joint: all poles of the observer; several times wc.
    """

    controller_bandwidth: Pair | float = 10.0
    observer_bandwidth: Pair | float = 80.0

    needs: ClassVar[tuple[str, ...]] = ("position",)
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"controller_bandwidth": (2.0, 30.0), "observer_bandwidth": (15.0, 200.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("controller_bandwidth", "observer_bandwidth"):
            set_fields(self, **{name: check_pair(name, getattr(self, name), above=0)})

    @property
    def observer(self) -> ExtendedStateObserver:
        return ExtendedStateObserver(
            self.interface.control_dt, check_pair("observer_bandwidth", self.observer_bandwidth)
        )

    def initial(self, observation: Array) -> State:
        return (self.observer.initial(*self.read(observation, "position", "reference_velocity")),)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        (position,) = self.read(observation, "position")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        estimate = self.observer.correct(state[0], position)
        q, v, f = np.moveaxis(estimate, -1, 0)
        w = np.array(self.controller_bandwidth)
        torque = linearize(self.interface.nominal, q, v, r_ddot + w**2 * (r - q) + 2.0 * w * (r_dot - v) - f)
        # u: what the model makes of the torque that is applied.
        u = forward_dynamics(self.interface.nominal, q, v, self.interface.saturate(torque))
        return torque, (self.observer.foresee(estimate, u),)
