"""What a policy is, the base that torque laws share, and the registry of names.

A policy is anything with stable-baselines3's `predict(observation, state, episode_start, deterministic)`, so that a
controller goes wherever an SB3 model goes. Controllers are frozen records of their gains; what changes while they run travels
in `state`.
"""

from __future__ import annotations

import importlib
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np

from fbl_gym.arm import Array
from fbl_gym.checks import check_choice, unknown
from fbl_gym.interface import Interface

State: TypeAlias = tuple[Array, ...]

KINDS = ("classical", "learned")

ACCESS = ("none", "nominal", "privileged")
"""What a policy is told of the arm: nothing, the nominal model, or the truth (such rows are not ranked)."""


class Policy(Protocol):
    """A policy, classical or learned."""

    def predict(
        self,
        observation: Array,
        state: State | None = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
    ) -> tuple[Array, State | None]:
        """The action for an observation [size], or for a batch of them [n x size].

        Args:
            observation: in the environment's layout.
            state: what the last call returned; None begins afresh.
            episode_start: [n] (or one flag), True where an episode begins, whose state is begun afresh.
            deterministic: without effect on a controller.

        Returns:
            The action, [2] or [n x 2], and the state for the next call.
        """
        ...


@dataclass(frozen=True)
class TorqueLaw:
    """A control law that computes torques: give `torque` (and `initial`, if it has a state), and it is a policy.

    Args:
        interface: all that the law may know: `env.unwrapped.interface`.

    A subclass is a frozen dataclass whose fields are its gains. It works on batches: observations are [n x size], torques
    [n x 2] N m, and a state is a tuple of arrays with n rows each. `needs` names the sensors without which it cannot run;
    `preview` is how far ahead it would see the reference [s]; `ranges` says for each gain worth tuning between which values
    (of one number for both joints) to look for it.
    """

    interface: Interface

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity")
    access: ClassVar[str] = "nominal"
    preview: ClassVar[float] = 0.0
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({})

    def __post_init__(self) -> None:
        for sensor in self.needs:
            if sensor not in self.interface.layout:
                raise ValueError(
                    f"{type(self).__name__} needs a sensor of {sensor}, but the observation only has "
                    f"{', '.join(slot.name for slot in self.interface.layout.slots)}"
                )

    def initial(self, observation: Array) -> State:
        """The state before the first decision of an episode.  observation: [n x size]."""
        return ()

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """The torque wished for [n x 2] N m (limits are applied after), and the next state.

        Args:
            observation: [n x size].
            state: what `initial` or the last call returned.
        """
        raise NotImplementedError

    def read(self, observation: Array, *slots: str) -> tuple[Array, ...]:
        """Some slots of an observation, each [... x 2].  observation: [... x size]; *slots: names out of `interface.layout`."""
        return tuple(observation[..., self.interface.layout[slot]] for slot in slots)

    def predict(
        self,
        observation: Array,
        state: State | None = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
    ) -> tuple[Array, State | None]:
        """The action.  observation, state, episode_start, deterministic: as in `Policy.predict`."""
        size = self.interface.layout.size
        observation = np.asarray(observation, dtype=float)
        if observation.ndim not in (1, 2) or observation.shape[-1] != size:
            raise ValueError(
                f"observation must have shape ({size},) or (n, {size}), as this policy was built for, "
                f"got {observation.shape}"
            )
        batch = np.atleast_2d(observation)
        if state is None:
            state = self.initial(batch)
        elif episode_start is not None and np.any(episode_start):
            begins = np.broadcast_to(np.asarray(episode_start, dtype=bool), len(batch))
            fresh = self.initial(batch)
            state = tuple(
                np.where(begins.reshape(-1, *[1] * (old.ndim - 1)), new, old)
                for new, old in zip(fresh, state, strict=True)
            )
        torque, state = self.torque(batch, state)
        position = batch[..., self.interface.layout["position"]]
        velocity = (
            batch[..., self.interface.layout["velocity"]] if "velocity" in self.interface.layout else position * 0.0
        )
        action = self.interface.action_from_torque(torque, position, velocity)
        return (action if observation.ndim == 2 else action[0]), state


