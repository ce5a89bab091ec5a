"""What a policy is, the base that torque laws share, and the registry of names.

A policy is anything with stable-baselines3's `predict(observation, state, episode_start, deterministic)`, so that a
controller goes wherever an SB3 model goes. Controllers are frozen records of their gains; what changes while they run travels
in `state`.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np

from fbl_gym.arm import Array
from fbl_gym.interface import Interface
from fbl_gym.records import choice, unknown

State: TypeAlias = tuple[Array, ...]

TIERS = ("nothing", "nominal model", "truth")
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
    [n x 2] N m, and a state is a tuple of arrays with n rows each. `needs` names the sensors without which it cannot run.
    """

    interface: Interface

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity")
    tier: ClassVar[str] = "nominal model"

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
        """The torque wished for [n x 2] N m (limits are applied after), and the next state."""
        raise NotImplementedError

    def read(self, observation: Array, *slots: str) -> tuple[Array, ...]:
        """The named slots of an observation, each [n x 2]."""
        return tuple(observation[..., self.interface.layout[slot]] for slot in slots)

    def predict(
        self,
        observation: Array,
        state: State | None = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
    ) -> tuple[Array, State | None]:
        """See `Policy.predict`."""
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
    tier: str


_REGISTRY: dict[str, _Entry] = {}
ENTRY_POINTS = "fbl_gym.policies"


def register(name: str, factory: str | Callable[..., Any], summary: str, tier: str = "nominal model") -> None:
    """Make a policy known by name.

    Args:
        name: lower case, words joined by hyphens.
        factory: called as factory(interface, **gains), or "module:attribute" that leads to it. One whose first parameter is
            called `env` is given the environment instead, as only the truth tier may be.
        summary: one line.
        tier: what it is told: "nothing", "nominal model" or "truth".
    """
    if name in _REGISTRY:
        raise ValueError(f"a policy named {name!r} is registered already")
    _REGISTRY[name] = _Entry(factory, summary, choice("tier", tier, TIERS))


def _strangers() -> dict[str, Any]:
    return {point.name: point for point in metadata.entry_points(group=ENTRY_POINTS) if point.name not in _REGISTRY}


def names() -> tuple[str, ...]:
    """Every known policy: the package's own, then those of installed packages (entry points `fbl_gym.policies`)."""
    return (*_REGISTRY, *_strangers())


def _entry(name: str) -> _Entry:
    if name in _REGISTRY:
        return _REGISTRY[name]
    strangers = _strangers()
    if name not in strangers:
        raise unknown("policy", name, names())
    factory = strangers[name].load()
    text = (inspect.getdoc(factory) or "").split("\n")[0]
    return _Entry(factory, text, getattr(factory, "tier", "nominal model"))


def summary(name: str) -> str:
    """One line on a policy."""
    return _entry(name).summary


def tier(name: str) -> str:
    """What a policy is told: "nothing", "nominal model" or "truth"."""
    return _entry(name).tier


def make(name: str, env: Any, **gains: Any) -> Policy:
    """A policy by name, for an environment.

    Args:
        name: one of `names()`.
        env: the environment, single or batched, wrapped or not; or its `interface`.
        **gains: arguments of the policy; left out, they take their defaults.
    """
    entry = _entry(name)
    factory = entry.factory
    if isinstance(factory, str):
        module, attribute = factory.split(":")
        factory = getattr(importlib.import_module(module), attribute)
    parameters = list(inspect.signature(factory).parameters)
    for gain in gains:
        if gain not in parameters[1:]:
            raise unknown(f"argument of {name}", gain, parameters[1:])
    if parameters[0] == "env":
        if isinstance(env, Interface):
            raise ValueError(f"{name} looks at the truth, so it needs the environment, got its interface")
        return factory(env.unwrapped, **gains)
    return factory(env if isinstance(env, Interface) else env.unwrapped.interface, **gains)


for _name, _factory, _summary, _tier in (
    ("zero", "controllers.simple:Zero", "no torque at all: the floor", "nothing"),
    ("pd-gravity", "controllers.simple:PdGravity", "PD with the nominal gravity torque", "nominal model"),
    (
        "pid-flm",
        "controllers.pid:PidFlm",
        "the paper's PID through nominal feedback linearisation (§2.2)",
        "nominal model",
    ),
    (
        "cascade-flm",
        "controllers.cascade:CascadeFlm",
        "the paper's cascade: inner velocity PI, outer P with feed-forward (§3.1)",
        "nominal model",
    ),
    (
        "robust-flm",
        "controllers.kalman:RobustFlm",
        "the paper's robust controller: the cascade behind a Kalman filter per joint (§3)",
        "nominal model",
    ),
    (
        "adaptive-flm",
        "controllers.adaptive:AdaptiveFlm",
        "the paper's adaptive controller: three-sample parameter estimator, gain scheduling, cascade (§4)",
        "nominal model",
    ),
    (
        "adaptive-flm-ls",
        "controllers.adaptive_ls:AdaptiveFlmLs",
        "its idea made fit for noise: least squares on filtered regressors, friction too, behind the Kalman filter",
        "nominal model",
    ),
    (
        "oracle-flm",
        "controllers.oracle:OracleFlm",
        "feedback linearisation with the true parameters, state, friction and disturbance: the ceiling",
        "truth",
    ),
):
    register(_name, _factory, _summary, _tier)
