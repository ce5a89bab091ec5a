"""Policies by name: `resolve` turns a name into a `PolicySpec`, which everything else works with.

The text that names a policy is parsed once, into a `PolicyName` (`name.py`). A file is resolved in
a process of its own (`isolation.py`). `external.load` imports it, and the policy is made once for
an example. `digest.py` hashes its code with all imports. A policy declares in class attributes what
else it depends on: the laws that it uses by name in `uses`, and the files that it reads in
`data_files`. `PolicySpec.make` makes the policy for an
environment, unless any of these has changed.
"""

import dataclasses
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import controllers
from benchmarks.agents.agent import describe, files, saved_agent, settings_of
from benchmarks.agents.sb3 import MOTION, load_zip
from benchmarks.policies import external
from benchmarks.policies.digest import closure, code_digest, data_digest, file_of
from benchmarks.policies.isolation import Answer, CallLimits, Failed, run_isolated
from benchmarks.policies.name import PolicyName
from controllers.base import ACCESS
from controllers.gains import TUNINGS
from controllers.registry import KINDS, is_composed
from fbl_gym import scenarios
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.interface import Interface
from fbl_gym.records.checks import check_choice, check_number, unknown

RESULTS = ("benchmarks.run.metrics", "benchmarks.run.rollout", "controllers.composition")
"""Modules that every result depends on, the kernel among what they import.

Any law is composed where a sensor that it needs is absent."""


class BadDeclaration(ValueError):
    """A policy's factory declares something that is not allowed."""


class Changed(ValueError):
    """A policy's code, gains or data are not those of its specification."""


