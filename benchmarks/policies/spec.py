"""Policies by name: `resolve` turns text into a `PolicySpec`, which everything else works with.

The text is one of:

- a registered name, such as "cascade-flm", or an entry point `fbl_gym.policies` of an installed
  package;
- "cascade-flm@tuned", with its tuned gains;
- "cascade-flm+kalman+predictor", a law composed with parts, also with "@tuned";
- a law with gains at the end, "cascade-flm@K=30" or "my_law.py@K=30,20@F=10", or with those of a
  file: "pid-flm@my_gains.json", or "pid-flm@my_arm", which is my_arm/pid-flm.json;
- "ppo-memory@2", a shipped agent of one training seed; "ppo-memory" is that with the smallest
  validation error, and on a board all of them (`benchmarks.run.suite.members`);
- "my_module:make_policy", a factory called with the interface, such as a subclass of `TorqueLaw`;
- "path/to/file.py" (its `make_policy`) or "path/to/file.py:attribute";
- "./path/to/run", a folder that `fbl-gym train` wrote;
- "path/to/model.zip", a model saved by stable-baselines3, after `external.trust`, or a folder of
  Hugging Face that holds one.

A registered name wins over a file or folder of the same name.

A file is resolved in the process of its policy (`apart.py`). `external.load` imports it, and the
policy is made once for an example, while `external.watch` collects the files that it reads.
`digest.py` hashes its code with all imports, `configuration.py` returns its gains.
`PolicySpec.make` makes the policy for an environment, unless any of these has changed.
"""

import dataclasses
import hashlib
import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_origin

