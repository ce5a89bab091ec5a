"""The registry: policies by name.

It has the built-in laws of `catalogue.py`, the policies of installed packages (entry points of the
group `fbl_gym.policies`), and those that a program registers itself. LAW+PART, such as
"computed-torque+kalman+predictor", is a law composed with parts (`composition.py`). POLICY@servo
is a built-in law, composed or not, with the gains of `tuned/servo/POLICY.json`, which are for a
class of robots. POLICY@tuned has the gains for the class of the robot that it is made for. Where
LAW+PART has no such file, it has the gains of LAW, and the part its defaults.
"""

import inspect
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from controllers import catalogue
from controllers.base import ACCESS, Policy
from controllers.composition import PARTS, completed, compose
from controllers.gains import TUNINGS, Multiple, read_gains, split_gains, stored_gains
from fbl_gym.interface import Interface
from fbl_gym.records.checks import check_choice, check_choices, unknown
from fbl_gym.scenarios.classes import CLASSES

KINDS = ("classical", "learned")

ENTRY_POINTS = "fbl_gym.policies"

TUNED = Path(__file__).with_name("tuned")
"""Folder of tuned gains: `fbl-gym tune POLICY --class CLASS --ship` writes CLASS/POLICY.json."""


@dataclass(frozen=True)
class _Entry:
    factory: str | Callable[..., Any]
    summary: str
    access: str | None
    kind: str


_REGISTRY: dict[str, _Entry] = {}


@dataclass(frozen=True)
class LawName:
    """The name of a policy in the registry: LAW, LAW+PART, either with @ and one of `TUNINGS`."""

    law: str
    parts: tuple[str, ...] = ()
    tuned: str = ""

    @classmethod
    def parse(cls, text: str) -> "LawName":
        """Return the name that a text gives."""
        code, _, tuning = text.rpartition("@")
        code, tuning = (code, tuning) if tuning in TUNINGS else (text, "")
        law, *parts = code.split("+")
        return cls(law, tuple(parts), tuning)

    @property
    def files(self) -> dict[str, Path]:
        """The files of the tuned gains, by the class of robots."""
        classes = CLASSES if self.tuned == "tuned" else (self.tuned,)
        paths = {robot: stored_gains(self.law_and_parts, TUNED / robot) for robot in classes}
        return {robot: path for robot, path in paths.items() if path.is_file()}

    @property
    def law_and_parts(self) -> str:
        """The name without tuned gains."""
        return "+".join((self.law, *self.parts))

    def __str__(self) -> str:
        return self.law_and_parts + f"@{self.tuned}" * bool(self.tuned)


def register(
    name: str, factory: str | Callable[..., Any], summary: str, access: str | None = None, kind: str = "classical"
) -> None:
    """Add a policy to the registry.

    Args:
        name: lower case, words joined by hyphens.
        factory: a class or function, called as `factory(interface, **gains)`, or its
            "module:attribute". With privileged access it is called with the environment instead.
        summary: one line.
        access: "none", "nominal" or "privileged"; None: the factory's attribute, or "nominal".
        kind: "classical" or "learned".

    Raises:
        ValueError: the name is taken, or `access` or `kind` is unknown.
    """
    if name in _REGISTRY:
        raise ValueError(f"a policy named {name!r} is registered already")
    if access is not None:
        check_choice("access", access, ACCESS)
    _REGISTRY[name] = _Entry(factory, summary, access, check_choice("kind", kind, KINDS))


for _name, _path, _summary in catalogue.LAWS:
    register(_name, f"controllers.{_path}", _summary, catalogue.ACCESS.get(_name, "nominal"))


@lru_cache(maxsize=1)
def entry_points() -> tuple[metadata.EntryPoint, ...]:
    """Return the entry points by which installed packages register policies."""
    return tuple(metadata.entry_points(group=ENTRY_POINTS))


def external() -> dict[str, metadata.EntryPoint]:
    """Return the entry points of policies without another registration, by name, not loaded."""
    # The agents of fbl-gym come last, so that no other package replaces them.
    points = sorted(entry_points(), key=lambda point: point.module.startswith("benchmarks."))
    return {point.name: point for point in points if point.name not in _REGISTRY}


def _entry(text: str) -> _Entry:
    parsed = LawName.parse(text)
    name = parsed.law
    if parsed.parts:
        law = _entry(name)
        factory = compose(_load(law), *parsed.parts)
        return _Entry(factory, f"{law.summary}; with {' and '.join(parsed.parts)}", None, law.kind)
    if name in _REGISTRY:
        return _REGISTRY[name]
    if name not in external():
        raise unknown("policy", name, names())
    factory = external()[name].load()
    summary = (inspect.getdoc(factory) or "").split("\n")[0]
    kind = check_choice(f"kind of {name}", getattr(factory, "kind", "classical"), KINDS)
    return _Entry(factory, summary, None, kind)


def _load(entry: _Entry) -> Callable[..., Any]:
    given = entry.factory
    return metadata.EntryPoint("", given, "").load() if isinstance(given, str) else given


