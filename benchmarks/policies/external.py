"""External policies, from files, modules, folders of agents and archives.

A policy's digest covers its code, the modules that it imports and the data files that it reads
while it is made. A file that is read later must be named in the attribute `data_files` of the
policy's factory, so that it is part of the digest too. Reads by C libraries, the network, the clock
and environment variables cannot be seen: the policy's author answers for them.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import os
import site
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import controllers
from benchmarks.policies.digest import PACKAGES, closure, code_digest, entry_points
from fbl_gym.checks import unknown

ATTRIBUTE = "make_policy"
"""The factory in a file or module where no attribute is named."""


class Untrusted(ValueError):
    """Loading a file would run code that nobody has vouched for."""


class NotFound(ValueError):
    """There is no such module, or no such factory in it."""


_TRUSTED: set[str] = set()


def trust(path: str) -> None:
    """Allow an archive to be loaded. Loading runs any code that it holds."""
    _TRUSTED.add(str(Path(path).resolve()))


def is_archive(text: str) -> bool:
    """Return whether a policy is an archive of stable-baselines3."""
    return text.endswith(".zip")


def is_file(text: str) -> bool:
    """Return whether a policy is a Python file, with or without an attribute."""
    return text.partition(":")[0].endswith(".py")


def is_agent(text: str) -> bool:
    """Return whether a policy is a folder of an agent, named by its path, such as ./name."""
    return (os.sep in text or "/" in text) and (Path(text) / "agent.json").is_file()


def is_external(text: str) -> bool:
    """Return whether a policy is named by the place of its code or weights."""
    return ":" in text or is_archive(text) or is_file(text) or is_agent(text)


def check(text: str) -> None:
    """Raise an error if an external policy does not exist or may not be loaded."""
    if is_archive(text) or is_file(text):
        path = Path(text.partition(":")[0])
        if not path.is_file():
            raise ValueError(f"policy must name a file that exists, but there is no file {path}")
        if is_archive(text) and str(path.resolve()) not in _TRUSTED:
            raise Untrusted(f"loading {path} runs any code that it holds; give --trust if you trust its source")
    elif ":" in text:
        source = text.partition(":")[0]
        if not all(part.isidentifier() for part in source.split(".")):
            raise ValueError(
                f"the module of a policy must be named as in an import, such as my_laws.pd, got {source!r}"
            )


_HAS_LOADED: list[str] = []


def has_loaded() -> bool:
    """Return whether this process ran the code of an external policy.

    Such code may have changed anything in the process.
    """
    return bool(_HAS_LOADED)


def load(text: str) -> Callable[..., Any]:
    """Return the factory of an external policy that is code.

    A file is loaded again when its code has changed.
    """
    _HAS_LOADED.append(text)
    source, _, name = text.partition(":")
    module = _load_file(Path(source)) if source.endswith(".py") else _load_module(source)
    name = name or ATTRIBUTE
    if not callable(getattr(module, name, None)):
        public = [n for n in vars(module) if callable(getattr(module, n)) and not n.startswith("_")]
        raise NotFound(unknown(f"factory of {source}", name, public))
    factory: Callable[..., Any] = getattr(module, name)
    return factory


def _load_module(source: str) -> ModuleType:
    """Import a module by its name, installed or in the current folder."""
    try:
        with _importing_from(Path.cwd()):
            return importlib.import_module(source)
    except ModuleNotFoundError as problem:
        if not f"{source}.".startswith(f"{problem.name}."):
            raise
        raise NotFound(
            f"policy must name a module that exists, but there is no module {source}, installed or in {Path.cwd()}"
        ) from None


@contextlib.contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    """Look for modules in a folder first."""
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def _load_file(path: Path) -> ModuleType:
    path = path.resolve()
    beside = _beside(path)
    code = code_digest({"": path, **beside})
    name = f"fbl_gym_external_{hashlib.sha256(f'{path} {code}'.encode()).hexdigest()[:12]}"
    if name not in sys.modules:
        spec = _spec(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        # Another policy may have imported a module of the same name, or an older state of this one.
        hidden = {n: sys.modules.pop(n) for n in beside if n in sys.modules}
        hidden = {n: m for n, m in hidden.items() if getattr(m, "__file__", None) != str(beside[n])}
        try:
            with _importing_from(path.parent), _finding(beside):
                spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
        finally:
            sys.modules.update(hidden)
        _LOADED.setdefault(path, set()).add(name)
        if code_digest({"": path, **_beside(path)}) != code:
            forget(path)
            raise ValueError(f"{path} changed while it was loaded; run it again")
    return sys.modules[name]


_LOADED: dict[Path, set[str]] = {}
"""The names under which the states of a file are loaded."""


def forget(path: Path) -> None:
    """Load a file again when it is needed next, since data that it read has changed."""
    for name in _LOADED.pop(path.resolve(), set()):
        sys.modules.pop(name, None)


class _Fresh(SourceFileLoader):
    """A loader that compiles the source.

    Python's cache does not notice two edits within one second.
    """

    def get_code(self, _fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


class _Finder(MetaPathFinder):
    """Finds the modules beside a file."""

    def __init__(self, modules: Mapping[str, Path]) -> None:
        self.modules = modules

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        return _spec(fullname, self.modules[fullname]) if fullname in self.modules else None


def _spec(name: str, path: Path) -> ModuleSpec | None:
    folders = [str(path.parent)] if path.name == "__init__.py" else None
    return importlib.util.spec_from_file_location(
        name, path, loader=_Fresh(name, str(path)), submodule_search_locations=folders
    )


@contextlib.contextmanager
def _finding(modules: Mapping[str, Path]) -> Iterator[None]:
    finder = _Finder(modules)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


def sources(text: str) -> dict[str, Path]:
    """Return the code of an external policy: the name and file of each module, its first.

    For an entry point or a module in a package, that is the whole package. For a file or a single
    module, it is the file and what it imports from its own folder. An archive or an agent has no
    code.

    Args:
        text: names the policy.
    """
    if is_archive(text) or is_agent(text):
        return {}
    if is_file(text):
        path = Path(text.partition(":")[0]).resolve()
        return {"": path, **_beside(path)}
    entry = entry_module(text) if ":" not in text else ""
    name = entry or text.partition(":")[0]
    module, top = _load_module(name), _load_module(name.partition(".")[0])
    if getattr(module, "__file__", None) is None:
        return {}
    path = Path(str(module.__file__))
    if top.__name__ in PACKAGES:
        return {name: path}
    if hasattr(top, "__path__"):
        files = sorted({file for folder in top.__path__ for file in Path(folder).rglob("*.py")})
        return {name: path, **{file.as_posix().rpartition(f"/{top.__name__}/")[2]: file for file in files}}
    installed = path.parent.name in ("site-packages", "dist-packages")
    return {"": path} if entry or installed else {"": path, **_beside(path)}


def entry_module(name: str) -> str:
    """Return the module by which another package registers a policy; empty: there is none."""
    for point in entry_points():
        if point.name == name and point.module.partition(".")[0] not in PACKAGES:
            # A built-in policy of that name wins.
            return point.module if point.load() is controllers.factory(name) else ""
    return ""


def _beside(path: Path) -> dict[str, Path]:
    """The modules in a file's folder that it imports, directly or through others."""
    return {
        n: file for n, file in closure({"": path}, path.parent).items() if n and n.partition(".")[0] not in PACKAGES
    }