import controllers
from benchmarks.policies import external
from benchmarks.policies.apart import Failed, call_apart
from benchmarks.policies.configuration import Inexact, configuration, gains_file, read_gains
from benchmarks.policies.digest import closure, code_digest, file_of
from benchmarks.rl.agent import access_of, needs_of, saved_agent
from benchmarks.rl.policy import shipped
from benchmarks.rl.sb3 import MOTION, load_zip
from controllers.policy import ACCESS
from controllers.registry import KINDS, is_composed
from fbl_gym import scenarios
from fbl_gym.checks import check_choice, unknown
from fbl_gym.interface import Interface
from fbl_gym.vector_env import TwoLinkArmVectorEnv

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
        name: the text that names the policy.
        kind: "classical" or "learned".
        access: what the policy may know: "none", "nominal" or "privileged".
        needs: the sensors that it cannot do without.
        preview: how far ahead it sees the reference [s].
        tuning: "default gains", "given gains", "tuned" or "trained".
        external: True if it is not part of fbl-gym.
        summary: one line.
        digest: hash of the code that its results depend on, and of its weights.
        data: hash of each data file that is read to make it, by the file's path.
        configuration: its gains as exact plain data.
        problem: error of its declaration, for which no result can be stored; empty: none.
        trusted: True if it is an archive that may be loaded, see `external.trust`.
        rows: names of the rows of a board that it is a member of; empty: its own name.
    """

    name: str
    kind: str
    access: str
    needs: tuple[str, ...] = ()
    preview: float = 0.0
    tuning: str = "default gains"
    external: bool = False
    summary: str = ""
    digest: str = ""
    data: Mapping[str, str] = field(default_factory=dict, hash=False)
    configuration: Mapping[str, Any] = field(default_factory=dict, hash=False)
    problem: str = ""
    trusted: bool = False
    rows: tuple[str, ...] = field(default=(), compare=False)

    @property
    def code(self) -> str:
        """The name without the gains at its end."""
        return external.split_gains(self.name)[0]

    @property
    def gains(self) -> dict[str, Any]:
        """The gains at the end of the name, by name; files are read."""
        return read_gains(*external.split_gains(self.name))

    @property
    def ranked(self) -> bool:
        """True if the board ranks the policy: it does not know the truth."""
        return self.access != "privileged"

    @property
    def any_action(self) -> bool:
        """True if the policy works with each kind of action; an archive only has one."""
        return _form(self.name) != "archive"

    @property
    def identity(self) -> dict[str, Any]:
        """All that distinguishes this policy from others, but not the place of an external one."""
        attribute = external.split(self.name)[1]
        return {
            "policy": self.code if _form(self.name) == "name" else f"external:{attribute}",
            "access": self.access,
            "code": self.digest,
            "data": sorted(self.data.values()),
            "configuration": dict(self.configuration),
        }

    def make(self, env: Any, **gains: Any) -> Any:
        """Return the policy for an environment, wrapped or not, or for its `interface`.

        Raises:
            Changed: the policy in this process is not the one that was resolved.
        """
        self.check()
        if gains:
            self.factory()  # refuses them, if there are none
        return _make(self.code, env, {**self.gains, **gains})

    def check(self, reads: Iterable[Path] = ()) -> None:
        """Raise `Changed` unless this process has the same code, gains and data.

        `reads` are the files that were read since, from `external.watch`.
        """
        if self.trusted:
            external.trust(self.name)
        now = resolve(self.name).identity
        if now != self.identity:
            parts = [part for part in now if now[part] != self.identity[part]]
            raise Changed(f"the {' and '.join(parts)} of {self.name} changed since it was resolved; run it again")
        if not self.external or external.weights(self.name):
            return
        for path in sorted(external.data_files(set(reads), external.sources(self.name))):
            if str(path) not in self.data:
                raise Changed(
                    f"{self.name} reads {path} after it was made, so its key does not notice a change of that file: "
                    "read it when the policy is made, or list it in the factory's attribute `data_files`"
                )
            if external.file_digest(path) != self.data[str(path)]:
                raise Changed(f"{path}, which {self.name} reads, changed since it was resolved; run it again")

    def factory(self) -> Callable[..., Any]:
        """Return the class or function that makes the policy from the interface and gains."""
        if external.weights(self.name):
            raise ValueError(f"gains must be those of a law, got {self.name}, which was trained and has none")
        return _factory(self.code)

    def to_dict(self) -> dict[str, Any]:
        """Return the specification as plain data."""
        plain = {**dataclasses.asdict(self), "needs": list(self.needs)}
        del plain["trusted"], plain["rows"]
        return plain

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "PolicySpec":
        """Return the specification that `to_dict` gave.

        Raises:
            ValueError: a value has another type.
        """
        spec = cls(**{**data, "needs": tuple(map(str, data["needs"]))})
        for each in dataclasses.fields(cls):
            value, right = getattr(spec, each.name), get_origin(each.type) or each.type
            if not isinstance(value, right):  # type: ignore[arg-type]
                raise ValueError(f"{each.name} of a policy must be a {right.__name__}, got {value!r}")  # type: ignore[union-attr]
        check_choice("kind", spec.kind, KINDS)
        check_choice("access", spec.access, ACCESS)
        return spec


def names() -> tuple[str, ...]:
    """Return the name of every registered policy, then those with tuned gains."""
    return (*controllers.names(), *controllers.tuned())


_RESOLVED: dict[str, tuple[PolicySpec, str]] = {}
"""Each policy that this process has resolved, with the state of its files then."""


def resolve(policy: str | PolicySpec) -> PolicySpec:
    """Return the specification of a policy, once for each policy and process.

    A file is resolved again when it has changed. A module keeps the state in which this process
    imported it. A specification is returned unchanged.

    Raises:
        ValueError: no policy has that name, or its file does not exist.
        external.Untrusted: loading it needs `external.trust`.
    """
    if isinstance(policy, PolicySpec):
        return policy
    _check(policy)
    state = _state(policy)
    if policy not in _RESOLVED or _RESOLVED[policy][1] != state:
        make = _with_gains if external.split_gains(policy)[1] else _trained if external.weights(policy) else _coded
        spec = make(policy)
        _RESOLVED[policy] = spec, _state(policy, spec)
    return _RESOLVED[policy][0]


def _with_gains(text: str) -> PolicySpec:
    """Return the specification of a law with the gains at the end of its text."""
    code, given = external.split_gains(text)
    spec = resolve(code)
    paths = [gains_file(code, each).resolve() for each in given if "=" not in each]
    data = {**spec.data, **{str(path): external.file_digest(path) for path in paths}}
    spec = dataclasses.replace(spec, name=text, tuning="given gains", data=data)
    if spec.problem:
        return spec
    spec.factory()  # refuses gains, if the policy has none
    return dataclasses.replace(spec, configuration=configuration(_make(spec.code, _example(spec), spec.gains)))


def resolve_apart(text: str) -> PolicySpec:
    """Return the specification of a policy; code of an external one runs in its own process."""
    _check(text)
    code = external.split_gains(text)[0]
    if not (external.entry_module(code) if _form(text) == "name" else not external.weights(text)):
        return resolve(text)
    try:
        spec: PolicySpec = call_apart(text, "benchmarks.policies.spec:resolve", text)
        return spec
    except Failed as problem:
        return PolicySpec(text, "classical", "nominal", external=True, problem=f"{problem}, while it was loaded")


def is_unchanged(spec: PolicySpec) -> bool:
    """Return True if a policy still has the code, gains and data of a specification.

    No code of a file is run.
    """
    try:
        if _form(spec.name) in ("file", "module"):
            data = {path: external.file_digest(Path(path)) for path in spec.data}
            return _digest(external.sources(spec.name)) == spec.digest and data == spec.data
        now = _trained(spec.name) if external.weights(spec.name) else resolve_apart(spec.name)
    except (ValueError, OSError):
        return False
    return now.identity == spec.identity


def _form(text: str) -> str:
    """Return "name" for a registered policy and for unknown text, else `external.form_of`."""
    text = external.split_gains(text)[0]
    return "name" if _with_seed(text)[0] in names() or is_composed(text) else external.form_of(text)


def _with_seed(text: str) -> tuple[str, dict[str, int]]:
    """Return a policy's name and, of "ppo-memory@2", its training seed as an argument."""
    name, _, seed = text.rpartition("@")
    return (name, {"seed": int(seed)}) if seed.isdigit() and name in shipped() else (text, {})