@dataclass(frozen=True)
class _Entry:
    factory: str | Callable[..., Any]
    summary: str
    access: str
    kind: str


_REGISTRY: dict[str, _Entry] = {}
ENTRY_POINTS = "fbl_gym.policies"

TUNED = Path(__file__).with_name("tuned")
"""Folder of tuned gains: POLICY.json is what `fbl-gym tune POLICY` found, and makes the policy POLICY@tuned."""


def register(
    name: str,
    factory: str | Callable[..., Any],
    summary: str,
    access: str = "nominal",
    kind: str = "classical",
) -> None:
    """Make a policy known by name.

    Args:
        name: lower case, words joined by hyphens.
        factory: called as `factory(interface, **gains)`, or "module:attribute" that leads to it. One whose first parameter is
            called `env` is given the environment instead, as only the privileged access may be.
        summary: one line.
        access: what it is told: "none", "nominal" or "privileged".
        kind: "classical" or "learned".
    """
    if name in _REGISTRY:
        raise ValueError(f"a policy named {name!r} is registered already")
    _REGISTRY[name] = _Entry(
        factory, summary, check_choice("access", access, ACCESS), check_choice("kind", kind, KINDS)
    )


@lru_cache(maxsize=1)
def _entry_points() -> tuple[metadata.EntryPoint, ...]:
    """Those of installed packages, read from the disk once."""
    return tuple(metadata.entry_points(group=ENTRY_POINTS))


def _strangers() -> dict[str, metadata.EntryPoint]:
    return {point.name: point for point in _entry_points() if point.name not in _REGISTRY}


def names() -> tuple[str, ...]:
    """Every known policy: the package's own, then those of installed packages (entry points `fbl_gym.policies`)."""
    return (*_REGISTRY, *_strangers())


def tuned() -> tuple[str, ...]:
    """The policies with tuned gains, such as "pid-flm@tuned"."""
    return tuple(f"{name}@tuned" for name in _REGISTRY if (TUNED / f"{name}.json").is_file())


def tuned_gains(name: str) -> dict[str, float]:
    """The gains behind a tuned policy, such as {"kp": 25.0}.  name: one of `tuned()`."""
    if name not in tuned():
        raise unknown("tuned policy", name, tuned())
    found: dict[str, float] = json.loads((TUNED / f"{name.removesuffix('@tuned')}.json").read_text())["gains"]
    return found


def _entry(name: str) -> _Entry:
    name = name.removesuffix("@tuned")
    if name in _REGISTRY:
        return _REGISTRY[name]
    strangers = _strangers()
    if name not in strangers:
        raise unknown("policy", name, names())
    factory = strangers[name].load()
    text = (inspect.getdoc(factory) or "").split("\n")[0]
    return _Entry(factory, text, getattr(factory, "access", "nominal"), getattr(factory, "kind", "classical"))


def summary(name: str) -> str:
    """One line on a policy.  name: one of `names()`, or POLICY@tuned."""
    return _entry(name).summary


def access(name: str) -> str:
    """What a policy is told: "none", "nominal" or "privileged".  name: one of `names()`, or POLICY@tuned."""
    return _entry(name).access


def kind(name: str) -> str:
    """Whether a policy is "classical" or "learned".  name: one of `names()`, or POLICY@tuned."""
    return _entry(name).kind


def factory(name: str) -> Callable[..., Any]:
    """What makes a policy: a class or a function, called with the interface (or the environment) and gains.

    name: one of `names()`, or POLICY@tuned.
    """
    found = _entry(name).factory
    if isinstance(found, str):
        module, attribute = found.split(":")
        found = getattr(importlib.import_module(module), attribute)
    return found


def make(name: str | Callable[..., Any], env: Any, **gains: Any) -> Policy:
    """A policy by name, for an environment.

    Args:
        name: one of `names()`, or a factory as `register` takes it.
        env: the environment, single or batched, wrapped or not; or its `interface`.
        **gains: arguments of the policy; left out, they take their defaults.
    """
    build = factory(name) if isinstance(name, str) else name
    if isinstance(name, str) and name.endswith("@tuned"):
        gains = tuned_gains(name) | gains
    parameters = list(inspect.signature(build).parameters)
    if not parameters:
        raise ValueError(f"{_called(name)} makes no policy: it must take the interface, or env, as its first argument")
    for gain in gains:
        if gain not in parameters[1:]:
            raise unknown(f"argument of {_called(name)}", gain, parameters[1:])
    if parameters[0] == "env":
        if isinstance(env, Interface):
            raise ValueError(f"{_called(name)} looks at the truth, so it needs the environment, got its interface")
        return build(env.unwrapped, **gains)
    return build(env if isinstance(env, Interface) else env.unwrapped.interface, **gains)


