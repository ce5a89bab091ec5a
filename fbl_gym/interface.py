"""The interface between an arm and a policy: observation, action and all that a policy may know.

A policy is built from an `Interface`: the nominal model, the observation's layout, the rate, the
torque limits and the meaning of an action. It never sees the real arm.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from fbl_gym.model.arm import ArmParameters, Array, forward_dynamics, inverse_dynamics
from fbl_gym.options.limits import Constraints, Limits
from fbl_gym.records.checks import Pair, unknown

ACTIONS = ("normalized", "torque", "acceleration")


def clip(x: Array, low: ArrayLike, high: ArrayLike) -> Array:
    """Return x within its bounds, as `np.clip` in a third of its time for one arm."""
    return np.minimum(np.maximum(x, low), high)


def _within(x: Array, limit: Pair) -> Array:
    """Return the nearest x [... x 2] whose sizes are within a limit."""
    high = np.array(limit)
    return clip(x, -high, high)


def class_of(control_dt: float, encoder: str | None) -> str:
    """Return the class of robots that a robot is most like, one of `scenarios.classes.CLASSES`.

    A rate below 250 Hz makes a "servo". Of the faster robots, one with springs whose encoders are
    on the motors is "geared", any other is "direct".

    Args:
        control_dt: time between two decisions [s].
        encoder: side of the springs that is measured, "motor" or "link"; None: rigid joints.
    """
    if control_dt > 0.004:
        return "servo"
    return "geared" if encoder == "motor" else "direct"


@dataclass(frozen=True)
class Slot:
    """Consecutive entries of the observation with one meaning.

    Args:
        name: such as "velocity".
        unit: of the entries; several units, joined by commas, repeat in turn, each for two entries.
        bound: largest size of each entry, of either sign, in their units.
    """

    name: str
    unit: str
    bound: tuple[float, ...]


@dataclass(frozen=True)
class Layout:
    """Names, slices and bounds of the flat observation.

    `observation[..., layout["velocity"]]` is the measured velocity of both joints. `"velocity" in
    layout` is True if the observation has it. A slot that is absent is an error that lists the
    others.

    Args:
        slots: of the whole observation, in order.
    """

    slots: tuple[Slot, ...]

    def __getitem__(self, name: str) -> slice:
        if name not in self._slices:
            raise unknown("slot of the observation", name, self._slices)
        return self._slices[name]

    def __contains__(self, name: object) -> bool:
        return name in self._slices

    @cached_property
    def _slices(self) -> dict[str, slice]:
        ends = np.cumsum([len(slot.bound) for slot in self.slots]).tolist()
        return {slot.name: slice(end - len(slot.bound), end) for slot, end in zip(self.slots, ends, strict=True)}

    @cached_property
    def size(self) -> int:
        """The length of the observation."""
        return len(self.bounds[1])

    @cached_property
    def reference(self) -> NDArray[np.int64]:
        """The entries with the reference: six of now, and of each sample of the preview."""
        first = self["reference_position"].start
        return np.r_[first : first + 6, self["preview"] if "preview" in self else slice(0)]

    @property
    def names(self) -> tuple[str, ...]:
        """Return the name of each entry, such as "velocity[1]" or "preview[6]"."""
        return tuple(f"{slot.name}[{i}]" for slot in self.slots for i in range(len(slot.bound)))

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """The lowest and the highest value of each entry, [size] each."""
        high = np.array([x for slot in self.slots for x in slot.bound])
        both = -high, high
        for bound in both:
            bound.setflags(write=False)
        return both


@dataclass(frozen=True)
class Interface:
    """All that a policy may know of its task.

    Args:
        nominal: the nominal model.
        layout: of the observation.
        control_dt: time between two decisions [s].
        torque_limit: largest torque of each joint [N m]; None: no limit.
        action: meaning of an action: "normalized", the torque as a fraction of its limit; "torque"
            [N m]; or "acceleration" [rad/s^2], through the nominal feedback linearisation mapping.
        action_limit: bound of each action entry, in the action's unit.
        delay: shortest and longest time from command to torque that the drive's datasheet states
            [s]. Equal, if the delay does not vary between episodes; likewise below.
        lag: smallest and largest time constant of the drive [s].
        rate_limit: smallest rate limit of each joint's torque [N m/s]; None: no limit.
        latency: age of the readings of position and velocity [s].
        resolution: step between two readings of each joint's position [rad]; 0: none.
        noise_std: largest standard deviation of the noise of each joint's position [rad], velocity
            [rad/s] and acceleration [rad/s^2].
        stiffness: smallest and largest stiffness of each joint's spring, [2 x 2] N m/rad; None:
            rigid joints.
        damping: smallest and largest damping of each spring, [2 x 2] N m s/rad.
        rotor_inertia: inertia of each rotor behind its spring [kg m^2].
        backlash: largest width of each joint's gap [rad].
        encoder: side of the springs on which position and velocity are measured, "motor" or "link".
        constraints: bounds that the arm shall keep; None: there are none.
    """

    nominal: ArmParameters
    layout: Layout
    control_dt: float
    torque_limit: Pair | None
    action: str
    action_limit: Pair
    delay: Pair = (0.0, 0.0)
    lag: Pair = (0.0, 0.0)
    rate_limit: Pair | None = None
    latency: float = 0.0
    resolution: Pair = (0.0, 0.0)
    noise_std: tuple[Pair, ...] = ((0.0, 0.0),) * 3
    stiffness: tuple[Pair, Pair] | None = None
    damping: tuple[Pair, Pair] = ((0.0, 0.0), (0.0, 0.0))
    rotor_inertia: Pair = (0.0, 0.0)
    backlash: Pair = (0.0, 0.0)
    encoder: str = "motor"
    constraints: Constraints | None = None

    @property
    def robot_class(self) -> str:
        """The class of robots that this one is most like, see `class_of`."""
        return class_of(self.control_dt, None if self.stiffness is None else self.encoder)

    @property
    def action_space(self) -> spaces.Box:
        """Return the box of actions, [2]. A value outside acts as the nearest inside.

        The box is of float32, as agents produce. A float64 action keeps its precision.
        """
        limit = np.array(self.action_limit, dtype=np.float32)
        return spaces.Box(-limit, limit, dtype=np.float32)

    @property
    def observation_space(self) -> spaces.Box:
        """Return the box of observations, [layout.size], float64."""
        return spaces.Box(*self.layout.bounds, dtype=np.float64)

    @cached_property
    def torque_scale(self) -> Array:
        """Torques that count as 1, [2] N m: the limits; of a joint without a drive 1 N m."""
        return np.array([limit or 1.0 for limit in self.torque_limit or (np.inf, np.inf)])

    def saturate(self, torque: Array) -> Array:
        """Return a torque [... x 2] N m within its limit."""
        return torque if self.torque_limit is None else _within(torque, self.torque_limit)

    def action_from_torque(self, torque: Array, position: Array, velocity: Array) -> Array:
        """Return the action that commands a torque, [... x 2] in the action's unit.

        An acceleration action inverts the nominal mapping at the measured state, where the
        environment applies it.

        Args:
            torque: [... x 2] N m.
            position: measured, [... x 2] rad.
            velocity: measured, [... x 2] rad/s.
        """
        if self.action == "normalized":
            return self.saturate(torque) / self.torque_scale
        action = torque if self.action == "torque" else forward_dynamics(self.nominal, position, velocity, torque)
        return _within(action, self.action_limit)

    def torque_from_action(self, action: Array, position: Array, velocity: Array) -> Array:
        """Return the torque that an action commands before delay and lag, [... x 2] N m.

        The inverse of `action_from_torque`, with its arguments.
        """
        if self.action == "normalized":
            return clip(action, -1.0, 1.0) * np.array(self.torque_limit)
        action = _within(action, self.action_limit)
        if self.action == "torque":
            return action
        return self.saturate(inverse_dynamics(self.nominal, position, velocity, action))


def make_layout(
    sensors: tuple[str, ...], limits: Limits, action_limit: Pair, action_unit: str, past_actions: int, preview: int
) -> Layout:
    """Return the layout of an observation: the measured signals, the reference, the optional slots.

    Args:
        sensors: the measured signals, out of position, velocity and acceleration.
        limits: source of the bounds.
        action_limit: bound of the previous actions.
        action_unit: of the previous actions.
        past_actions: number of previous actions that are observed: those on their way through the
            actuator are part of the state.
        preview: number of coming samples of the reference that are observed.
    """
    position, velocity = (2 * limits.position,) * 2, (2 * limits.velocity,) * 2
    acceleration = (limits.acceleration,) * 2
    motion = {"position": ("rad", position), "velocity": ("rad/s", velocity), "acceleration": ("rad/s^2", acceleration)}
    slots = [Slot(sensor, *motion[sensor]) for sensor in sensors]
    slots += [Slot(f"reference_{name}", *each) for name, each in motion.items()]
    slots.append(Slot("previous_actions", action_unit, action_limit * past_actions))
    slots.append(Slot("preview", "rad, rad/s, rad/s^2", (position + velocity + acceleration) * preview))
    return Layout(tuple(slot for slot in slots if slot.bound))