def _check(text: str) -> None:
    code, gains = external.split_gains(text)
    if _form(code) != "name":
        external.check(code)
        return
    if any(folder.isidentifier() and not Path(folder).is_dir() for folder in gains):  # a misspelt "tuned", rather
        raise unknown("policy", text, names())
    if is_composed(code):
        controllers.factory(code)  # refuses parts that do not fit
    elif _with_seed(code)[0] not in names():
        if (Path(code) / "agent.json").is_file():
            raise ValueError(f"unknown policy {code!r}; the folder of that name is named by its path, ./{code}")
        raise unknown("policy", code, names())


def _state(text: str, spec: PolicySpec | None = None) -> str:
    """Return a hash of the files of an external policy that may change while a process runs."""
    if _form(text) not in ("file", "archive", "agent") and not external.split_gains(text)[1]:
        return ""
    spec = spec or _RESOLVED.get(text, (None, ""))[0]
    files = {*map(Path, spec.data if spec else ())}
    if _form(text) != "name":
        files |= {*external.sources(text).values(), *external.weights(text)}
    digests = [str(Path.cwd()), *(external.file_digest(path) for path in sorted(files))]
    return hashlib.sha256("".join(digests).encode(errors="surrogateescape")).hexdigest()


def _trained(text: str) -> PolicySpec:
    """Return the specification of an archive or a folder of an agent."""
    archive = _form(text) == "archive"
    digests = [external.file_digest(path) for path in external.weights(text)]
    modules = _files((load_zip if archive else saved_agent).__module__)
    access, needs = ("nominal", MOTION) if archive else (access_of(Path(text)), needs_of(Path(text)))
    return PolicySpec(
        text, "learned", access, needs=needs, tuning="trained", external=True,
        digest=_digest(modules, hashlib.sha256("".join(digests).encode()).hexdigest()), trusted=archive,
    )  # fmt: skip


