"""External policies, from files, modules, folders of agents and archives.

A policy's digest covers its code, the modules that it imports and the data files that it reads
while it is made. A file that is read later must be named in the attribute `data_files` of the
policy's factory, so that it is part of the digest too. Reads by C libraries, the network, the clock
and environment variables are not noticed.
"""

import contextlib
import hashlib
import importlib
import importlib.util
import os
import site
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from benchmarks.policies.digest import PACKAGES, closure, code_digest
from benchmarks.rl.agent import DESCRIPTION, files
from controllers import registry
from fbl_gym.checks import unknown

ATTRIBUTE = "make_policy"
"""The factory in a file or module where no attribute is named."""


class Untrusted(ValueError):
    """Loading a file would run code that nobody has vouched for."""


class NotFound(ValueError):
    """There is no such module, or no such factory in it."""


# The text that names a policy.


def split_gains(text: str) -> tuple[str, tuple[str, ...]]:
    """Return a text without the gains at its end, and these: NAME=VALUE, a file, or a folder each.

    Only a registered name, a file and a module have gains: "my_law.py@kp=25" does, and
    "runs@home/model.zip" does not. "@tuned" and a training seed, "@3", belong to the name.
    """
    code, _, last = text.rpartition("@")
    if not code or last == "tuned" or last.isdigit() or last.endswith((".py", ".zip")):
        return text, ()
    inner, gains = split_gains(code)
    registered = inner.partition("@")[0].partition("+")[0] in registry.names()
    return (inner, (*gains, last)) if registered or form_of(inner) in ("file", "module") else (text, ())


def form_of(text: str) -> str:
    """Return the form of a text: "archive", "file", "module", "agent" (a folder), or "name"."""
    text = split_gains(text)[0]
    if text.endswith(".zip"):
        return "archive"
    if split(text)[0].endswith(".py"):
        return "file"
    if os.sep in text or "/" in text:
        if (Path(text) / DESCRIPTION).is_file():
            return "agent"
        if _archives(Path(text)):
            return "archive"
    return "module" if ":" in text else "name"


def split(text: str) -> tuple[str, str]:
    """Return the place of a policy's code and the attribute; empty: none is named.

    A path may contain colons, as on Windows.
    """
    text = split_gains(text)[0]
    source, _, name = text.rpartition(":")
    return (source, name) if source and name.isidentifier() else (text, "")


def weights(text: str) -> list[Path]:
    """Return the files of a trained policy, an archive or an agent; none for code."""
    form = form_of(text)
    return [archive(text)] if form == "archive" else files(Path(text)) if form == "agent" else []


def archive(text: str) -> Path:
    """Return the archive that a text names: a .zip, or the only one in a folder of Hugging Face."""
    if text.endswith(".zip"):
        return Path(text)
    if (Path(text) / "vec_normalize.pkl").exists():
        raise ValueError(
            f"{text} holds a model of normalized observations (vec_normalize.pkl): train it without VecNormalize, on "
            "fbl_gym/TwoLinkArmTracking-v0, whose observations are of order one"
        )
    first, *others = _archives(Path(text))
    if others:
        raise ValueError(
            f"folder must hold one archive, got {text!r} with {len(others) + 1}: name one, such as {first}"
        )
    return first


def _archives(folder: Path) -> list[Path]:
    """Return the archives in a folder; rl_zoo3 puts its learning curve beside them."""
    return [path for path in sorted(folder.glob("*.zip")) if path.name != "train_eval_metrics.zip"]


_TRUSTED: set[str] = set()


def trust(text: str) -> None:
    """Allow the code of a policy that a file names, or of an archive, to be run."""
    _TRUSTED.add(_place(text))


def expect_trust(text: str, origin: str) -> None:
    """Raise `Untrusted` if `origin`, a file, names a policy whose code nobody has vouched for."""
    if form_of(text) in ("archive", "file", "module") and _place(text) not in _TRUSTED:
        raise Untrusted(f"{origin} names {text}, whose code would be run; give --trust if you trust it")


def _place(text: str) -> str:
    return str(Path(text).resolve()) if form_of(text) == "archive" else split_gains(text)[0]


