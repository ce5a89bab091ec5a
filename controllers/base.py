"""A policy is anything with stable-baselines3's `predict`; `TorqueLaw` is the base of laws.

A controller therefore goes wherever an SB3 model goes. Laws are frozen records of their gains.
Values that change during a run travel in `state`.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol, Self, TypeAlias

import numpy as np

from controllers.drive import Acting, Drive  # noqa: F401 - a law imports its words from this file
from controllers.numerics.dynamics import forward_dynamics, inverse_dynamics, winds_up
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array, gravity_torque, inertia_matrix
from fbl_gym.records.checks import Pair
from fbl_gym.records.record import Record, number, pair  # noqa: F401

#: A `NamedTuple` of arrays with a row for each lane, or of such states; () for a law without.
State: TypeAlias = Any

#: A gain: one number, or one for each joint.
Gain: TypeAlias = Pair | float

#: A policy may know nothing of the arm, the nominal model, or the truth (shown, but not ranked).
ACCESS = ("none", "nominal", "oracle")


class IntegralState(NamedTuple):
    """State of a law with integral action."""

    integral: Array  # [n x 2]


def map_state(function: Callable[..., Any], *states: State) -> State:
    """Return the state with the results of a function of the arrays of some states of one law."""
    if not isinstance(states[0], tuple | list):
        return function(*states)
    parts = [map_state(function, *arrays) for arrays in zip(*states, strict=True)]
    return type(states[0])(*parts) if hasattr(states[0], "_fields") else tuple(parts)


def leaves(state: State) -> list[Any]:
    """Return all arrays of a state."""
    return [array for part in state for array in leaves(part)] if isinstance(state, tuple | list) else [state]


def where_lanes(lanes: Array, new: State, old: State) -> State:
    """Return the new state in some lanes [n] and the old one in all others."""
    return map_state(lambda x, y: np.where(lanes.reshape(-1, *[1] * (y.ndim - 1)), x, y), new, old)


class Policy(Protocol):
    """A policy, classical or learned."""

    def predict(
        self, observation: Array, state: State = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Array, State]:
        """Return the action for an observation [size], or actions for a batch [n x size].

        Args:
            observation: in the environment's layout.
            state: the state that the last call returned; None starts an episode in every lane.
            episode_start: [n] or one flag; True in lanes where an episode starts; they are reset.
                A policy that learns over trials may keep what it knows of the same motion.
            deterministic: without effect on a controller.

        Returns:
            The action, [2] or [n x 2], and the state for the next call.
        """
        ...


class Law(Record):
    """Base of `TorqueLaw` and of the oracles: `predict` from a torque for batches of observations.

    Attributes:
        interface: of the environment.
    """

    interface: Interface

    def initial(self, observation: Array) -> State:
        """Return the state before the first decision of an episode; observations are [n x size]."""
        return ()

    def restart(self, observation: Array, state: State) -> State:
        """Return the state before the first decision of the next episode, after one that ended.

        A law that learns from episode to episode keeps it there; all others begin afresh.
        """
        return self.initial(observation)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m for observations [n x size], and the next state.

        The torque may exceed the limits; `predict` applies them.
        """
        raise NotImplementedError

    def read(self, observation: Array, *slots: str) -> tuple[Array, ...]:
        """Return slots of `interface.layout` of an observation [... x size], each [... x 2]."""
        layout = self.interface.layout
        return tuple([np.ascontiguousarray(observation[..., layout[slot]]) for slot in slots])

    def measured_motion(self, observation: Array) -> tuple[Array, Array]:
        """Return the measured position and velocity [... x 2]; zeros for an absent velocity."""
        (position,) = self.read(observation, "position")
        known = "velocity" in self.interface.layout
        return position, self.read(observation, "velocity")[0] if known else np.zeros_like(position)

    def predict(
        self, observation: Array, state: State = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Array, State]:
        """Return the action and the next state, as `Policy.predict` describes."""
        size = self.interface.layout.size
        observation = np.array(observation, dtype=float)  # states may keep parts of it
        if observation.ndim not in (1, 2) or observation.shape[-1] != size:
            shapes = f"({size},) or (n, {size}), as this policy was built for"
            raise ValueError(f"observation must have shape {shapes}, got {observation.shape}")
        batch = np.atleast_2d(observation)
        if state is None:
            state = self.initial(batch)
        elif episode_start is not None and np.any(episode_start):
            starts = np.broadcast_to(np.asarray(episode_start, dtype=bool), len(batch))
            state = where_lanes(starts, self.restart(batch, state), state)
        answer = self.torque(batch, state)
        shape = np.shape(answer[0]) if isinstance(answer, tuple) and len(answer) == 2 else None
        if shape != (len(batch), 2):
            got = f"a torque of shape {shape}" if shape is not None else f"a {type(answer).__name__}"
            name = f"{type(self).__name__}.torque"
            raise ValueError(f"{name} must return a torque [{len(batch)} x 2] and the next state, got {got}")
        torque, state = answer
        action = self.interface.action_from_torque(torque, *self.measured_motion(batch))
        return (action if observation.ndim == 2 else action[0]), state


