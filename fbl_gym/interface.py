"""What passes between the arm and a policy: the layout of the observation, and all that a policy may know.

A policy is built from an `Interface`: the nominal model, the layout, the rate, the torque limits and what an action
means. It never sees the plant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from gymnasium import spaces

from fbl_gym.arm import ArmParameters, Array, forward_dynamics, inverse_dynamics
from fbl_gym.checks import Pair, check_number, unknown
from fbl_gym.records import set_fields

ACTIONS = ("normalized", "torque", "acceleration")


@dataclass(frozen=True)
class Limits:
    """Where an episode is given up, and how far the numbers of the interface reach.

    Args:
        position: an arm more than this from where it started [rad] has diverged; readings saturate at twice that.
        velocity: likewise [rad/s].
        acceleration: range of the acceleration sensor and of the reference's acceleration [rad/s^2].
        command: range of an acceleration action [rad/s^2].
    """

    position: float = 4 * np.pi
    velocity: float = 100.0
    acceleration: float = 1e5
    command: float = 100.0

    def __post_init__(self) -> None:
        for name in ("position", "velocity", "acceleration", "command"):
            set_fields(self, **{name: check_number(name, getattr(self, name), above=0)})


@dataclass(frozen=True)
class Slot:
    """One stretch of the observation.

    Args:
        name: such as "velocity".
        start: index of its first entry.
        size: how many entries.
        unit: of the entries; several units, joined by commas, take turns by pairs of entries.
        low, high: bounds of the entries, [size] in their units.
    """

    name: str
    start: int
    size: int
    unit: str
    low: tuple[float, ...]
    high: tuple[float, ...]

    @property
    def slice(self) -> slice:
        return slice(self.start, self.start + self.size)


@dataclass(frozen=True)
class Layout:
    """Names, slices, units and bounds of the flat observation.

    `observation[..., layout["velocity"]]` is the measured velocity of both joints. `"velocity" in layout` says whether
    that sensor exists; asking for a slot that is absent is an error that lists those that are there.

    Args:
        slots: in their order, without gaps.
    """

    slots: tuple[Slot, ...]

    def __getitem__(self, name: str) -> slice:
        for slot in self.slots:
            if slot.name == name:
                return slot.slice
        raise unknown("slot of the observation", name, (slot.name for slot in self.slots))

    def __contains__(self, name: object) -> bool:
        return any(slot.name == name for slot in self.slots)

    @property
    def size(self) -> int:
        """Length of the observation."""
        return sum(slot.size for slot in self.slots)

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each entry, such as "velocity[1]" or "preview[6]"."""
        return tuple(f"{slot.name}[{i}]" for slot in self.slots for i in range(slot.size))

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each entry."""
        return tuple(unit for slot in self.slots for unit in _repeat(slot.unit.split(", "), slot.size))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest value of each entry."""
        low = np.array([x for slot in self.slots for x in slot.low])
        high = np.array([x for slot in self.slots for x in slot.high])
        return low, high


def _repeat(units: list[str], size: int) -> list[str]:
    return [units[i // 2 % len(units)] for i in range(size)]


@dataclass(frozen=True)
class Interface:
    """All that a policy may know of its task.

    Args:
        nominal: the nominal model.
        layout: what stands where in the observation.
        control_dt: time between decisions [s].
        torque_limit: largest torque of each joint [N m]; None: unlimited.
        action: what an action means: "normalized" of the torque limit in [-1, 1], "torque" [N m] or "acceleration" [rad/s^2]
            through the nominal feedback linearisation mapping.
        action_limit: bound of each action entry, in the action's unit.
    """

    nominal: ArmParameters
    layout: Layout
    control_dt: float
    torque_limit: Pair | None
    action: str
    action_limit: Pair

    @property
    def action_space(self) -> spaces.Box:
        """The box of actions, [2]; values outside act as the nearest inside, as a drive saturates.

        Declared as float32, which is what agents produce and their tools check for; a float64 action keeps its precision.
        """
        limit = np.array(self.action_limit, dtype=np.float32)
        return spaces.Box(-limit, limit, dtype=np.float32)

    @property
    def observation_space(self) -> spaces.Box:
        """The box of observations, [layout.size], float64."""
        low, high = self.layout.bounds
        return spaces.Box(low, high, dtype=np.float64)

    def saturate(self, torque: Array) -> Array:
        """The torque within its limit.  torque: [... x 2] N m."""
        if self.torque_limit is None:
            return torque
        limit = np.array(self.torque_limit)
        return np.clip(torque, -limit, limit)

    def action_from_torque(self, torque: Array, position: Array, velocity: Array) -> Array:
        """The action that asks for a torque, [... x 2] in the action's unit.

        For acceleration actions, the nominal mapping is inverted at the measured state, which is where the environment
        applies it.

        Args:
            torque: [... x 2] N m.
            position, velocity: measured, [... x 2] rad and rad/s.
        """
        if self.action == "normalized":
            return self.saturate(torque) / np.array(self.torque_limit)
        if self.action == "torque":
            return np.clip(torque, -np.array(self.action_limit), self.action_limit)
        acceleration = forward_dynamics(self.nominal, position, velocity, torque)
        return np.clip(acceleration, -self.action_limit[0], self.action_limit[0])

    def torque_from_action(self, action: Array, position: Array, velocity: Array) -> Array:
        """The torque that an action asks for, [... x 2] N m before delay and lag; the inverse of `action_from_torque`.

        Args:
            action: [... x 2] in the action's unit.
            position, velocity: measured, [... x 2] rad and rad/s.
        """
        if self.action == "normalized":
            return np.clip(action, -1.0, 1.0) * np.array(self.torque_limit)
        if self.action == "torque":
            return np.clip(action, -np.array(self.action_limit), self.action_limit)
        acceleration = np.clip(action, -self.action_limit[0], self.action_limit[0])
        return self.saturate(inverse_dynamics(self.nominal, position, velocity, acceleration))


_Bounds: TypeAlias = tuple[float, ...]


def make_layout(
    sensors: tuple[str, ...], limits: Limits, previous_action: Pair | None, action_unit: str, preview: int
) -> Layout:
    """The layout for a choice of sensors: what is measured, the reference, then the optional slots.

    Args:
        sensors: which of position, velocity and acceleration are measured.
        limits: where the bounds come from.
        previous_action: bound of the previous action where an actuator delay or lag makes it part of the state, else None.
        action_unit: of the previous action.
        preview: how many coming samples of the reference are observed; 0: none.
    """
    slots: list[Slot] = []

    def add(name: str, unit: str, bound: _Bounds) -> None:
        start = slots[-1].start + slots[-1].size if slots else 0
        slots.append(Slot(name, start, len(bound), unit, tuple(-x for x in bound), bound))

    position, velocity, acceleration = (
        (2 * limits.position,) * 2,
        (2 * limits.velocity,) * 2,
        (limits.acceleration,) * 2,
    )
    motion = {"position": (position, "rad"), "velocity": (velocity, "rad/s"), "acceleration": (acceleration, "rad/s^2")}
    for sensor in sensors:
        bound, unit = motion[sensor]
        add(sensor, unit, bound)
    for name, (bound, unit) in motion.items():
        add(f"reference_{name}", unit, bound)
    if previous_action is not None:
        add("previous_action", action_unit, previous_action)
    if preview:
        add("preview", "rad, rad/s, rad/s^2", (position + velocity + acceleration) * preview)
    return Layout(tuple(slots))
