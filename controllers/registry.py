"""The registry: policies by name.

It has the built-in laws of `catalogue.toml`, the policies of installed packages (entry points of
the group `fbl_gym.policies`), and those that a program registers itself. LAW+PART, such as
"computed-torque+kalman+predictor", is a law composed with parts (`composition.py`). POLICY@servo
is a built-in law, composed or not, with the gains of `tuned/servo/POLICY.json`, which are for a
class of robots. POLICY@tuned has the gains for the class of the robot that it is made for. Where
LAW+PART has no such file, it has the gains of LAW, and the part its defaults.
"""

import inspect
import json
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from controllers import name as naming
from controllers.base import ACCESS, Policy
from controllers.composition import completed, compose
from controllers.name import Multiple, PolicyName
from fbl_gym.interface import Interface
from fbl_gym.records.checks import check_choice, unknown

KINDS = ("classical", "learned")

#: Attributes by which the factory of a policy declares something; no gain has such a name.
DECLARED = ("access", "data_files", "kind", "missing", "needs", "packages", "preview", "uses")

ENTRY_POINTS = "fbl_gym.policies"


@dataclass(frozen=True)
class _Entry:
    factory: str | Callable[..., Any]
    summary: str = ""
    access: str | None = None
    kind: str = "classical"


_REGISTRY: dict[str, _Entry] = {}


def register(
    name: str, factory: str | Callable[..., Any], summary: str, access: str | None = None, kind: str = "classical"
) -> None:
    """Add a policy to the registry.

    Args:
        name: lower case, words joined by hyphens.
        factory: a class or function, called as `factory(interface, **gains)`, or its
            "module:attribute". An oracle is called with the environment instead.
        summary: one line.
        access: "none", "nominal" or "oracle"; None: the factory's attribute, or "nominal".
        kind: "classical" or "learned".

    Raises:
        ValueError: the name is taken, or `access` or `kind` is unknown.
    """
    if name in _REGISTRY:
        raise ValueError(f"a policy named {name!r} is registered already")
    if access is not None:
        check_choice("access", access, ACCESS)
    _REGISTRY[name] = _Entry(factory, summary, access, check_choice("kind", kind, KINDS))


#: The built-in laws by name, each with its module, its summary, and its access if not "nominal".
CATALOGUE = tomllib.loads(Path(__file__).with_name("catalogue.toml").read_text(encoding="utf-8"))

for _name, _law in CATALOGUE.items():
    _path = f"controllers.{_law['module']}:{_name.title().replace('-', '')}"
    register(_name, _path, _law["summary"], _law.get("access", "nominal"))


def entry_points() -> tuple[metadata.EntryPoint, ...]:
    """Return the entry points by which installed packages register policies."""
    return _entry_points(tuple(sys.path))


@lru_cache(maxsize=1)
def _entry_points(_path: tuple[str, ...]) -> tuple[metadata.EntryPoint, ...]:
    return tuple(metadata.entry_points(group=ENTRY_POINTS))


def external() -> dict[str, metadata.EntryPoint]:
    """Return the entry points of policies without another registration, by name, not loaded."""
    # The agents of fbl-gym come last, so that no other package replaces them.
    points = sorted(entry_points(), key=lambda point: point.module.startswith("benchmarks."))
    return {point.name: point for point in points if point.name not in _REGISTRY}


def as_name(policy: Any) -> Any:
    """Return the `PolicyName` that a text gives; a name or a factory is returned unchanged."""
    return PolicyName.parse(policy) if isinstance(policy, str) else policy


def _entry(policy: str | PolicyName | Callable[..., Any]) -> _Entry:
    """Return a policy's entry, with its factory imported if it is composed or from a package."""
    name = as_name(policy)
    if not isinstance(name, PolicyName):
        return _Entry(name)
    if name.parts:
        law, summary = _entry(name.source), f"; with {' and '.join(name.parts)}"
        return _Entry(compose(_load(law), *name.parts), law.summary + summary, kind=law.kind)
    if name.source in _REGISTRY:
        return _REGISTRY[name.source]
    if name.form != "name":
        other = f"give its class, or benchmarks.policies.spec.resolve({str(name)!r}).make"
        raise ValueError(f"policy must be a name here, got {str(name)!r}: {other}")
    if name.source not in external():
        raise unknown("policy", name.law, names())
    factory = external()[name.source].load()
    check_gains(name, factory)
    summary = (inspect.getdoc(factory) or "").split("\n")[0]
    kind = check_choice(f"kind of {name.source}", getattr(factory, "kind", "classical"), KINDS)
    return _Entry(factory, summary, kind=kind)


def check_gains(policy: str | PolicyName, factory: Callable[..., Any]) -> None:
    """Refuse a law with a gain whose name is one of `DECLARED`."""
    names = {field.name for field in fields(factory)} if is_dataclass(factory) else set()
    for gain in sorted(names.intersection(DECLARED)):
        why = "the name is reserved for what a policy declares of itself"
        hint = "(or is it a declaration? Then annotate it as ClassVar)"
        raise ValueError(f"gain {gain!r} of {policy} must have another name: {why} {hint}")


def _load(entry: _Entry) -> Callable[..., Any]:
    given = entry.factory
    return metadata.EntryPoint("", given, "").load() if isinstance(given, str) else given


def check_name(name: PolicyName) -> None:
    """Refuse a name that means no registered policy, without loading one of another package."""
    misspelt = [gain for gain in name.gains if gain.isidentifier() and not Path(gain).is_dir()]  # "tunned", rather
    if name.form != "name" or name.source not in names() or misspelt:
        raise unknown("policy", str(name), (*names(), *tuned()))
    if name.parts:
        factory(name)  # refuses parts that do not fit
    if name.tuned:
        tuned_gains(name)  # refuses those that there are not


