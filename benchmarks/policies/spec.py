"""Policies by name: `resolve` turns a name into a `PolicySpec`, which everything else works with.

`controllers.name.PolicyName` is the name, read once from its text. `loading.load` turns it into the
policy's factory, and `key.py` has all that its numbers depend on. `PolicySpec.call` runs external
code in a process of its own (`isolation.py`). `PolicySpec.make` makes the policy for an
environment, unless what it depends on has changed.
"""

import contextlib
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from glob import glob
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from benchmarks.policies import key
from benchmarks.policies.isolation import Answer, CallLimits, Failed, run_isolated
from benchmarks.policies.loading import FILE_MODULE, IMPORTED, NotFound, is_code, load, outside_module
from controllers import registry
from controllers.base import ACCESS
from controllers.name import PolicyName
from fbl_gym import scenarios
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.records.checks import check_choice, check_number, unknown


class BadDeclaration(ValueError):
    """A policy's factory declares something that is not allowed."""


class Changed(ValueError):
    """A policy's code or data are not those of its specification."""


@dataclass(frozen=True)
class PolicySpec:
    """A policy that has been resolved: plain data that any process can make the same policy from.

    Args:
        parsed: its name.
        kind: "classical" or "learned".
        access: what the policy may know: "none", "nominal" or "oracle".
        needs: the sensors that it cannot do without.
        preview: how far ahead it sees the reference [s].
        tuning: "default gains", "given gains", "tuned" or "trained".
        external: False for a policy of fbl-gym.
        summary: one line.
        shared: hash of the code behind every result.
        code: hash of each module of its own code, by the module's name.
        uses: hash of each law that it uses, by the law's name.
        data: hash of each of its data files, by the name relative to its code.
        packages: installed packages that it computes with.
        tuned: its tuned gains for each class of robots, as plain data.
        gains: those that its name gives, as plain data.
        problem: error of its declaration, for which no result can be stored; empty: none.
        files: the file of each module and of the data, by the names above.
        rows: names of the rows of a board that it is a member of; empty: its own name.
    """

    parsed: PolicyName
    kind: str = "classical"
    access: str = "nominal"
    needs: tuple[str, ...] = ()
    preview: float = 0.0
    tuning: str = "default gains"
    external: bool = False
    summary: str = ""
    shared: str = ""
    code: Mapping[str, str] = field(default_factory=dict, hash=False)
    uses: Mapping[str, str] = field(default_factory=dict, hash=False)
    data: Mapping[str, str] = field(default_factory=dict, hash=False)
    packages: tuple[str, ...] = ()
    tuned: Mapping[str, Any] = field(default_factory=dict, hash=False)
    gains: Mapping[str, Any] = field(default_factory=dict, hash=False)
    problem: str = ""
    files: Mapping[str, str] = field(default_factory=dict, compare=False)
    rows: tuple[str, ...] = field(default=(), compare=False)

    @property
    def name(self) -> str:
        """The text that names the policy."""
        return str(self.parsed)

    @property
    def ranked(self) -> bool:
        """True if the board ranks the policy: it does not know the truth."""
        return self.access != "oracle"

    @property
    def identity(self) -> dict[str, Any]:
        """All that distinguishes this policy from others, but not the place of an external one."""
        name = self.parsed
        text = str(name.code) if name.form == "name" else f"external:{'+'.join((name.attribute, *name.parts))}"
        others = ("access", "shared", "code", "uses", "data", "tuned", "gains")
        return {"policy": text} | {other: getattr(self, other) for other in others}

    def make(self, env: Any, **gains: Any) -> Any:
        """Return the policy for an environment, wrapped or not, or for its `interface`.

        Raises:
            Changed: the policy in this process is not the one that was resolved.
        """
        return build(self.parsed, self.factory(), env, **gains)

    def factory(self) -> Callable[..., Any]:
        """Return the class or function that makes the policy from the interface and gains.

        Raises:
            Changed: code or data are not those of the specification.
        """
        if self.problem:
            raise ValueError(self.problem)
        was = {"shared code": self.shared, **self.code, **self.data}
        now = {"shared code": key.shared(), **key.digests(self.files)}
        if changed := [name or self.parsed.source for name in was if was[name] != now.get(name)]:
            raise Changed(f"{' and '.join(changed)} of {self.name} changed since it was resolved; run it again")
        factory = load(self.parsed)
        if not self.code:
            raise Changed(f"{self.name} could not be read when it was resolved; run it again")
        return factory

    def call(self, function: Callable[..., Answer], *arguments: Any, limits: CallLimits | None = None) -> Answer:
        """Call a function that makes the policy; in a fresh process, if external code may run.

        Args:
            function: as for `run_isolated`.
            *arguments: of the function.
            limits: of the call; None: those of external policies.
        """
        code = self.parsed.form == "archive" or is_code(self.parsed)  # a folder of an agent is data
        isolated = code or IMPORTED or limits not in (None, CallLimits())
        return run_isolated(function, *arguments, limits=limits) if isolated else function(*arguments)

    @property
    def covered(self) -> set[str]:
        """The files that its key covers, with those of its gains and of the laws that it uses."""
        gains = (str(path.resolve()) for path in (*self.parsed.tuned_files.values(), *self.parsed.gains_files))
        return {*self.files.values(), *gains}.union(*(resolve(law).covered for law in self.uses))

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as plain data; its name is a text."""
        here = {"files", "rows"}  # of this machine, and of a board
        data = {name: value for name, value in asdict(self).items() if name not in here}
        return {**data, "parsed": str(self.parsed)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "PolicySpec":
        """Return the specification that `to_dict` gave.

        Raises:
            ValueError: its kind or access is unknown.
        """
        lists = {name: tuple(data[name]) for name in ("needs", "packages")}
        spec = cls(**{**data, **lists, "parsed": PolicyName.parse(data["parsed"], "a result")})
        check_choice("kind", spec.kind, registry.KINDS)
        check_choice("access", spec.access, ACCESS)
        return spec


def build(name: PolicyName, factory: Callable[..., Any], env: Any, **gains: Any) -> Any:
    """Return the policy of a name and factory for an environment; more gains replace the name's."""
    if name.form == "name":
        return registry.make(name, env, **gains)
    return registry.make(factory, env, **(name.given_gains | gains))