def file_digest(path: Path) -> str:
    """Return a hash of a file's bytes; of nothing, where it is gone."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


_WATCHES: list[set[Path]] = []
_IGNORED = (".nbi", ".nbc", ".so", ".pyd", ".dll", ".dylib")


def _notice(event: str, arguments: tuple[Any, ...]) -> None:
    """Record each file that is opened for reading while somebody watches; an audit hook."""
    if event != "open" or not _WATCHES or not isinstance(arguments[0], str | bytes):
        return
    flags = arguments[2] if isinstance(arguments[2], int) else 0
    if flags & (os.O_WRONLY | os.O_CREAT):
        return
    path = Path(os.path.realpath(os.fsdecode(arguments[0])))
    if path.suffix == ".pyc":
        with contextlib.suppress(ValueError):
            path = Path(importlib.util.source_from_cache(str(path)))
    if path.suffix not in _IGNORED:
        for reads in _WATCHES:
            reads.add(path)


_HOOKED: list[bool] = []


@contextlib.contextmanager
def watch() -> Iterator[set[Path]]:
    """Collect the files that are read from here on."""
    if not _HOOKED:
        sys.addaudithook(_notice)
        _HOOKED.append(True)
    reads: set[Path] = set()
    _WATCHES.append(reads)
    try:
        yield reads
    finally:
        _WATCHES[:] = [other for other in _WATCHES if other is not reads]


def data_files(reads: set[Path], code: dict[str, Path]) -> set[Path]:
    """Return the files that hold a policy's data, out of those that were read.

    Code, and files of Python and of other packages, are no data.

    Args:
        reads: from `watch`.
        code: from `sources`.
    """
    folders = {path.parent for path in code.values()}
    known = {path.resolve() for path in code.values()}
    return {path for path in reads if path not in known and path.is_file() and _holds_data(path, folders)}


def _holds_data(path: Path, folders: set[Path]) -> bool:
    installed = {Path(p).resolve() for p in _INSTALLED}
    nearest = max(
        (f for f in (*folders, *_OURS, *installed) if f in path.parents), key=lambda f: len(f.parts), default=None
    )
    if nearest in _OURS and nearest not in folders:
        return path.suffix != ".py"
    return nearest is None or nearest in folders or nearest not in installed


_OURS = tuple(Path(__file__).resolve().parents[2] / package for package in PACKAGES)
_INSTALLED = (
    sys.prefix, sys.base_prefix, *sysconfig.get_paths().values(), *site.getsitepackages(), site.getusersitepackages(),
    "/proc", "/sys", "/dev", "/etc", "/usr",
)  # fmt: skip