def names() -> tuple[str, ...]:
    """Return the name of every policy: registered ones, then those of installed packages."""
    return (*_REGISTRY, *external())


def summary(policy: str | PolicyName) -> str:
    """Return one line on a policy, by its name or POLICY@tuned."""
    return _entry(policy).summary


def kind(policy: str | PolicyName) -> str:
    """Return "classical" or "learned" for a policy, by its name or POLICY@tuned."""
    return _entry(policy).kind


def access(policy: str | PolicyName | Callable[..., Any]) -> str:
    """Return what a policy may know: "none", "nominal" or "oracle".

    The policy is a name, POLICY@tuned, or a factory as `register` takes it.
    """
    entry = _entry(policy)
    given = entry.access or getattr(_load(entry), "access", "nominal")
    return check_choice(f"access of {_name_of(policy)}", given, ACCESS)


def factory(policy: str | PolicyName | Callable[..., Any]) -> Callable[..., Any]:
    """Return the class or function that builds a policy, called as `register` describes.

    The policy is a name, POLICY@tuned, or the class or function itself.
    """
    return _load(_entry(policy))


def tuned(tuning: str = "tuned") -> tuple[str, ...]:
    """Return the policies with gains for a class of robots, or for any, such as "pid-flm@tuned".

    Composed ones come last.
    """
    files = {path.stem for path in naming.TUNED.glob("*/*.json" if tuning == "tuned" else f"{tuning}/*.json")}
    known = (*(name for name in _REGISTRY if name in files), *sorted(files - {*_REGISTRY}))
    return tuple(f"{name}@{tuning}" for name in known)


def tuned_gains(policy: str | PolicyName, robot: str = "") -> dict[str, Any]:
    """Return the gains of a tuned policy, such as {"kp": 25.0} of "pid-flm@servo".

    Args:
        policy: POLICY@tuned, or POLICY@CLASS.
        robot: class of the robot; empty: the first one with gains.

    Raises:
        ValueError: there are none for the class.
    """
    name = as_name(policy)
    files, robot = name.tuned_files, name.robot_of(robot)
    if robot in files:
        return json.loads(files[robot].read_text())["gains"]
    factory(name)  # refuses an unknown law
    where = f"the class {robot}" if robot else "any class of robots"
    command = f"`fbl-gym tune {name.law} --class {robot or 'CLASS'}` finds some, for {name.law}@results/gains"
    raise ValueError(f"{name.law} has no tuned gains for {where}: {command}")


def interface_of(env: Any) -> Interface:
    """Return the interface of an environment; refuse one with observations of another form."""
    arm = env.unwrapped
    interface = getattr(arm, "interface", None)
    if not interface or getattr(arm, "single_observation_space", arm.observation_space) != interface.observation_space:
        raise ValueError(f"env must observe one scenario as TwoLinkArm-v0 does, got a {type(arm).__name__}")
    return interface


def make(policy: str | PolicyName | Callable[..., Any], env: Any, **gains: Any) -> Policy:
    """Build a policy for an environment.

    Only an oracle gets the environment itself; any other policy gets its interface and nothing
    else. A law that needs an absent sensor is composed with an observer (see
    `composition.completed`).

    Args:
        policy: one of `names()`, LAW+PART, either with @tuned, or a factory as `register` takes
            it. A name may end in gains: "pid-flm@K=30", "pid-flm@K=0.5x" for half the tuned or
            default gain, "pid-flm@my_gains.json", or "pid-flm@my_gains", which is
            my_gains/pid-flm.json. The end of "ppo-blend@2" is an agent's training seed.
        env: the environment, single or batched, wrapped or not; or its `interface`.
        **gains: arguments of the policy; those left out take their defaults.

    Raises:
        ValueError: the name or a gain is unknown, a gain is out of bounds, or an interface is given
            where an oracle needs the environment.
    """
    interface = env if isinstance(env, Interface) else interface_of(env)
    policy, tuned = as_name(policy), {}
    build = completed(factory(policy), interface)
    if isinstance(policy, PolicyName):
        gains = policy.given_gains | gains
        tuned = tuned_gains(policy, interface.robot_class) if policy.tuned else {}
    parameters = inspect.signature(build).parameters
    if not parameters:
        raise ValueError(f"{_name_of(policy)} makes no policy: it must take the interface as its first argument")
    free = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    for gain, value in gains.items():
        if gain not in (known := list(parameters)[1:]) and not free:
            undecorated = isinstance(build, type) and "__dataclass_params__" not in vars(build)
            hint = "; are @dataclass(frozen=True) and its annotation missing?" if undecorated else ""
            raise ValueError(f"{unknown(f'argument of {_name_of(policy)}', gain, known)}{hint}")
        if isinstance(value, Multiple):
            default = parameters[gain].default if gain in parameters else None
            gains[gain] = value.of(gain, tuned.get(gain, default))
    gains = tuned | gains
    if access(policy) == "oracle":
        if isinstance(env, Interface):
            raise ValueError(f"{_name_of(policy)} reads the truth: it needs the environment, got its interface")
        return build(env.unwrapped, **gains)
    return build(interface, **gains)


def _name_of(policy: str | PolicyName | Callable[..., Any]) -> str:
    name = as_name(policy)
    return name.law if isinstance(name, PolicyName) else getattr(name, "__name__", repr(name))
