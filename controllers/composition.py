"""Composed laws: a law with an observer for the sensors that it lacks, predictor, safety filter.

`compose(ComputedTorque, "kalman", "predictor")` is a class like that of any law. Its name as text
is "computed-torque+kalman+predictor". `Filtered` is the safety filter around any other policy.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from controllers.base import Policy, State, TorqueLaw
from controllers.numerics.dynamics import forward_dynamics
from controllers.parts.barrier import Barrier
from controllers.parts.drive import Acting
from controllers.parts.observers import OBSERVERS
from controllers.parts.predictor import Predictor
from controllers.parts.springs import Springs
from controllers.preview import Places, between, places
from fbl_gym.interface import Interface, clip, make_layout
from fbl_gym.model.arm import Array
from fbl_gym.options import SENSORS, Limits
from fbl_gym.records.checks import check_choices
from fbl_gym.records.record import declarations, declared

PARTS: Mapping[str, type] = {**OBSERVERS, "predictor": Predictor, "springs": Springs, "barrier": Barrier}
"""The parts, by name."""

DEFAULT = "eso"
"""The observer, with its default gains, for a sensor that is missing where no observer is named."""


class ComposedState(NamedTuple):
    """State of a composed law."""

    acting: Acting
    memory: Array  # of the observer [n x 2 x 4]
    bend: Array  # of the springs under the reference [n x 2 x 2] rad, rad/s
    inside: State = ()  # of the law inside


class Composed(TorqueLaw):
    """Base of the composed laws, which `compose` makes.

    The law inside works on its own interface: it has each sensor that the law needs, and, with a
    predictor, neither delay nor lag. A named observer replaces the measured position and velocity.
    An acceleration is estimated only if no sensor measures it. Without a named observer, measured
    signals are used as they are, and the observer `DEFAULT` gives the missing ones. A barrier
    filters the law's torque at the motion that the law gets.

    Names other than those of `TorqueLaw` begin with an underscore, since gains may have all others.
    """

    _law: ClassVar[type[TorqueLaw]]
    _parts: ClassVar[tuple[str, ...]]

    needs: ClassVar[tuple[str, ...]] = ("position",)

    def validate(self) -> None:
        """Refuse an interface without position, and gains that the law inside refuses."""
        super().validate()
        _ = self._inside

    @cached_property
    def _inside(self) -> TorqueLaw:
        """The law on its own interface."""
        outer = self.interface
        wanted = {"position", "velocity", *self._law.needs}
        sensors = tuple(name for name in SENSORS if name in wanted or name in outer.layout)
        position, velocity, acceleration, _ = self._bounds
        limits = Limits(position=position / 2, velocity=velocity / 2, acceleration=acceleration)
        layout = make_layout(sensors, limits, outer.action_limit, "", 0, len(outer.layout.reference) // 6 - 1)
        inner = dataclasses.replace(outer, layout=layout)
        if "predictor" in self._parts:
            inner = dataclasses.replace(inner, delay=(0.0, 0.0), lag=(0.0, 0.0), latency=0.0)
        gains = {field.name: getattr(self, field.name) for field in dataclasses.fields(self._law)}
        return self._law(**{**gains, "interface": inner})

    @cached_property
    def _bounds(self) -> Array:
        """Bounds of an estimate's numbers [4], as of the sensors' readings."""
        layout = self.interface.layout
        position, velocity, acceleration = layout.bounds[1][layout.reference[:6:2]]
        return np.array([position, velocity, acceleration, acceleration])

    @cached_property
    def _made(self) -> dict[str, Any]:
        """The parts by name; "observer" is the one that is named, or the default one."""
        observer = next((name for name in self._parts if name in OBSERVERS), DEFAULT)
        first = {"predictor": self.drive, "springs": self.interface, "barrier": self._inside.interface}
        made = {name: PARTS[name](first[name], **self._gains(name)) for name in self._parts if name in first}
        return {**made, "observer": OBSERVERS[observer](self.interface.control_dt, **self._gains(observer))}

    @cached_property
    def _ahead(self) -> Places:
        """Places of the reference that the law inside gets, when its torque acts."""
        samples, dt = len(self.interface.layout.reference) // 6, self.interface.control_dt
        ahead = self.drive.delay - self.interface.latency + self._made["predictor"].lateness
        return places(dt, samples, ahead + dt * np.arange(samples, dtype=float))

    @cached_property
    def _estimates(self) -> bool:
        """True if an estimate is needed, for a predictor or in place of a sensor."""
        wanted = (name for name in SENSORS if name in self._inside.interface.layout)
        named = {"predictor", *OBSERVERS}.intersection(self._parts)
        return bool(named) or any(name not in self.interface.layout for name in wanted)

    def _gains(self, part: str) -> dict[str, Any]:
        """Return the gains of a part that is named."""
        names = declarations(PARTS[part]) if part in self._parts else ()
        return {name: getattr(self, gain_name(part, name)) for name in names}

    def initial(self, observation: Array) -> State:
        """Return the state: the torque holds the nominal arm still."""
        state = self._outside(observation)
        return state._replace(inside=self._inside.initial(self._look(observation, state)[0]))

    def restart(self, observation: Array, state: State) -> State:
        """Return the state for the next episode, with all that the law inside has learned."""
        fresh = self._outside(observation)
        return fresh._replace(inside=self._inside.restart(self._look(observation, fresh)[0], state.inside))

    def _outside(self, observation: Array) -> ComposedState:
        """Return the state at an episode's start, without that of the law inside."""
        (q,) = self.read(observation, "position")
        v = self.read(observation, "velocity" if "velocity" in self.interface.layout else "reference_velocity")[0]
        bend = np.full((len(q), 2, 2), np.inf)
        return ComposedState(self.drive.hold(self.holding(q)), self._made["observer"].initial(q, v), bend)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        seen, estimate, due, bend = self._look(observation, state)
        gain = self._made["predictor"].gain if "predictor" in self._made else 1.0
        law = self._inside
        if self.drive.sent is not None:
            law = law.sending(due + (self.drive.sent - due) / gain)
        torque, inside = law.torque(seen, state.inside)
        if "barrier" in self._made:
            torque = self._made["barrier"].filtered(torque, *self._inside.measured_motion(seen))
        if "predictor" in self._made:
            torque = due + gain * (self.interface.saturate(torque) - due)
        measured = self.measured_motion(observation)
        torque = self.interface.torque_from_action(self.interface.action_from_torque(torque, *measured), *measured)
        if not self._estimates:
            return torque, state._replace(bend=bend, inside=inside)
        acting = self.drive.act(state.acting, torque)
        u = forward_dynamics(self.interface.nominal, estimate[..., 0], estimate[..., 1], acting.mean)
        return torque, ComposedState(acting, self._made["observer"].predict(estimate, u), bend, inside)

    def _look(self, observation: Array, state: ComposedState) -> tuple[Array, Array, Array, Array]:
        """Return all that the law inside depends on.

        Args:
            observation: [n x size].
            state: of the drive and of the observer; that of the law inside is not read.

        Returns:
            The observation of the law inside [n x its size], the estimate [n x 2 x 4] at the last
            reading, the torque [n x 2] N m at the time when the next command acts, and the springs'
            deflection with its rate [n x 2 x 2].
        """
        present = state.acting.torque
        layout, arm, inside = self.interface.layout, self.interface.nominal, self._inside.interface
        motion = {name: self.read(observation, name)[0] for name in SENSORS if name in layout}
        estimate = state.memory
        if self._estimates:
            estimate = self._made["observer"].correct(state.memory, motion["position"], motion.get("velocity"))
            # An arm that diverges may carry an estimate away; its numbers stay finite.
            estimate = clip(estimate, -self._bounds, self._bounds)
        estimated = dict(zip(SENSORS, estimate.transpose(2, 0, 1), strict=False))
        if any(part in OBSERVERS for part in self._parts):
            motion.pop("velocity", None)
            del motion["position"]
        q, v, a = ((estimated | motion)[name] for name in SENSORS)
        due, predictor = present, self._made.get("predictor")
        if predictor is not None:
            f, now = estimate[..., 3], (q, v, present)
            q, v, due = self.drive.predict(arm, q, v, f, present, self.drive.coming(state.acting.queue))
            q, v, torque = self.drive.predict(arm, q, v, f, due, [(predictor.lateness, state.acting.queue[:, 0])])
            if "acceleration" in inside.layout:
                a = forward_dynamics(arm, q, v, torque) + (a - forward_dynamics(arm, *now))
        signals = [x for name, x in zip(SENSORS, (q, v, a), strict=True) if name in inside.layout]
        reference = observation.take(layout.reference, axis=-1).reshape(len(q), -1, 6)
        if predictor is not None:
            reference = between(reference, self._ahead, inside.control_dt)
        bend = state.bend
        if "springs" in self._made:
            reference, bend = self._made["springs"].moved(reference, bend)
        seen = np.concatenate([*signals, reference.reshape(len(q), -1)], axis=-1)
        return clip(seen, *inside.layout.bounds), estimate, due, bend