def names() -> tuple[str, ...]:
    """Return the name of every registered policy, then those with tuned gains."""
    return (*registry.names(), *registry.tuned())


#: A policy: its specification, its name, or its text.
PolicyLike: TypeAlias = PolicySpec | PolicyName | str


def resolve(policy: PolicyLike, limits: CallLimits | None = None, *, trust: bool = False) -> PolicySpec:
    """Return the specification of a policy; code from outside fbl-gym is loaded in a fresh process.

    Args:
        policy: its text, name, or specification, which is returned unchanged.
        limits: of that process.
        trust: True allows the code of an archive to run.

    Raises:
        ValueError: no policy has that name, or its file does not exist.
        loading.Untrusted: loading it needs trust; a ValueError where it is a file or module.
    """
    if isinstance(policy, PolicySpec):
        return policy
    if not isinstance(policy, str | PolicyName):
        given = type(policy).__name__
        raise ValueError(f"policy must be a name or a path, got a {given}: save it, and give the file with trust=True")
    name = PolicyName.parse(policy) if isinstance(policy, str) else policy
    name = replace(name, trusted=name.trusted or trust)
    if not is_code(name):
        return _resolved(name)
    try:
        data, files = run_isolated(_resolve_code, name, limits=limits)
    except Failed as problem:
        return PolicySpec(name, external=True, problem=f"{problem}, while it was loaded")
    return replace(PolicySpec.from_dict(data), parsed=name, files=files)


def _resolve_code(name: PolicyName) -> tuple[dict[str, Any], dict[str, str]]:
    spec = _resolved(name)
    return spec.to_dict(), dict(spec.files)


def _resolved(name: PolicyName) -> PolicySpec:
    """Return the specification of a policy, whose code is loaded in this process.

    External code is made once for an example. An error of it is raised again where a cell makes
    it: other policies must not suffer.
    """
    before = set(sys.modules) - IMPORTED
    spec = PolicySpec(name, external=name.form != "name" or is_code(name), shared=key.shared())
    try:
        factory = load(name)
        gains = {gain: np.asarray(value).tolist() for gain, value in name.given_gains.items()}
        spec = replace(spec, gains=gains, **_declared(name, factory))
        uses = [*getattr(factory, "uses", ())]
        if is_code(name) or name.gains:
            with contextlib.suppress(*(() if name.gains else (Exception, SystemExit))):
                uses += getattr(build(name, factory, _example(spec)), "uses", ())
        return replace(spec, **_files(spec, factory, before), uses=_uses(name, uses))
    except BadDeclaration as problem:
        return replace(spec, problem=str(problem))
    except (Exception, SystemExit) as problem:
        if name.gains or isinstance(problem, NotFound) or (isinstance(problem, ValueError) and not is_code(name)):
            raise
        return spec


