"""Where policies come from: the registry, a tuned study, a stranger's module or file, an SB3 archive.

A policy is named by text, which workers on other machines can resolve again:

- a registered name, such as "cascade-flm", or an entry point `fbl_gym.policies` of an installed package;
- "ppo-memory@3", a shipped agent of one training seed;
- "my_module:make_policy", a factory called with the interface, such as a subclass of `TorqueLaw`;
- "path/to/file.py" (its `make_policy`) or "path/to/file.py:attribute";
- "path/to/run", a folder that `fbl-gym train` wrote;
- "path/to/model.zip", a model saved by stable-baselines3, after `trust` has let it in.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import controllers
from benchmarks.rl.agent_folder import access_of, saved_agent
from benchmarks.rl.policy import shipped
from benchmarks.rl.sb3 import load_zip
from controllers.registry import ENTRY_POINTS
from fbl_gym.checks import unknown
from fbl_gym.interface import Interface

ATTRIBUTE = "make_policy"
"""What a file is asked for where no attribute is named."""


OWN = ("benchmarks", "controllers", "fbl_gym")
"""The packages of fbl-gym. What changes in them is told by the version of the results, which is raised by hand."""


class Untrusted(ValueError):
    """A file whose loading runs code, and that nobody has vouched for."""


_TRUSTED: set[str] = set()


def trust(path: str) -> None:
    """Let an archive be loaded, which runs whatever code it holds.  path: of the archive."""
    _TRUSTED.add(str(Path(path).resolve()))


def names() -> tuple[str, ...]:
    """Every policy that needs no file: the package's own, those of installed packages, and those with tuned gains."""
    return (*controllers.names(), *controllers.tuned())


def learned(policy: str) -> bool:
    """Whether a policy was trained, not designed.  policy: text that names it."""
    name = _registered(policy)
    return policy.endswith(".zip") or _is_run(policy) or (name != "" and controllers.kind(name) == "learned")


def access(policy: str) -> str:
    """What a policy is told of the arm: "none", "nominal" or "privileged".  policy: text that names it."""
    if name := _registered(policy):
        return controllers.access(name)
    if _is_run(policy):
        return access_of(Path(policy))
    return "nominal" if learned(policy) else controllers.access(_attribute(policy))


def factory(policy: str) -> Callable[..., Any]:
    """What makes a policy: a class or a function, called with the interface and gains.  policy: text that names it."""
    check(policy)
    if policy.endswith(".zip") or _is_run(policy):
        raise ValueError(f"gains must be those of a law, got {policy}, which was trained and has none")
    return _attribute(policy) if ":" in policy or _is_file(policy) else controllers.factory(_with_seed(policy)[0])


def sensors(policy: str) -> str:
    """The sensors that a policy cannot do without, such as "position, velocity"; empty: unsaid.  policy: text that names it."""
    factory = controllers.factory(name) if (name := _registered(policy)) else None
    return ", ".join(getattr(factory, "needs", ()))


def preview(policy: str) -> float:
    """How far ahead a policy would see the reference [s].  policy: text that names it."""
    factory = controllers.factory(name) if (name := _registered(policy)) else None
    return float(getattr(factory, "preview", 0.0))


def tuning(policy: str) -> str:
    """Whether a policy's gains are "tuned", "default gains" or "trained".  policy: text that names it."""
    if learned(policy):
        return "trained"
    return "tuned" if policy.endswith("@tuned") else "default gains"


def own(policy: str) -> bool:
    """Whether a policy is one that fbl-gym comes with.  policy: text that names it."""
    return _registered(policy) != "" and not sources(policy)


def _registered(policy: str) -> str:
    """The name under which a policy is registered; empty: it is not."""
    name, _ = _with_seed(policy)
    return name if name in names() else ""


def _with_seed(policy: str) -> tuple[str, dict[str, int]]:
    """A policy's name and, of "ppo-memory@3", its training seed as an argument."""
    name, _, seed = policy.rpartition("@")
    return (name, {"seed": int(seed)}) if name in shipped() and seed.isdigit() else (policy, {})


def _is_run(policy: str) -> bool:
    """Whether it is the folder of a trained agent."""
    return (Path(policy) / "agent.json").is_file()


def foreign(policy: str) -> bool:
    """Whether a policy is named by where it lies, so that its name says nothing of what it is.  policy: text that names it."""
    return ":" in policy or _is_file(policy) or _is_run(policy)


def _is_file(policy: str) -> bool:
    return policy.partition(":")[0].endswith((".py", ".zip"))


def check(policy: str) -> None:
    """An error that names what is wrong, if a policy cannot be found.  policy: text that names it."""
    if _is_file(policy):
        path = Path(policy.partition(":")[0])
        if not path.is_file():
            raise ValueError(f"there is no file {path}, of which a policy was to be made")
        if path.suffix == ".zip" and str(path.resolve()) not in _TRUSTED:
            raise Untrusted(f"loading {path} runs whatever code it holds; give --trust if you know where it comes from")
    elif ":" in policy:
        _attribute(policy)
    elif not _is_run(policy) and not _registered(policy):
        raise unknown("policy", policy, names())


def make(policy: str, env: Any, **gains: Any) -> Any:
    """The policy for an environment, or for its interface.

    Args:
        policy: see this file's head.
        env: as for `controllers.make`.
        **gains: arguments of the policy.
    """
    check(policy)
    interface = env if isinstance(env, Interface) else env.unwrapped.interface
    if gains:
        factory(policy)  # says so, if it has none
    if policy.endswith(".zip"):
        return load_zip(Path(policy), interface, trust=True)
    if _is_run(policy):
        return saved_agent(env, policy)
    if ":" in policy or _is_file(policy):
        return controllers.make(_attribute(policy), env, **gains)
    name, seed = _with_seed(policy)
    return controllers.make(name, env, **(seed | gains))