class Filtered:
    """A policy behind the safety filter `Barrier`, at the measured motion.

    Where the filter changes nothing, the action is that of the policy, bit for bit.

    Args:
        policy: anything with stable-baselines3's `predict`, such as an agent.
        interface: of its environment; it measures position and velocity.
        **gains: of `Barrier`.
    """

    def __init__(self, policy: Policy, interface: Interface, **gains: Any) -> None:
        self.policy, self.interface, self.barrier = policy, interface, Barrier(interface, **gains)

    def predict(
        self, observation: Array, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Array, Any]:
        """Return the action and the next state, as `controllers.base.Policy.predict`."""
        action, state = self.policy.predict(observation, state, episode_start, deterministic)
        observation = np.asarray(observation, dtype=float)
        motion = [observation[..., self.interface.layout[name]] for name in ("position", "velocity")]
        wanted = self.interface.torque_from_action(np.asarray(action, dtype=float), *motion)
        torque = self.barrier.filtered(wanted, *motion)
        changes = (torque != wanted).any(axis=-1, keepdims=True)
        return np.where(changes, self.interface.action_from_torque(torque, *motion), action), state


@lru_cache(maxsize=256)
def compose(law: type[TorqueLaw], *parts: str) -> type[Composed]:
    """Return the class of a law with parts.

    Its fields are the gains of the law and, with the part's name before, those of each part:
    `kalman_bandwidth`, `predictor_lead`, `barrier_decay`.

    Args:
        law: a subclass of `TorqueLaw`.
        *parts: names out of `PARTS`: at most one observer, "predictor", "springs" and "barrier".

    Raises:
        ValueError: the law is no `TorqueLaw`, a part is unknown or given twice, or the composed law
            needs the name of a gain.
    """
    if not (inspect.isclass(law) and issubclass(law, TorqueLaw)):
        raise ValueError(f"parts go with a subclass of TorqueLaw, got {getattr(law, '__name__', law)!r}")
    if len(set(parts)) < len(parts):
        raise ValueError(f"parts must differ, got {', '.join(parts)}")
    parts = check_choices("parts", parts, PARTS)
    observers = [part for part in parts if part in OBSERVERS]
    if len(observers) > 1:
        raise ValueError(f"give one observer, got {' and '.join(observers)}")
    fields: list[tuple[str, Any, Any]] = []
    for prefix, cls in (("", law), *((part, PARTS[part]) for part in parts)):
        known = declarations(cls)
        for field in dataclasses.fields(cls):
            if field.name in known:
                copy = declared(field.default, **vars(known[field.name]))
            elif cls is law and field.name != "interface":
                copy = dataclasses.field(default=field.default, default_factory=field.default_factory)
            else:
                continue
            name = gain_name(prefix, field.name)
            if name in vars(Composed) or name in (other for other, *_ in fields):
                raise ValueError(
                    f"a law with parts has a {name} of its own, so a gain of {law.__name__} needs another name"
                )
            fields.append((name, field.type, copy))
    return dataclasses.make_dataclass(
        "+".join((law.__name__, *parts)), fields, bases=(Composed,), frozen=True,
        namespace={
            **{name: getattr(law, name) for name in ("uses", "packages", "data_files") if hasattr(law, name)},
            "_law": law, "_parts": parts, "access": law.access, "preview": law.preview, "__module__": __name__,
            "__doc__": f"`{law.__name__}` with {' and '.join(parts) or 'an observer of the missing sensors'}.",
        },
    )  # fmt: skip


def completed(policy: Callable[..., Any], interface: Interface) -> Callable[..., Any]:
    """Return a policy's factory; that of a law that needs an absent sensor is composed."""
    if not (inspect.isclass(policy) and issubclass(policy, TorqueLaw)):
        return policy
    return policy if all(sensor in interface.layout for sensor in policy.needs) else compose(policy)  # type: ignore[arg-type]


def gain_name(part: str, name: str) -> str:
    """Return the name of a part's gain in a composed law, such as "kalman_bandwidth".

    Args:
        part: name of the part; empty: the law.
        name: of the gain in the part's class.
    """
    return f"{part}_{name}" if part else name