def check(text: str) -> None:
    """Raise an error if an external policy does not exist or may not be loaded."""
    form, source = form_of(text), split(text)[0]
    source = str(archive(text)) if form == "archive" else source
    if form in ("archive", "file") and not Path(source).is_file():
        raise ValueError(f"policy must name a file that exists, but there is no file {Path(source)}")
    if form == "archive" and _place(text) not in _TRUSTED:
        raise Untrusted(f"loading {Path(text)} runs any code that it holds; give --trust if you trust its source")
    if form == "module" and not all(part.isidentifier() for part in source.split(".")):
        raise ValueError(f"the module of a policy must be named as in an import, such as my_laws.pd, got {source!r}")


# Code: a file or a module.

_HAS_LOADED: list[str] = []


def has_loaded() -> bool:
    """Return True if this process ran the code of an external policy, which may change anything."""
    return bool(_HAS_LOADED)


def load(text: str) -> Callable[..., Any]:
    """Return the factory in a file or module. A file is loaded again when its code has changed."""
    _HAS_LOADED.append(text)
    source, name = split(text)
    module = _load_file(Path(source)) if form_of(text) == "file" else _load_module(source)
    factory: Callable[..., Any] | None = getattr(module, name or ATTRIBUTE, None)
    if not callable(factory):
        raise NotFound(_no_factory(source, name, module))
    return factory


def _no_factory(source: str, name: str, module: ModuleType) -> str:
    """Return the error of a file or module without a factory; imported names are no factories."""
    top = module.__name__.partition(".")[0]
    factories = {
        attribute: value for attribute, value in vars(module).items()
        if callable(value) and not attribute.startswith("_")
        and str(getattr(value, "__module__", "")).partition(".")[0] == top
    }  # fmt: skip
    if name or not factories:
        return str(unknown(f"factory of {source}", name or ATTRIBUTE, factories))
    last = [*factories, *(attribute for attribute, value in factories.items() if isinstance(value, type))][-1]
    return f"{source} has no {ATTRIBUTE}: add `{ATTRIBUTE} = {last}`, or give {source}:{last}"


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


def _load_file(path: Path) -> ModuleType:
    path = path.resolve()
    beside = _beside(path)
    code = code_digest({"": path, **beside})
    name = f"{_prefix(path)}{code[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = _spec(name, path)
    assert spec is not None
    assert spec.loader is not None
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    # Another policy may have imported a module of the same name, or an older state of this one.
    hidden = {n: sys.modules.pop(n) for n in beside if n in sys.modules}
    hidden = {n: m for n, m in hidden.items() if getattr(m, "__file__", None) != str(beside[n])}
    try:
        with _importing_from(path.parent, beside):
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        sys.modules.update(hidden)
    if code_digest({"": path, **_beside(path)}) != code:
        forget(path)
        raise ValueError(f"{path} changed while it was loaded; run it again")
    return module


def forget(path: Path) -> None:
    """Forget a loaded file, so that it is loaded again when it is needed next."""
    for name in [name for name in sys.modules if name.startswith(_prefix(path.resolve()))]:
        del sys.modules[name]


def _prefix(path: Path) -> str:
    """Return the beginning of the names under which the states of a file are loaded."""
    return f"fbl_gym_external_{hashlib.sha256(os.fsencode(path)).hexdigest()[:12]}_"


@contextlib.contextmanager
def _importing_from(folder: Path, modules: Mapping[str, Path] | None = None) -> Iterator[None]:
    """Look for modules in a folder first; compile some of its modules anew."""
    finder = _Finder(modules or {})
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.meta_path.remove(finder)


@dataclass
class _Finder(MetaPathFinder):
    """A finder of some modules by their files."""

    modules: Mapping[str, Path]

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        return _spec(fullname, self.modules[fullname]) if fullname in self.modules else None


