"""Observations in error coordinates, for agents."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from fbl_gym.interface import Interface
from fbl_gym.kernel.step.api import subtract_and_scale
from fbl_gym.model.arm import Array
from fbl_gym.scenarios.classes import CLASSES

_CLIP = 10.0
#: Largest errors of position [rad] and velocity [rad/s] in an observation with fine scales.
WIDEST = 1.0, 10.0

_MOTION = ("position", "velocity", "acceleration")
_HANGING = np.array([-np.pi / 2, 0.0])

#: Scale of the drive's delay and lag in an agent's observation [s].
DRIVE_SCALE = 0.05


def drive_numbers(interface: Interface) -> Array:
    """Return the ends of delay and lag that the drive's datasheet states, and the class, [7]."""
    robot = [float(interface.robot_class == name) for name in CLASSES]
    return np.array([*np.divide([*interface.delay, *interface.lag], DRIVE_SCALE), *robot])


class ErrorScales:
    """The function from an observation to error coordinates.

    Each entry is divided by a fixed scale and clipped to [-10, 10]. The entries are, two of each:

    * tracking errors (reference less measured) of position, velocity and acceleration, for the
      sensors in `slots`;
    * measured position, less -pi/2 for joint 1, so that a hanging arm is at zero;
    * measured velocity;
    * acceleration of the reference;
    * for each previewed sample, its difference from the reference now (position, velocity,
      acceleration: six entries);
    * with `drive`, the seven `drive_numbers`;
    * previous actions as a share of their bound, the last first.

    Attributes:
        columns: see `kernel.step.api.subtract_and_scale`, [size x 5].

    Args:
        interface: of the environment.
        slots: names of the slots that are used, where the observation has them. The reference
            always is.
        scales: of the errors of position [rad], velocity [rad/s] and acceleration [rad/s^2].
        fine: None, or scales s of the errors of position and velocity in place of these: an error
            e within `WIDEST` is asinh(e / s), linear below s and logarithmic above.
        drive: True if `drive_numbers` are among the entries.
    """

    def __init__(
        self, interface: Interface, slots: Sequence[str] = ("position", "velocity", "preview", "previous_actions"),
        scales: Sequence[float] = (0.1, 1.0, 10.0), fine: Sequence[float] | None = None, drive: bool = False,
    ) -> None:  # fmt: skip
        used = {*slots, *(f"reference_{name}" for name in _MOTION)}
        every = {name: np.r_[interface.layout[name]] for name in used if name in interface.layout}
        parts = []

        def add(entries: Any, less: Any = -1, offset: Any = 0.0, scale: Any = 1.0, bound: Any = _CLIP) -> None:
            """Add the columns of entries, see `columns`; None: of none."""
            if entries is not None:
                numbers = (entries, less, offset, scale, bound)
                parts.append(np.stack([np.resize(value, entries.size) for value in numbers], axis=1))

        bounds = [_CLIP] * 3
        if fine is not None:
            bounds[:2] = np.arcsinh(np.divide(WIDEST, fine))
            fine = (*np.negative(fine), scales[2])

        now = [every[f"reference_{name}"] for name in _MOTION]
        for name, reference, scale, bound in zip(_MOTION, now, fine or scales, bounds, strict=True):
            if name in every:
                add(reference, every[name], scale=scale, bound=bound)
        add(every["position"], offset=_HANGING)
        add(every.get("velocity"))
        add(now[2], scale=scales[2])
        add(every.get("preview"), np.concatenate(now), scale=np.repeat(scales, 2))
        if drive:  # entry 0, less itself, less the negative of a number
            none = np.zeros(7, dtype=int)
            add(none, none, -drive_numbers(interface), bound=[_CLIP] * 4 + [1.0] * 3)
        add(every.get("previous_actions"), scale=[limit or 1.0 for limit in interface.action_limit], bound=1.0)
        self.columns = np.concatenate(parts)
        self.size = len(self.columns)
        self._numbers = self.columns.reshape(-1)  # to reshape at each step takes time

    def __call__(self, observations: Array, dtype: Any = np.float64) -> Array:
        """Return observations [... x number] in error coordinates, [... x size]."""
        out = np.empty((*observations.shape[:-1], self.size), dtype)
        subtract_and_scale(observations.reshape(-1), self._numbers, out.reshape(-1))
        return out

    @property
    def space(self) -> spaces.Box:
        """Return the box of error coordinates, [size] of float32."""
        bound = self.columns[:, 4].astype(np.float32)
        return spaces.Box(-bound, bound)