@dataclass(frozen=True)
class PolicySpec:
    """A policy that has been resolved: plain data that any process can make the same policy from.

    Args:
        parsed: its name.
        kind: "classical" or "learned".
        access: what the policy may know: "none", "nominal" or "privileged".
        needs: the sensors that it cannot do without.
        preview: how far ahead it sees the reference [s].
        tuning: "default gains", "given gains", "tuned" or "trained".
        external: False for a policy of fbl-gym.
        summary: one line.
        digest: hash of its code with all that it imports, and of the code behind every result.
        uses: hash of each law that it uses, by the law's name.
        data: hash of each of its data files, by the name relative to its code.
        packages: those of extras that it computes with.
        gains: those that its name gives, as plain data.
        problem: error of its declaration, for which no result can be stored; empty: none.
        trusted: True if it is an archive that may be loaded, see `external.trust`.
        rows: names of the rows of a board that it is a member of; empty: its own name.
    """

    parsed: PolicyName
    kind: str
    access: str
    needs: tuple[str, ...] = ()
    preview: float = 0.0
    tuning: str = "default gains"
    external: bool = False
    summary: str = ""
    digest: str = ""
    uses: Mapping[str, str] = field(default_factory=dict, hash=False)
    data: Mapping[str, str] = field(default_factory=dict, hash=False)
    packages: tuple[str, ...] = ()
    gains: Mapping[str, Any] = field(default_factory=dict, hash=False)
    problem: str = ""
    trusted: bool = False
    rows: tuple[str, ...] = field(default=(), compare=False)

    @property
    def name(self) -> str:
        """The text that names the policy."""
        return self.parsed.text

    @property
    def ranked(self) -> bool:
        """True if the board ranks the policy: it does not know the truth."""
        return self.access != "privileged"

    @property
    def identity(self) -> dict[str, Any]:
        """All that distinguishes this policy from others, but not the place of an external one."""
        name = self.parsed
        return {
            "policy": name.code.text if name.form == "name" else f"external:{'+'.join((name.attribute, *name.parts))}",
            "access": self.access,
            "code": self.digest,
            "uses": dict(self.uses),
            "data": dict(self.data),
            "gains": dict(self.gains),
        }

    def make(self, env: Any, **gains: Any) -> Any:
        """Return the policy for an environment, wrapped or not, or for its `interface`.

        Raises:
            Changed: the policy in this process is not the one that was resolved.
        """
        self.check()
        if gains:
            self.factory()  # refuses them, if there are none
        return _make(self.parsed, env, {**self.parsed.given_gains, **gains})

    def check(self) -> None:
        """Raise `Changed` unless this process has the same code, gains and data."""
        if self.trusted:
            external.trust(self.parsed)
        now = resolve(self.parsed).identity
        if now != self.identity:
            parts = [part for part in now if now[part] != self.identity[part]]
            raise Changed(f"the {' and '.join(parts)} of {self.name} changed since it was resolved; run it again")

    def call(self, function: Callable[..., Answer], *arguments: Any, limits: CallLimits | None = None) -> Answer:
        """Call a function that makes the policy; in a fresh process, if external code may run.

        Args:
            function: as for `run_isolated`.
            *arguments: of the function.
            limits: of the call; None: those of external policies.
        """
        runs_code = self.external and self.parsed.form != "agent"  # an agent in a folder is data
        isolated = runs_code or external.LOADED or limits not in (None, CallLimits())
        return run_isolated(function, *arguments, limits=limits) if isolated else function(*arguments)

    def factory(self) -> Callable[..., Any]:
        """Return the class or function that makes the policy from the interface and gains."""
        if self.parsed.form in ("agent", "archive"):
            raise ValueError(f"gains must be those of a law, got {self.name}, which was trained and has none")
        return _factory(self.parsed)

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as plain data."""
        return {name: value for name, value in dataclasses.asdict(self).items() if name not in ("trusted", "rows")}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "PolicySpec":
        """Return the specification that `to_dict` gave.

        Raises:
            ValueError: its kind or access is unknown.
        """
        lists = {name: tuple(data[name]) for name in ("needs", "packages")}
        given = {**data, **lists, "parsed": PolicyName.from_dict(data["parsed"])}
        spec = cls(**{field.name: given[field.name] for field in dataclasses.fields(cls) if field.name in given})
        check_choice("kind", spec.kind, KINDS)
        check_choice("access", spec.access, ACCESS)
        return spec


def names() -> tuple[str, ...]:
    """Return the name of every registered policy, then those with tuned gains."""
    return (*controllers.names(), *controllers.tuned())


_RESOLVED: dict[PolicyName, PolicySpec] = {}
"""Each built-in policy that this process has resolved."""


def resolve(policy: str | PolicyName | PolicySpec) -> PolicySpec:
    """Return the specification of a policy; of a built-in one, once for each process.

    A module keeps the state in which this process imported it. A specification is returned
    unchanged.

    Raises:
        ValueError: no policy has that name, or its file does not exist.
        external.Untrusted: loading it needs `external.trust`.
    """
    if isinstance(policy, PolicySpec):
        return policy
    name = PolicyName.parse(policy) if isinstance(policy, str) else policy
    if name in _RESOLVED:
        return _RESOLVED[name]
    _check(name)
    spec = _trained(name) if name.form in ("agent", "archive") else _coded(name)
    if not spec.external and not name.gains:
        _RESOLVED[name] = spec
    return spec


def resolve_isolated(policy: str | PolicyName | PolicySpec, limits: CallLimits | None = None) -> PolicySpec:
    """Return the specification of a policy; code of an external one runs in a fresh process."""
    if isinstance(policy, PolicySpec):
        return policy
    name = PolicyName.parse(policy) if isinstance(policy, str) else policy
    _check(name)
    if name.form not in ("file", "module") and not external.entry_module(name):
        return resolve(name)
    try:
        return PolicySpec.from_dict(run_isolated(_resolve, name, limits=limits))
    except Failed as problem:
        return PolicySpec(name, "classical", "nominal", external=True, problem=f"{problem}, while it was loaded")


def _resolve(name: PolicyName) -> dict[str, Any]:
    return resolve(name).to_dict()


def _check(name: PolicyName) -> None:
    """Refuse a name that means no policy, and an archive that may not be loaded."""
    law, _, tuning = name.text.rpartition("@")
    if tuning in TUNINGS and PolicyName.parse(law).form in ("file", "module"):
        search = f"`fbl-gym tune {law} --class CLASS`"
        raise ValueError(f"{law} has no gains that come with fbl-gym: {search} finds some, for {law}@results/gains")
    if name.form != "name":
        external.check(name)
        return
    if any(gain.isidentifier() and not Path(gain).is_dir() for gain in name.gains):  # a misspelt "tuned", rather
        raise unknown("policy", name.text, names())
    code = name.code.text
    if name.tuned:
        controllers.registry.tuned_gains(name.registered)  # refuses those that there are not
    if is_composed(code):
        controllers.factory(code)  # refuses parts that do not fit
    elif name.source not in names() or (name.seed is None and code != name.registered):
        if (Path(code) / "agent.json").is_file():
            raise ValueError(f"unknown policy {code!r}; the folder of that name is named by its path, ./{code}")
        if "/" in code or os.sep in code:
            raise ValueError(f"policy must be a name, an existing file, or a folder with an agent.json, got {code!r}")
        raise unknown("policy", code, names())


def _gains_digest(path: Path) -> str:
    """Return a hash of the gains of a file, without how they were found."""
    data = json.loads(path.read_bytes())
    return data_digest(data.get("gains", data))


def _trained(name: PolicyName) -> PolicySpec:
    """Return the specification of an archive or a folder of an agent."""
    given: dict[str, Any]
    if name.form == "archive":
        modules, data = _files(load_zip.__module__), {"model.zip": external.file_digest(Path(name.source))}
        given = {"access": "nominal", "needs": MOTION, "packages": ("torch",), "trusted": True}
    else:
        folder = Path(name.source)
        settings, modules = settings_of(folder), _files(saved_agent.__module__)
        description, weights = files(folder)
        numbers = {part: describe(folder)[part] for part in ("interface", "network")}
        data = {description.name: data_digest(numbers), weights.name: external.file_digest(weights)}
        uses = {law: _used(law) for law in settings.uses}
        given = {"access": "nominal", "needs": settings.sensors, "preview": settings.preview, "uses": uses}
    given |= {"digest": _digest(modules), "data": data}
    return PolicySpec(name, "learned", tuning="trained", external=True, **given)


def _coded(name: PolicyName) -> PolicySpec:
    """Return the specification of a policy that is code, from the policy made for an example."""
    is_external = name.form != "name" or external.entry_module(name) != ""
    spec, gains = PolicySpec(name, "classical", "nominal", external=is_external), name.given_gains
    modules = external.sources(name) if is_external else {}
    try:
        factory = _factory(name)
        modules = external.sources(name) if is_external else _files(getattr(factory, "_law", factory).__module__)
        if not modules:
            raise BadDeclaration(f"{name.text} must be Python code in files, since its key follows them")
        spec = _declared(spec, factory, next(iter(modules.values())).parent)
        policy = _make(name, _example(spec), gains)
        plain = {gain: np.asarray(value).tolist() for gain, value in gains.items()}
        spec = dataclasses.replace(spec, uses={**spec.uses, **_uses(name, policy)}, gains=plain)
    except external.NotFound:
        raise
    except BadDeclaration as problem:
        spec = dataclasses.replace(spec, problem=str(problem))
    except (Exception, SystemExit):
        if gains:
            raise
        # Making it for a cell raises the error again, and other policies must not suffer.
    return dataclasses.replace(spec, digest=_digest(modules))


def _declared(spec: PolicySpec, factory: Callable[..., Any], folder: Path) -> PolicySpec:
    """Return the specification with all that a factory declares; its code is in the folder."""
    parsed, name = spec.parsed, spec.parsed.registered
    kind = controllers.kind(name) if name else getattr(factory, "kind", "classical")
    lists = {what: getattr(factory, what, ()) for what in ("needs", "packages", "data_files")}
    try:
        for what, given in lists.items():
            if isinstance(given, str) or not all(isinstance(item, str | os.PathLike) for item in given):
                raise ValueError(f"{what} of {spec.name} must be a list of text, got {given!r}")
        # The files of an agent's training seed lie in a folder of that name.
        own = (x for x in lists["data_files"] if parsed.seed is None or Path(x).parent.name == str(parsed.seed))
        files = {os.path.relpath(folder / file, folder): (folder / file).resolve() for file in own}
        data = {name: external.file_digest(path) for name, path in files.items()}
        data |= {f"gains {i}: {path.name}": _gains_digest(path) for i, path in enumerate(parsed.gains_files)}
        data |= {f"gains of {robot}": _gains_digest(path) for robot, path in parsed.tuned_files.items()}
        tuning = "tuned" if parsed.tuned else "default gains"
        return dataclasses.replace(
            spec,
            kind=check_choice(f"kind of {spec.name}", kind, KINDS),
            access=controllers.access(name or factory),
            needs=tuple(lists["needs"]),
            packages=tuple(lists["packages"]),
            preview=check_number(f"preview of {spec.name}", getattr(factory, "preview", 0.0), low=0, high=100),
            tuning="trained" if kind == "learned" else "given gains" if parsed.gains else tuning,
            summary=controllers.summary(name) if name else (factory.__doc__ or "").strip().partition("\n")[0],
            uses=_uses(parsed, factory),
            data=data,
        )
    except (ValueError, TypeError) as problem:
        raise BadDeclaration(str(problem)) from problem


def _uses(name: PolicyName, declares: Any) -> dict[str, str]:
    """Return a hash of each law that a factory or a policy lists in `uses`."""
    try:
        return {law: _used(law) for law in getattr(declares, "uses", ()) if law != name.code.text}
    except (ValueError, TypeError) as problem:
        raise BadDeclaration(f"uses of {name.text} must be a list of names of laws: {problem}") from problem


def _used(law: str) -> str:
    """Return a hash of a registered law, with all that its numbers depend on."""
    if PolicyName.parse(law).form != "name":
        raise unknown("law", law, names())
    return data_digest(resolve(law).identity)


def _factory(name: PolicyName) -> Callable[..., Any]:
    return controllers.factory(name.registered) if name.form == "name" else external.load(name)


def _make(name: PolicyName, env: Any, gains: Mapping[str, Any]) -> Any:
    match name.form:
        case "name":
            return controllers.make(name.registered, env, **({} if name.seed is None else {"seed": name.seed}), **gains)
        case "archive":
            interface = env if isinstance(env, Interface) else env.unwrapped.interface
            return load_zip(name.source, interface, trust=True)
        case "agent":
            return saved_agent(env, name.source)
        case _:
            return controllers.make(external.load(name), env, **gains)


def _example(spec: PolicySpec) -> TwoLinkArmVectorEnv:
    """Return an environment that a policy can be made for; tuned gains are those of a class."""
    scenario = scenarios.get("-".join([*[*spec.parsed.tuned_files][:1], "nominal"]))
    return TwoLinkArmVectorEnv(1, scenario, preview=math.ceil(spec.preview / scenario.control_dt - 1e-9))


def _files(*modules: str) -> dict[str, Path]:
    files = {module: file_of(module) for module in modules}
    return {module: file for module, file in files.items() if file is not None}


def _digest(modules: Mapping[str, Path]) -> str:
    """Return a hash of a policy's code with its imports, and of the code behind every result."""
    return code_digest(closure({**_files(*RESULTS), **modules}))