def _declared(name: PolicyName, factory: Callable[..., Any]) -> dict[str, Any]:
    """Return the fields of a specification that a factory declares, but code and files."""
    known = name if name.form == "name" else factory
    kind = registry.kind(name) if known is name else getattr(factory, "kind", "classical")
    tuning = "given gains" if name.gains else "tuned" if name.tuned else "default gains"
    lists = {what: getattr(factory, what, ()) for what in ("needs", "packages", "data_files", "uses")}
    try:
        registry.check_gains(name, factory)
        for what, given in lists.items():
            if not isinstance(given, list | tuple) or not all(isinstance(item, str | os.PathLike) for item in given):
                raise ValueError(f"{what} of {name} must be a list of text, got {given!r}")
        return {
            "kind": check_choice(f"kind of {name}", kind, registry.KINDS),
            "access": registry.access(known),
            "needs": tuple(lists["needs"]),
            "packages": tuple(lists["packages"]),
            "preview": check_number(f"preview of {name}", getattr(factory, "preview", 0.0), low=0, high=100),
            "tuning": "trained" if kind == "learned" else tuning,
            "summary": registry.summary(name) if known is name else (factory.__doc__ or "").strip().split("\n")[0],
            "tuned": {robot: registry.tuned_gains(name, robot) for robot in name.tuned_files},
        }
    except (ValueError, TypeError) as problem:
        raise BadDeclaration(str(problem)) from problem


def _files(spec: PolicySpec, factory: Any, before: set[str]) -> dict[str, Any]:
    """Return the fields of a specification on code, data files, and installed packages.

    Args:
        spec: without them.
        factory: of the policy.
        before: names of the modules that were there before the factory.
    """
    name, law = spec.parsed, getattr(factory, "_law", factory)
    modules: dict[str, Path] = {}
    packages = dict.fromkeys(spec.packages)
    own = outside_module(name)
    if is_code(name):
        modules, installed = key.loaded_since(before, own.partition(".")[0])
        packages |= dict.fromkeys(sorted(installed))
    bases = {cls.__module__ for cls in getattr(law, "__mro__", (law,)) if cls.__module__ in sys.modules}
    modules |= key.law_modules(sys.modules[module] for module in {*modules, *bases})
    modules = {"" if module.startswith(FILE_MODULE) else module: file for module, file in modules.items()}
    if not modules:
        raise BadDeclaration(f"{name} must be Python code in files, since its key follows them")
    folder = {"file": modules.get(""), "archive": Path(name.source), "folder": Path(name.source, "agent.json")}
    home = Path(folder.get(name.form) or str(sys.modules[own or law.__module__].__file__)).resolve().parent
    data = _data_files(spec, getattr(factory, "data_files", ()), home)
    files = {file: str(path) for file, path in (modules | data).items()}
    return {"code": key.digests(modules), "data": key.digests(data), "files": files, "packages": tuple(packages)}


def _data_files(spec: PolicySpec, patterns: Iterable[str | os.PathLike[str]], home: Path) -> dict[str, Path]:
    """Return the files of the paths, folders and patterns that a policy declares, from home."""
    found: dict[str, Path] = {}
    for pattern in patterns:
        path = home / pattern
        paths = [path] if path.exists() else map(Path, glob(str(path), recursive=True))
        files = (file for path in paths for file in (path.rglob("*") if path.is_dir() else [path]))
        chosen = [file.resolve() for file in files if file.is_file()]
        if not chosen:
            file = os.fspath(pattern)
            raise BadDeclaration(f"data_files of {spec.name} must exist, but there is no file {file!r} in {home}")
        # The files of an agent's training seed lie in a folder of that name.
        of_seed = not spec.external and spec.parsed.seed is not None
        chosen = [file for file in chosen if not of_seed or file.parent.name == str(spec.parsed.seed)]
        found |= {Path(os.path.relpath(file, home)).as_posix(): file for file in chosen}
    return found


def _uses(name: PolicyName, laws: Iterable[str]) -> dict[str, str]:
    """Return a hash of each law that a policy uses, with all that its numbers depend on."""
    digests = {}
    try:
        for law in map(PolicyName.parse, laws):
            if law.form != "name":
                raise unknown("law", str(law), names())
            if law.code != name.code:
                digests[str(law)] = key.data_digest(resolve(law).identity)
    except (ValueError, TypeError) as problem:
        raise BadDeclaration(f"uses of {name} must be a list of names of laws: {problem}") from problem
    return digests


def _example(spec: PolicySpec) -> TwoLinkArmVectorEnv:
    """Return an environment that a policy can be made for; tuned gains are those of a class."""
    scenario = scenarios.get("-".join([*[*spec.tuned][:1], "nominal"]))
    return TwoLinkArmVectorEnv(1, scenario, preview=math.ceil(spec.preview / scenario.control_dt - 1e-9))