def _attribute(policy: str) -> Callable[..., Any]:
    source, _, name = policy.partition(":")
    module = _from_file(Path(source)) if source.endswith(".py") else _named(source)
    name = name or ATTRIBUTE
    if not callable(getattr(module, name, None)):
        public = [n for n in vars(module) if callable(getattr(module, n)) and not n.startswith("_")]
        raise unknown(f"factory of {source}", name, public)
    factory: Callable[..., Any] = getattr(module, name)
    return factory


def _named(source: str) -> ModuleType:
    """A module by its name, installed or in the current folder."""
    if not all(part.isidentifier() for part in source.split(".")):
        raise ValueError(f"the module of a policy must be named as in an import, such as my_laws.pd, got {source!r}")
    try:
        with _importing_from(Path.cwd()):
            return importlib.import_module(source)
    except ModuleNotFoundError as problem:
        if not f"{source}.".startswith(f"{problem.name}."):
            raise
        raise ValueError(
            f"there is no module {source}, installed or in {Path.cwd()}, of which a policy was to be made"
        ) from None


@contextlib.contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    """Find modules in a folder, before all others, for as long as this lasts."""
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def _from_file(path: Path) -> ModuleType:
    path = path.resolve()
    name = f"fbl_gym_joined_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        # Another file's `import helper` meant the module beside that file.
        hidden = {n: sys.modules.pop(n) for n, file in _beside(path).items() if _is_other(sys.modules.get(n), file)}
        try:
            with _importing_from(path.parent):
                spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
        finally:
            sys.modules.update(hidden)
    return sys.modules[name]


def _is_other(module: ModuleType | None, file: Path) -> bool:
    return module is not None and getattr(module, "__file__", None) != str(file)


def configuration(policy: str, made: Any) -> dict[str, Any]:
    """What tells one configuration of a policy from another, as plain data: its gains, and the code or weights behind it.

    Args:
        policy: see this file's head.
        made: the policy that `make` made of it; one that is no dataclass may have an attribute `configuration`.
    """
    own = getattr(made, "configuration", None)
    if isinstance(own, dict):
        found: dict[str, Any] = dict(own)
    elif dataclasses.is_dataclass(made):
        found = {f.name: getattr(made, f.name) for f in dataclasses.fields(made)}
        found = {name: value for name, value in found.items() if name not in ("interface", "env")}
    else:
        found = {}
    if code := digest(policy):
        found["source"] = code
    return found


def digest(policy: str) -> str:
    """A hash of the code of a stranger's policy; empty: it is part of fbl-gym.  policy: see this file's head."""
    files = sources(policy)
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest() if files else ""


def sources(policy: str) -> list[Path]:
    """The files that a stranger's policy comes from, its own first; of a policy that is part of fbl-gym, at most its own.

    Of an entry point, and of a module in a package, that is the whole package; of a file or a single module, what it imports
    of its own folder too; of an archive, the archive.

    policy: see this file's head.
    """
    if _is_file(policy):
        path = Path(policy.partition(":")[0]).resolve()
        return [path] if path.suffix == ".zip" else [path, *sorted(_beside(path).values())]
    entry = "" if ":" in policy else _entry_module(policy)
    name = entry or policy.partition(":")[0]
    if not entry and ":" not in policy:
        return []
    module, top = _named(name), _named(name.partition(".")[0])
    if top.__name__ not in OWN and hasattr(top, "__path__"):
        return sorted({file for folder in top.__path__ for file in Path(folder).rglob("*.py")})
    if getattr(module, "__file__", None) is None:
        return []
    path = Path(str(module.__file__))
    installed = path.parent.name in ("site-packages", "dist-packages")
    return [path] if entry or installed or top.__name__ in OWN else [path, *sorted(_beside(path).values())]


def _entry_module(policy: str) -> str:
    """The module of the entry point by which another package registers a policy; empty: there is none."""
    for point in _entry_points():
        if point.name == policy and point.module.partition(".")[0] not in OWN:
            # A name of fbl-gym's own stays its own, whatever other packages call theirs.
            return point.module if point.load() is controllers.factory(policy) else ""
    return ""


@lru_cache(maxsize=1)
def _entry_points() -> tuple[metadata.EntryPoint, ...]:
    return tuple(metadata.entry_points(group=ENTRY_POINTS))


def _beside(path: Path) -> dict[str, Path]:
    """The modules that a file imports, directly or through others, and that lie in its folder: their files by their names."""
    found: dict[str, Path] = {}
    left = [("", path)]
    while left:
        for wanted in _imports(*left.pop()):
            parts = wanted.split(".")
            for n in range(1, len(parts) + 1) if parts[0] not in OWN else ():
                name, place = ".".join(parts[:n]), path.parent.joinpath(*parts[:n])
                file = next((f for f in (place / "__init__.py", place.with_suffix(".py")) if f.is_file()), None)
                if file is not None and file != path and name not in found:
                    found[name] = file
                    left.append((name, file))
    return found


def _imports(name: str, path: Path) -> list[str]:
    """What a module may import, by full names, some of which are no modules.  name: of the module; path: of its file."""
    try:
        tree = ast.parse(path.read_bytes())
    except SyntaxError:
        return []
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            up = name.split(".")
            up = up[: len(up) - node.level + (path.name == "__init__.py")] if node.level else []
            base = ".".join([*up, *([node.module] if node.module else [])])
            found += [base, *(f"{base}.{alias.name}".lstrip(".") for alias in node.names)]
    return [full for full in found if full]