def is_composed(name: str) -> bool:
    """Return True for a text LAW+PART whose law has a registered name, and tuned gains if @tuned.

    Raises:
        ValueError: a part is unknown.
    """
    parsed = LawName.parse(name)
    if not parsed.parts or parsed.law not in names():
        return False
    check_choices("parts", parsed.parts, PARTS)
    return not parsed.tuned or bool(parsed.files)


def names() -> tuple[str, ...]:
    """Return the name of every policy: registered ones, then those of installed packages."""
    return (*_REGISTRY, *external())


def summary(name: str) -> str:
    """Return one line on a policy, by its name or POLICY@tuned."""
    return _entry(name).summary


def kind(name: str) -> str:
    """Return "classical" or "learned" for a policy, by its name or POLICY@tuned."""
    return _entry(name).kind


def access(policy: str | Callable[..., Any]) -> str:
    """Return what a policy may know: "none", "nominal" or "privileged".

    The policy is a name, POLICY@tuned, or a factory as `register` takes it.
    """
    if isinstance(policy, str) and (registered := _entry(policy).access) is not None:
        return registered
    build = factory(policy) if isinstance(policy, str) else policy
    return check_choice(f"access of {_name_of(policy)}", getattr(build, "access", "nominal"), ACCESS)


def factory(name: str) -> Callable[..., Any]:
    """Return the class or function that builds a policy, called as `register` describes."""
    return _load(_entry(name))


def tuned(tuning: str = "tuned") -> tuple[str, ...]:
    """Return the policies with gains for a class of robots, or for any, such as "pid-flm@tuned".

    Composed ones come last.
    """
    files = {path.stem for path in TUNED.glob("*/*.json" if tuning == "tuned" else f"{tuning}/*.json")}
    known = (*(name for name in _REGISTRY if name in files), *sorted(files - {*_REGISTRY}))
    return tuple(f"{name}@{tuning}" for name in known)


def tuned_gains(name: str, robot: str = "") -> dict[str, Any]:
    """Return the gains of a tuned policy, such as {"kp": 25.0} of "pid-flm@servo".

    Args:
        name: POLICY@tuned, or POLICY@CLASS.
        robot: class of the robot; empty: the first one with gains.

    Raises:
        ValueError: there are none for the class.
    """
    parsed = LawName.parse(name)
    files = parsed.files
    robot = parsed.tuned if parsed.tuned in CLASSES else robot or next(iter(files), "")
    if robot in files:
        return json.loads(files[robot].read_text())["gains"]
    law = parsed.law_and_parts
    if not (law in names() or is_composed(law)):
        raise unknown("policy", law, names())
    where = f"the class {robot}" if robot else "any class of robots"
    raise ValueError(
        f"{law} has no tuned gains for {where}: `fbl-gym tune {law} --class {robot or 'CLASS'}` finds some, "
        f"for {law}@results/gains"
    )


def make(name: str | Callable[..., Any], env: Any, **gains: Any) -> Policy:
    """Build a policy for an environment.

    Only a policy with privileged access gets the environment itself; any other gets its interface
    and nothing else. A law that needs an absent sensor is composed with an observer (see
    `composition.completed`).

    Args:
        name: one of `names()`, LAW+PART, either with @tuned, or a factory as `register` takes it. A
            name may end in gains: "pid-flm@K=30", "pid-flm@K=0.5x" for half the tuned or default
            gain, "pid-flm@my_gains.json", or "pid-flm@my_gains", which is my_gains/pid-flm.json.
            The end of "ppo-memory@2" is an agent's training seed.
        env: the environment, single or batched, wrapped or not; or its `interface`.
        **gains: arguments of the policy; those left out take their defaults.

    Raises:
        ValueError: the name or a gain is unknown, a gain is out of bounds, or an interface is given
            where privileged access needs the environment.
    """
    build: Callable[..., Any]
    tuned: dict[str, Any] = {}
    interface = env if isinstance(env, Interface) else env.unwrapped.interface
    if isinstance(name, str):
        name, given = split_gains(name)
        build = factory(name)
        tuned = tuned_gains(name, interface.robot_class) if LawName.parse(name).tuned else {}
        gains = read_gains(name, given) | gains
    else:
        build = name
    build = completed(build, interface)
    parameters = inspect.signature(build).parameters
    if not parameters:
        raise ValueError(f"{_name_of(name)} makes no policy: it must take the interface as its first argument")
    for gain, value in gains.items():
        if gain not in (known := list(parameters)[1:]):
            raise unknown(f"argument of {_name_of(name)}", gain, known)
        if isinstance(value, Multiple):
            gains[gain] = value.of(gain, tuned.get(gain, parameters[gain].default))
    gains = tuned | gains
    if access(name) == "privileged":
        if isinstance(env, Interface):
            raise ValueError(f"{_name_of(name)} reads the truth: it needs the environment, got its interface")
        return build(env.unwrapped, **gains)
    return build(interface, **gains)


def _name_of(policy: str | Callable[..., Any]) -> str:
    return policy if isinstance(policy, str) else getattr(policy, "__name__", repr(policy))