class _Fresh(SourceFileLoader):
    """A loader that compiles: Python's cache does not notice two edits within one second."""

    def get_code(self, _fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


def _spec(name: str, path: Path) -> ModuleSpec | None:
    folders = [str(path.parent)] if path.name == "__init__.py" else None
    return importlib.util.spec_from_file_location(
        name, path, loader=_Fresh(name, str(path)), submodule_search_locations=folders
    )


def sources(text: str) -> dict[str, Path]:
    """Return the code of an external policy: the name and file of each module, its first.

    For an entry point or a module in a package, that is the whole package. For a file or a single
    module, it is the file and what it imports from its folder. An archive or an agent has none.
    """
    if weights(text):
        return {}
    if form_of(text) == "file":
        file = Path(split(text)[0]).resolve()
        return {"": file, **_beside(file)}
    entry = entry_module(text)
    name = entry or split(text)[0]
    top = name.partition(".")[0]
    path, package = _locate(name)[0], _locate(top)[1]
    if path is None:
        return {}
    if top in PACKAGES:
        return {name: path}
    if package:
        every = sorted({file for folder in package for file in Path(folder).rglob("*.py")})
        return {name: path, **{file.as_posix().rpartition(f"/{top}/")[2]: file for file in every}}
    installed = path.parent.name in ("site-packages", "dist-packages")
    return {"": path} if entry or installed else {"": path, **_beside(path)}


def _locate(module: str) -> tuple[Path | None, list[str]]:
    """Return the file of a module and the folders of a package. No code is run to find them."""
    if (loaded := sys.modules.get(module)) is not None:
        file = getattr(loaded, "__file__", None)
        return (Path(file) if file else None), list(getattr(loaded, "__path__", []))
    file, folders = None, [Path.cwd(), *map(Path, sys.path)]
    for part in module.split("."):
        places = [place for folder in folders for place in (folder / part / "__init__.py", folder / f"{part}.py")]
        file = next((place for place in places if place.is_file()), None)
        if file is None:  # a package without __init__.py
            folders = [folder / part for folder in folders if (folder / part).is_dir()]
        else:
            folders = [file.parent] if file.name == "__init__.py" else []
    return file, list(map(str, folders))


def entry_module(name: str) -> str:
    """Return the module by which another package registers a policy; empty: there is none."""
    point = registry.external().get(name)
    return "" if point is None or point.module.partition(".")[0] in PACKAGES else point.module


def _beside(path: Path) -> dict[str, Path]:
    """Return the modules in a file's folder that it imports, directly or through others."""
    modules = closure({"": path}, path.parent)
    return {name: file for name, file in modules.items() if name and name.partition(".")[0] not in PACKAGES}


# Data: files that are read while a policy is made.


def file_digest(path: Path) -> str:
    """Return a hash of a file's bytes; of nothing, where it is gone."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


_WATCHES: list[set[Path]] = []
_COMPILED = (".nbi", ".nbc", ".so", ".pyd", ".dll", ".dylib")


@contextlib.contextmanager
def watch() -> Iterator[set[Path]]:
    """Collect the files that are read within."""
    _add_hook()
    reads: set[Path] = set()
    _WATCHES.append(reads)
    try:
        yield reads
    finally:
        _WATCHES[:] = [other for other in _WATCHES if other is not reads]


@lru_cache(maxsize=1)
def _add_hook() -> None:
    sys.addaudithook(_notice)


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
    if path.suffix not in _COMPILED:
        for reads in _WATCHES:
            reads.add(path)


def data_files(reads: set[Path], code: Mapping[str, Path]) -> set[Path]:
    """Return the files that hold a policy's data, out of those that were read (`watch`).

    Code, and files of Python and of other packages, are no data.
    """
    known = {path.resolve() for path in code.values()}
    folders = {path.parent for path in code.values()}
    return {path for path in reads - known if path.is_file() and _holds_data(path, folders)}


def _holds_data(path: Path, folders: set[Path]) -> bool:
    """Return True unless a file belongs to an installation; files beside the policy never do."""
    places = [place for place in (*folders, *_OURS, *_installed()) if place in path.parents]
    nearest = max(places, key=lambda place: len(place.parts), default=None)
    if nearest is None or nearest in folders:
        return True
    return path.suffix != ".py" if nearest in _OURS else False


_OURS = tuple(Path(__file__).resolve().parents[2] / package for package in PACKAGES)


@lru_cache(maxsize=1)
def _installed() -> tuple[Path, ...]:
    python = (sys.prefix, sys.base_prefix, *sysconfig.get_paths().values(), *site.getsitepackages())
    system = ("/proc", "/sys", "/dev", "/etc", "/usr")
    return tuple(Path(place).resolve() for place in (*python, site.getusersitepackages(), *system))
