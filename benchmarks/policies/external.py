"""External policies: the code of files and modules, and the archives that may be loaded.

A policy's key covers its code, the modules that it imports, and the data files that its factory
lists in the attribute `data_files`. A file that is read and not listed is not noticed.
"""

import contextlib
import hashlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from benchmarks.policies.digest import PACKAGES, closure
from benchmarks.policies.name import PolicyName
from controllers import registry
from controllers.composition import compose
from fbl_gym.reading import read_bytes
from fbl_gym.records.checks import unknown

ATTRIBUTE = "make_policy"
"""The factory in a file or module where no attribute is named."""


class Untrusted(ValueError):
    """Loading a file would run code that nobody has vouched for."""


class NotFound(ValueError):
    """There is no such module, no such factory in it, or none that goes with these parts."""


_TRUSTED: set[str] = set()


def trust(name: PolicyName) -> None:
    """Allow the code of a policy that a file names, or of an archive, to be run."""
    _TRUSTED.add(_trusted_as(name))


def expect_trust(name: PolicyName, origin: str) -> None:
    """Raise `Untrusted` if `origin`, a file, names a policy whose code nobody has vouched for."""
    if name.form in ("archive", "file", "module") and _trusted_as(name) not in _TRUSTED:
        raise Untrusted(f"{origin} names {name.text}, whose code would be run; give --trust if you trust it")


def _trusted_as(name: PolicyName) -> str:
    return str(Path(name.source).resolve()) if name.form == "archive" else name.code.text


def check(name: PolicyName) -> None:
    """Raise an error if an external policy does not exist or may not be loaded."""
    file = Path(name.source)
    if name.form in ("archive", "file") and not file.is_file():
        raise ValueError(f"policy must name a file that exists, but there is no file {file}")
    if name.form == "archive" and _trusted_as(name) not in _TRUSTED:
        raise Untrusted(f"loading {file} runs any code that it holds; give --trust if you trust its source")
    if name.form == "module" and not all(part.isidentifier() for part in name.source.split(".")):
        raise ValueError(f"policy must name a module as in an import, such as my_laws.pd, got {name.source!r}")


# Code: a file or a module.

LOADED: list[str] = []
"""The external policies whose code this process ran, which may change anything."""


def load(name: PolicyName) -> Callable[..., Any]:
    """Return the factory in a file or module. A file is run anew each time."""
    LOADED.append(name.text)
    module = _load_file(Path(name.source)) if name.form == "file" else _load_module(name.source)
    factory: Callable[..., Any] | None = getattr(module, name.attribute or ATTRIBUTE, None)
    if not callable(factory):
        raise NotFound(_no_factory(name.source, name.attribute, module))
    try:
        return compose(factory, *name.parts) if name.parts else factory
    except ValueError as problem:
        raise NotFound(f"{name.text}: {problem}") from None


def _no_factory(source: str, name: str, module: ModuleType) -> str:
    """Return the error of a file or module without a factory, which names its own classes."""
    own = [
        key for key, value in vars(module).items() if isinstance(value, type) and value.__module__ == module.__name__
    ]
    if name or not own:
        return str(unknown(f"factory of {source}", name or ATTRIBUTE, own))
    return f"{source} has no {ATTRIBUTE}: add `{ATTRIBUTE} = {own[-1]}`, or give {source}:{own[-1]}"


def _load_module(source: str) -> ModuleType:
    """Import a module by its name, installed or in the current folder."""
    try:
        with _importing_from(Path.cwd()):
            return importlib.import_module(source)
    except ModuleNotFoundError as problem:
        if not f"{source}.".startswith(f"{problem.name}."):
            raise
        raise NotFound(
            f"policy must name a module, but there is no module {source}, installed or in {Path.cwd()}"
        ) from None


def _load_file(path: Path) -> ModuleType:
    path = path.resolve()
    beside = _beside(path)
    name = f"fbl_gym_external_{hashlib.sha256(os.fsencode(path)).hexdigest()[:12]}"
    spec: Any = importlib.util.spec_from_file_location(name, path)
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    # Another policy may have imported a module of the same name, or an older state of this one.
    hidden = {n: sys.modules.pop(n) for n in beside if n in sys.modules}
    try:
        with _importing_from(path.parent):
            spec.loader.exec_module(module)
    finally:
        sys.modules.update({n: m for n, m in hidden.items() if getattr(m, "__file__", "") != str(beside[n])})
    return module


@contextlib.contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    """Look for modules in a folder first, and keep no compiled ones.

    Python's cache does not notice two edits within one second.
    """
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    before = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.dont_write_bytecode = before


def sources(name: PolicyName) -> dict[str, Path]:
    """Return the code of an external policy: the name and file of each module, its first.

    For an entry point or a module in a package, that is the whole package. For a file or a single
    module, it is the file and what it imports from its folder. An archive or an agent has none.
    """
    if name.form in ("archive", "agent"):
        return {}
    if name.form == "file":
        file = Path(name.source).resolve()
        return {"": file, **_beside(file)}
    entry = entry_module(name)
    module = entry or name.source
    top = module.partition(".")[0]
    path, package = _locate(module)[0], _locate(top)[1]
    if path is None:
        return {}
    if top in PACKAGES:
        return {module: path}
    if package:
        every = sorted({file for folder in package for file in Path(folder).rglob("*.py")})
        return {module: path, **{file.as_posix().rpartition(f"/{top}/")[2]: file for file in every}}
    installed = path.parent.name in ("site-packages", "dist-packages")
    return {"": path} if entry or installed else {"": path, **_beside(path)}


def _locate(module: str) -> tuple[Path | None, list[str]]:
    """Return the file of a module and the folders of a package. No code is run to find them."""
    if (loaded := sys.modules.get(module)) is not None:
        file = getattr(loaded, "__file__", None)
        return (Path(file) if file else None), list(getattr(loaded, "__path__", []))
    importlib.invalidate_caches()
    spec, folders = None, [os.getcwd(), *sys.path]
    for part in module.split("."):
        spec = PathFinder.find_spec(part, folders)
        folders = list((spec and spec.submodule_search_locations) or ())
    return (Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None), folders


def entry_module(name: PolicyName) -> str:
    """Return the module by which another package registers a policy; empty: there is none."""
    point = registry.external().get(name.source) if name.form == "name" else None
    return "" if point is None or point.module.partition(".")[0] in PACKAGES else point.module


def _beside(path: Path) -> dict[str, Path]:
    """Return the modules in a file's folder that it imports, directly or through others."""
    modules = closure({"": path}, path.parent)
    return {name: file for name, file in modules.items() if name and name.partition(".")[0] not in PACKAGES}


# Data: files that a policy reads.


def file_digest(path: Path) -> str:
    """Return a hash of a file's bytes; of nothing, where it is gone."""
    try:
        return hashlib.sha256(read_bytes(path, 1_000_000_000)).hexdigest()
    except OSError:
        return ""
