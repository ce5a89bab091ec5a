"""Observations in error coordinates, for agents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from fbl_gym.interface import Interface, Layout, clip
from fbl_gym.model.arm import Array

_CLIP = 10.0
_MOTION = ("position", "velocity", "acceleration")
_HANGING = np.array([-np.pi / 2, 0.0])


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
    * previous actions as a share of their bound, the last first.

    Args:
        interface: of the environment.
        slots: names of the slots that are used, where the observation has them. The reference
            always is.
        scales: of the errors of position [rad], velocity [rad/s] and acceleration [rad/s^2].
    """

    def __init__(
        self,
        interface: Interface,
        slots: Sequence[str] = ("position", "velocity", "preview", "previous_actions"),
        scales: Sequence[float] = (0.1, 1.0, 10.0),
    ) -> None:
        self.scales = dict(zip(_MOTION, scales, strict=True))
        used = {*slots, *(f"reference_{name}" for name in _MOTION)}
        self.layout = Layout(tuple(slot for slot in interface.layout.slots if slot.name in used))
        self.action_limit = interface.action_limit[0], interface.action_limit[1]
        self.size = len(self(np.zeros((1, interface.layout.size)))[0])

    def __call__(self, observations: Array) -> Array:
        """Return observations [... x layout.size] in error coordinates, [... x size]."""
        layout = self.layout
        parts = [
            (observations[..., layout[f"reference_{name}"]] - observations[..., layout[name]]) / scale
            for name, scale in self.scales.items()
            if name in layout
        ]
        parts.append(observations[..., layout["position"]] - _HANGING)
        if "velocity" in layout:
            parts.append(observations[..., layout["velocity"]])
        parts.append(observations[..., layout["reference_acceleration"]] / self.scales["acceleration"])
        if "preview" in layout:
            parts.append(self._preview(observations))
        if "previous_actions" in layout:
            actions = observations[..., layout["previous_actions"]]
            parts.append(actions / np.resize(self.action_limit, actions.shape[-1]))
        return clip(np.concatenate(parts, axis=-1), -_CLIP, _CLIP)

    def _preview(self, observations: Array) -> Array:
        preview = observations[..., self.layout["preview"]]
        now = [observations[..., self.layout[f"reference_{name}"]] for name in self.scales]
        samples = preview.reshape(*preview.shape[:-1], -1, 6)
        scale = np.repeat([*self.scales.values()], 2)
        return ((samples - np.concatenate(now, axis=-1)[..., None, :]) / scale).reshape(preview.shape)

    def single_precision(self, observations: Array, infos: dict[str, Any] | None = None) -> Any:
        """Return error coordinates as float32; convert `final_obs` of the infos of a batch, too."""
        if infos and "final_obs" in infos:
            final = infos["final_obs"]
            for lane in np.flatnonzero(infos["_final_obs"]):
                final[lane] = self(final[lane]).astype(np.float32)
        return self(observations).astype(np.float32)

    @property
    def space(self) -> spaces.Box:
        """Return the box of error coordinates, [size] of float32."""
        bound = np.full(self.size, _CLIP, dtype=np.float32)
        if "previous_actions" in self.layout:
            actions = self.layout["previous_actions"]
            bound[actions.start - actions.stop :] = 1.0
        return spaces.Box(-bound, bound)
