"""Composed laws: a law with an observer for the sensors that it lacks, predictor, safety filter.

`compose(ComputedTorque, "kalman", "predictor")` is a class like that of any law. Its name as text
is "computed-torque+kalman+predictor". `Filtered` is the safety filter around any other policy.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterator
from functools import cached_property, lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from controllers.base import Acting, Array, Policy, State, TorqueLaw
from controllers.numerics.dynamics import forward_dynamics
from controllers.parts import OBSERVERS, PARTS, Barrier, Eso, Kalman, Predictor, Springs
from controllers.preview import known_reference
from fbl_gym.interface import Interface, clip, make_layout
from fbl_gym.options import SENSORS, Limits
from fbl_gym.records.checks import check_choices
from fbl_gym.records.record import declarations, declared, set_fields

#: The observer, with its default gains, for a sensor that is missing where no observer is named.
DEFAULT = "eso"

#: What a law declares of itself that a composed law declares too.
KEPT = ("access", "preview", "missing", "uses", "packages", "data_files")


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

    _inside: TorqueLaw
    _observer: Eso | Kalman
    _predictor: Predictor | None
    _springs: Springs | None
    _barrier: Barrier | None
    _measured: tuple[str, ...]  # the signals that the law inside gets as they are measured
    _estimates: bool  # an estimate is needed, for a predictor or in place of a sensor

    needs: ClassVar[tuple[str, ...]] = ("position",)

    def validate(self) -> None:
        """Make the law inside and the parts, which check their gains; refuse a lack of position."""
        super().validate()
        gains = {field.name: getattr(self, field.name) for field in dataclasses.fields(self._law)}
        inside = self._law(**gains | {"interface": self._inner_interface()})
        observer = next((name for name in self._parts if name in OBSERVERS), DEFAULT)
        made = {
            name: PARTS[name](self.drive.dt if name == observer else self.interface, **self._gains(name))
            for name in {observer, *self._parts}
        }
        parts = {f"_{name}": made.get(name) for name in ("predictor", "springs", "barrier")}
        replaced = ("position", "velocity") if observer in self._parts else ()
        measured = tuple(name for name in SENSORS if name in self.interface.layout and name not in replaced)
        needed = [name for name in SENSORS if name in inside.interface.layout]
        estimates = "predictor" in made or not {*needed} <= {*measured}
        set_fields(self, _inside=inside, _observer=made[observer], _measured=measured, _estimates=estimates, **parts)

    def _inner_interface(self) -> Interface:
        """Return the interface of the law inside."""
        outer = self.interface
        wanted = {"position", "velocity", *self._law.needs}
        sensors = tuple(name for name in SENSORS if name in wanted or name in outer.layout)
        position, velocity, acceleration, _ = self._bounds
        limits = Limits(position=position / 2, velocity=velocity / 2, acceleration=acceleration)
        layout = make_layout(sensors, limits, outer.action_limit, "", 0, len(outer.layout.reference) // 6 - 1)
        on_time: Any = {"delay": (0.0, 0.0), "lag": (0.0, 0.0), "latency": 0.0}
        return dataclasses.replace(outer, layout=layout, **(on_time if "predictor" in self._parts else {}))

    def _gains(self, part: str) -> dict[str, Any]:
        """Return the gains of a part that is named."""
        names = declarations(PARTS[part]) if part in self._parts else ()
        return {name: getattr(self, gain_name(part, name)) for name in names}

    @cached_property
    def _bounds(self) -> Array:
        """Bounds of an estimate's numbers [4], as of the sensors' readings."""
        layout = self.interface.layout
        position, velocity, acceleration = layout.bounds[1][layout.reference[:6:2]]
        return np.array([position, velocity, acceleration, acceleration])

    def initial(self, observation: Array) -> State:
        """Return the state: the torque holds the nominal arm still."""
        return self._begin(observation, self._inside.initial)

    def restart(self, observation: Array, state: State) -> State:
        """Return the state for the next episode, with all that the law inside has learned."""
        return self._begin(observation, self._inside.restart, state.inside)

    def _begin(self, observation: Array, begin: Callable[..., State], *learned: State) -> State:
        """Return the state at an episode's start; `begin` returns that of the law inside."""
        q, v = self.read(observation, "position", self.velocity_slot)
        memory, bend = self._observer.initial(q, v), np.full((len(q), 2, 2), np.inf)
        state = ComposedState(self.drive.hold(self.holding(q)), memory, bend)
        return state._replace(inside=begin(self._look(observation, state)[0], *learned))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        seen, estimate, due, bend = self._look(observation, state)
        gain = 1.0 if self._predictor is None else self._predictor.gain
        law = self._inside
        if self.drive.sent is not None:
            law = law.sending(due + (self.drive.sent - due) / gain)
        torque, inside = law.torque(seen, state.inside)
        if self._barrier is not None:
            torque = self._barrier.filtered(torque, *law.measured_motion(seen))
        if self._predictor is not None:
            torque = due + gain * (self.interface.saturate(torque) - due)
        torque = self.sendable(torque, observation)
        if not self._estimates:
            return torque, state._replace(bend=bend, inside=inside)
        acting = self.drive.act(state.acting, torque)
        u = forward_dynamics(self.interface.nominal, estimate[..., 0], estimate[..., 1], acting.mean)
        return torque, ComposedState(acting, self._observer.predict(estimate, u), bend, inside)

    def _look(self, observation: Array, state: ComposedState) -> tuple[Array, Array, Array, Array]:
        """Return all that the law inside depends on at a sample; its own state is not read.

        These are its observation [n x its size]; the estimate at this reading, or the memory if
        none is needed [n x 2 x 4]; the torque at the time when the next command acts [n x 2] N m;
        and the bend of the springs with its rate [n x 2 x 2].
        """
        estimate, due, bend = state.memory, state.acting.torque, state.bend
        if self._estimates:
            estimate = self._observer.correct(estimate, *self.read(observation, "position"))
            # An arm that diverges may carry an estimate away; its numbers stay finite.
            estimate = clip(estimate, -self._bounds, self._bounds)
        estimated = zip(SENSORS, estimate.transpose(2, 0, 1), strict=False)
        motion = dict(estimated) | dict(zip(self._measured, self.read(observation, *self._measured), strict=True))
        reference = known_reference(self.interface, observation)
        if self._predictor is not None:
            motion, due = self._predictor.motion(motion, estimate[..., 3], state.acting)
            reference = self._predictor.reference(reference)
        if self._springs is not None:
            reference, bend = self._springs.moved(reference, bend)
        layout = self._inside.interface.layout
        signals = [motion[name] for name in SENSORS if name in layout]
        seen = np.concatenate([*signals, reference.reshape(len(reference), -1)], axis=-1)
        return clip(seen, *layout.bounds), estimate, due, bend


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
    gains = [gain for part in ("", *parts) for gain in _gains(part, PARTS[part] if part else law)]
    names = [*vars(Composed), *Composed.__annotations__, *(name for name, *_ in gains)]
    if twice := [name for name, *_ in gains if names.count(name) > 1]:
        own = f"a law with parts has a {twice[0]} of its own"
        raise ValueError(f"{own}, so a gain of {law.__name__} needs another name")
    kept = {name: getattr(law, name) for name in KEPT if hasattr(law, name)}
    text = f"`{law.__name__}` with {' and '.join(parts) or 'an observer of the missing sensors'}."
    named = {"_law": law, "_parts": parts, "__module__": __name__, "__doc__": text}
    name = "+".join((law.__name__, *parts))
    return dataclasses.make_dataclass(name, gains, bases=(Composed,), frozen=True, namespace=kept | named)


def _gains(part: str, cls: type) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, type and declaration of each gain of a part, or of the law without a part."""
    known = declarations(cls)
    for field in dataclasses.fields(cls):
        if field.name in known:
            yield gain_name(part, field.name), field.type, declared(field.default, **vars(known[field.name]))
        elif not part and field.name != "interface":
            plain = dataclasses.field(default=field.default, default_factory=field.default_factory)
            yield field.name, field.type, plain


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