@dataclass(frozen=True)
class TorqueLaw(Law):
    """Base of the laws: a subclass computes a torque, and is a policy.

    A subclass is a frozen dataclass, and its fields are its gains. It defines `torque`, and
    `initial` if it has a state. Both work on batches: an observation is [n x size], a torque
    [n x 2] N m, and a state a `NamedTuple` of arrays with n rows each.

    A gain may be declared with its unit, bounds and tuning range, and is then checked:

        frequency: Gain = pair(10.0, unit="rad/s", above=0, tune=(2.0, 100.0))

    A subclass of a law keeps the declaration with a plain default, `frequency: Gain = 20.0`. A rule
    for several gains goes into `validate`, after `super().validate()`.

    Notation of the laws' equations: r is the reference, q the position, v the velocity and
    e = r - q. M, C and G are the nominal inertia, Coriolis and gravity terms. A prime is the time
    derivative of a signal, and the transpose of a vector or matrix. int is the integral over time,
    and p^ an estimate of p. Sections and equations without a source are those of the paper, which
    `fbl_gym.model.arm` names.

    Args:
        interface: all that the law may know: `env.unwrapped.interface`.

    Attributes:
        needs: the sensors that the law requires.
        missing: number of drives that may be missing, with a torque limit of 0.
        access: what the law may know of the arm, one of `ACCESS`.
        preview: how far ahead the law uses the reference, where the observation has it [s].
    """

    interface: Interface = field(repr=False)

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity")
    missing: ClassVar[int] = 0
    access: ClassVar[str] = "nominal"
    preview: ClassVar[float] = 0.0

    def validate(self) -> None:
        """Refuse an interface without a drive, or without a sensor that the law needs."""
        limit = self.interface.torque_limit or ()
        if limit.count(0.0) > self.missing:
            drives = "a drive" if self.missing else "both drives"
            raise ValueError(f"{type(self).__name__} needs {drives}, got actuator.torque_limit={limit} N m")
        slots = ", ".join(slot.name for slot in self.interface.layout.slots)
        for sensor in self.needs:
            if sensor not in self.interface.layout:
                raise ValueError(
                    f"{type(self).__name__} needs a sensor of {sensor}, but the observation only has {slots}"
                )

    @cached_property
    def drive(self) -> Drive:
        """The known drive, by which a law pairs a motion with the torque of its time."""
        return Drive.of(self.interface)

    def sending(self, torque: Array) -> Self:
        """Return the law as it decides where another torque than its own is sent at this sample.

        Its observers and predictors need the torque [n x 2] N m that acts on the arm.
        """
        law = copy.copy(self)
        vars(law)["drive"] = replace(self.drive, sent=torque)
        return law

    def decide(self, observation: Array, state: State) -> tuple[Array, Any]:
        """Return the torque [n x 2] N m, and a draft for `settle`, as another one may be sent."""
        return self.torque(observation, state)[0], (observation, state)

    def settle(self, draft: Any, torque: Array) -> State:
        """Return the next state after `decide`, where a torque [n x 2] N m is sent."""
        return self.sending(torque).torque(*draft)[1]

    def sendable(self, torque: Array, observation: Array) -> Array:
        """Return the torque [n x 2] N m that the environment makes of the action for a torque."""
        motion = self.measured_motion(observation)
        return self.interface.torque_from_action(self.interface.action_from_torque(torque, *motion), *motion)

    def motion(self, observation: Array) -> tuple[Array, ...]:
        """Return q and v as measured, and r, r' and r'' of the reference, [n x 2] each."""
        return (*self.read(observation, "position", "velocity"), *self.reference(observation))

    def reference(self, observation: Array) -> tuple[Array, ...]:
        """Return r, r' and r'' of the reference now, [n x 2] each."""
        return self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")

    @property
    def velocity_slot(self) -> str:
        """Slot with the velocity at an episode's start: of the sensor, or else of the reference."""
        return "velocity" if "velocity" in self.interface.layout else "reference_velocity"

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torque M a + C v + G of the nominal arm [n x 2] N m for an acceleration a."""
        return inverse_dynamics(self.interface.nominal, q, v, a)

    def forward(self, q: Array, v: Array, torque: Array) -> Array:
        """Return the acceleration of the nominal arm [n x 2] rad/s^2 under a torque."""
        return forward_dynamics(self.interface.nominal, q, v, torque)

    def integrating(
        self, q: Array, v: Array, a: Array, integral: Array, error: Array, model: Any = None, loads: Any = 0.0
    ) -> tuple[Array, Array]:
        """Return the torque M a + C v + G + loads [n x 2] N m, and the next integral of an error.

        The integral pauses where the torque winds it up (`winds_up`). Without a model, M, C and G
        are those of the nominal arm.
        """
        model = self.interface.nominal if model is None else model
        torque = inverse_dynamics(model, q, v, a) + loads
        pause = winds_up(self.interface, model, q, v, a, torque, error, loads)
        return torque, integral + np.where(pause, 0.0, error * self.interface.control_dt)

    def holding(self, position: Array) -> Array:
        """Return the torque within the limits that holds the nominal arm still [n x 2] N m."""
        return self.interface.saturate(gravity_torque(self.interface.nominal, position))

    @cached_property
    def stretched(self) -> Array:
        """Diagonal of the inertia of the stretched nominal arm [2], kg m^2."""
        return np.diagonal(inertia_matrix(self.interface.nominal, (0.0, 0.0)))


class IntegralLaw(TorqueLaw):
    """Base of the laws whose only state is an integral."""

    def initial(self, observation: Array) -> State:
        """Return the state: the integral [n x 2], zero."""
        return IntegralState(np.zeros((len(observation), 2)))