def _coded(text: str) -> PolicySpec:
    """Return the specification of a policy that is code, from the policy made for an example."""
    if _form(text) == "file" and text in _RESOLVED:
        external.forget(Path(external.split(text)[0]))
    is_external = _form(text) != "name" or external.entry_module(_with_seed(text)[0]) != ""
    spec = PolicySpec(text, "classical", "nominal", external=is_external)
    modules: dict[str, Path] = {}
    reads: set[Path] = set()
    try:
        with external.watch() as reads:
            modules = external.sources(text) if is_external else {}
            factory = _factory(text)
            modules = external.sources(text) if is_external else {}
            if is_external and not modules:
                raise BadDeclaration(f"{text} must be Python code in files, since its key follows them")
            modules = modules or _files(getattr(factory, "law", factory).__module__)
            spec = _declared(spec, factory)
            spec = dataclasses.replace(spec, configuration=configuration(_make(text, _example(spec), {})))
    except external.NotFound:
        raise
    except (BadDeclaration, Inexact) as problem:
        spec = dataclasses.replace(spec, problem=str(problem))
    except (Exception, SystemExit):
        pass  # an error of the policy: making it for a cell raises it again, and other policies must not suffer
    data = external.data_files(reads, modules) if is_external else set()
    first = next(iter(modules.values()), Path())
    data |= {(first.parent / file).resolve() for file in spec.data}
    return dataclasses.replace(
        spec, digest=_digest(modules), data={str(path): external.file_digest(path) for path in sorted(data)}
    )


def _declared(spec: PolicySpec, factory: Callable[..., Any]) -> PolicySpec:
    """Return the specification with all that a factory declares; its data files by name alone."""
    name = _with_seed(spec.name)[0] if _form(spec.name) == "name" else ""
    kind = controllers.kind(name) if name else getattr(factory, "kind", "classical")
    tuning, files = "tuned" if spec.name.endswith("@tuned") else "default gains", getattr(factory, "data_files", ())
    try:
        if isinstance(files, str) or not all(isinstance(file, str | os.PathLike) for file in files):
            raise ValueError(f"data_files of {spec.name} must be a list of paths, got {files!r}")
        return dataclasses.replace(
            spec,
            kind=check_choice(f"kind of {spec.name}", kind, KINDS),
            access=controllers.access(name or factory),
            needs=tuple(getattr(factory, "needs", ())),
            preview=float(getattr(factory, "preview", 0.0)),
            tuning="trained" if kind == "learned" else tuning,
            summary=controllers.summary(name) if name else (factory.__doc__ or "").strip().partition("\n")[0],
            data={os.fspath(file): "" for file in files},
        )
    except (ValueError, TypeError) as problem:
        raise BadDeclaration(str(problem)) from problem


def _factory(text: str) -> Callable[..., Any]:
    return controllers.factory(_with_seed(text)[0]) if _form(text) == "name" else external.load(text)


def _make(text: str, env: Any, gains: Mapping[str, Any]) -> Any:
    match _form(text):
        case "name":
            name, seed = _with_seed(text)
            return controllers.make(name, env, **{**seed, **gains})
        case "archive":
            return load_zip(
                external.archive(text), env if isinstance(env, Interface) else env.unwrapped.interface, trust=True
            )
        case "agent":
            return saved_agent(env, text)
        case _:
            return controllers.make(external.load(text), env, **gains)


def _example(spec: PolicySpec) -> TwoLinkArmVectorEnv:
    """Return an environment that a policy can be made for."""
    scenario = scenarios.get("nominal")
    return TwoLinkArmVectorEnv(1, scenario, preview=math.ceil(spec.preview / scenario.control_dt - 1e-9))


def _files(*modules: str) -> dict[str, Path]:
    files = {module: file_of(module) for module in modules}
    return {module: file for module, file in files.items() if file is not None}


def _digest(modules: Mapping[str, Path], weights: str = "") -> str:
    """Return a hash of a policy's code with its imports, and of the code behind every result."""
    code = code_digest(closure({**_files(*RESULTS), **modules}))
    return hashlib.sha256(f"{code} {weights}".encode()).hexdigest()