def _called(name: str | Callable[..., Any]) -> str:
    return name if isinstance(name, str) else getattr(name, "__name__", repr(name))


for _name, _factory, _summary, _tier in (
    ("zero", "controllers.simple:Zero", "no torque at all: the floor", "none"),
    ("pd-gravity", "controllers.simple:PdGravity", "PD with the nominal gravity torque", "nominal"),
    (
        "pid-flm",
        "controllers.pid:PidFlm",
        "the paper's PID through nominal feedback linearisation (§2.2)",
        "nominal",
    ),
    (
        "cascade-flm",
        "controllers.cascade:CascadeFlm",
        "the paper's cascade: inner velocity PI, outer P with feed-forward (§3.1)",
        "nominal",
    ),
    (
        "robust-flm",
        "controllers.kalman:RobustFlm",
        "the paper's robust controller: the cascade behind a Kalman filter per joint (§3)",
        "nominal",
    ),
    (
        "adaptive-flm",
        "controllers.adaptive:AdaptiveFlm",
        "the paper's adaptive controller: three-sample parameter estimator, gain scheduling, cascade (§4)",
        "nominal",
    ),
    (
        "adaptive-flm-ls",
        "controllers.adaptive_ls:AdaptiveFlmLs",
        "its idea made fit for noise: least squares on filtered regressors, friction too, behind the Kalman filter",
        "nominal",
    ),
    ("adrc", "controllers.adrc:Adrc", "active disturbance rejection on the position sensor alone", "nominal"),
    (
        "time-delay",
        "controllers.time_delay:TimeDelay",
        "time-delay control: what the last torque missed, by the accelerometer, is added to the next",
        "nominal",
    ),
    (
        "lqg",
        "controllers.lqg:Lqg",
        "optimal regulator with integral action behind the Kalman filter, on the nominally linearised arm",
        "nominal",
    ),
    (
        "rbf-adaptive",
        "controllers.rbf_adaptive:RbfAdaptive",
        "neural adaptive control: radial basis functions along the reference learn what the model misses",
        "nominal",
    ),
    ("pid-gravity", "controllers.pid_gravity:PidGravity", "PID with the nominal gravity torque", "nominal"),
    (
        "computed-torque",
        "controllers.computed_torque:ComputedTorque",
        "plain computed torque, critically damped",
        "nominal",
    ),
    (
        "computed-torque-dob",
        "controllers.disturbance_observer:ComputedTorqueDob",
        "computed torque with a momentum-based disturbance observer (De Luca)",
        "nominal",
    ),
    (
        "slotine-li",
        "controllers.slotine_li:SlotineLi",
        "adaptive passivity-based control of the lumped parameters (Slotine and Li)",
        "nominal",
    ),
    (
        "slotine-li-composite",
        "controllers.slotine_li:CompositeSlotineLi",
        "the same, driven by the prediction error of the torque too",
        "nominal",
    ),
    (
        "sliding-mode",
        "controllers.sliding_mode:SuperTwisting",
        "super-twisting on the nominal linearisation (Levant; Moreno and Osorio)",
        "nominal",
    ),
    (
        "nmpc",
        "controllers.nmpc:Nmpc",
        "nonlinear model predictive control with a disturbance estimate and preview (needs casadi)",
        "nominal",
    ),
    (
        "spong-robust",
        "controllers.spong:SpongRobust",
        "Spong's robust law with a bound for each parameter",
        "nominal",
    ),
    (
        "oracle-flm",
        "controllers.oracle:OracleFlm",
        "feedback linearisation with the true parameters, state, friction and disturbance: the ceiling",
        "privileged",
    ),
):
    register(_name, _factory, _summary, _tier)
