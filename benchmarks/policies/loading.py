"""The factory of a policy by its name, of any form; here alone code of others is loaded."""

import contextlib
import hashlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from numba.core.ccallback import CFunc
from numba.core.dispatcher import Dispatcher
from numba.np.ufunc.ufuncbuilder import UFuncDispatcher

from benchmarks.agents.policy import folder_factory, shipped
from benchmarks.agents.sb3 import archive_factory
from benchmarks.policies.isolation import POLICY_FOLDERS
from benchmarks.policies.key import PACKAGES, place
from controllers import registry
from controllers.composition import compose
from controllers.name import PolicyName
from fbl_gym.neighbours import ROOT
from fbl_gym.records.checks import unknown

#: The factory in a file or module where no attribute is named.
ATTRIBUTE = "make_policy"


class NotFound(ValueError):
    """There is no such file or module, or no such factory in it that goes with these parts."""


class Untrusted(NotFound):
    """Loading a file would run code that nobody has vouched for."""


def outside_module(name: PolicyName) -> str:
    """Return the module that is named, or by which another package registers a policy; or ""."""
    if name.form != "name":
        return name.source if name.form == "module" else ""
    point = registry.external().get(name.source)
    return "" if point is None or point.module.partition(".")[0] in PACKAGES else point.module


def is_code(name: PolicyName) -> bool:
    """Return True if the name means code from outside fbl-gym that runs when it is loaded."""
    return name.form == "file" or outside_module(name) != ""


def load(name: PolicyName) -> Callable[..., Any]:
    """Return the factory of a policy; a file is run anew each time.

    Raises:
        Untrusted: it is an archive, or code that a file names, and nobody has said to trust it.
        ValueError: no policy has that name.
    """
    path, vouch = Path(name.source), "give --trust if you trust {} (in Python, trust=True)"
    if name.tuned and name.form != "name":
        search = f"`fbl-gym tune {name.law} --class CLASS` finds some, for {name.law}@results/gains"
        raise NotFound(f"{name.law} has no gains that come with fbl-gym: {search}")
    if name.form in ("archive", "file") and not path.is_file():
        raise NotFound(f"policy must name a file that exists, but there is no file {path} (in {Path.cwd()})")
    if name.form == "file" and place(str(path.resolve())) == "ours":
        module = ".".join(path.resolve().relative_to(ROOT).with_suffix("").parts)
        raise NotFound(f"policy must be a module where it is one of fbl-gym, {module}:CLASS, got the file {path}")
    if name.form in ("archive", "file", "module") and name.origin and not name.trusted:
        raise Untrusted(f"{name.origin} names {name}, whose code would be run; {vouch.format('it')}")
    if name.form == "archive" and not name.trusted:
        raise Untrusted(f"loading {path} runs any code that it holds; {vouch.format('its source')}")
    match name.form:
        case "name":
            return _registered(name)
        case "folder":
            if not (path / "agent.json").is_file():
                expected = "a name, an existing file, or a folder with an agent.json"
                raise NotFound(f"policy must be {expected}, got {str(name)!r}")
            factory: Callable[..., Any] = folder_factory(path.resolve())
        case "archive":
            factory = archive_factory(path.resolve())
        case "file":
            factory = _attribute(name, _load_file(path.resolve()))
        case "module":
            factory = _attribute(name, _load_module(name.source))
        case form:
            raise unknown("form of a policy's name", form, ("archive", "file", "folder", "module", "name"))
    try:
        return compose(factory, *name.parts) if name.parts else factory
    except ValueError as problem:
        raise NotFound(f"{name}: {problem}") from None


def _registered(name: PolicyName) -> Callable[..., Any]:
    if (Path(name.source) / "agent.json").is_file() and name.source not in registry.names():
        path = f"./{name.source}"
        raise NotFound(f"unknown policy {name.source!r}; the folder of that name is named by its path, {path}")
    registry.check_name(name)
    if name.seed is not None and name.seed not in shipped().get(name.source, ()):
        raise unknown("policy", str(name), registry.names())
    with _outside_code(Path.cwd()) if outside_module(name) else contextlib.nullcontext():
        return registry.factory(name)


def _attribute(name: PolicyName, module: ModuleType) -> Callable[..., Any]:
    """Return the factory in a module; the error without one names the module's own classes."""
    factory: Callable[..., Any] | None = getattr(module, name.attribute or ATTRIBUTE, None)
    if callable(factory):
        return factory
    classes = (value for value in vars(module).values() if isinstance(value, type))
    own = [*dict.fromkeys(each.__name__ for each in classes if each.__module__ == module.__name__)]
    if name.attribute or not own:
        raise NotFound(str(unknown(f"factory of {name.source}", name.attribute or ATTRIBUTE, own)))
    source = name.source
    raise NotFound(f"{source} has no {ATTRIBUTE}: add `{ATTRIBUTE} = {own[-1]}`, or give {source}:{own[-1]}")


def _load_module(source: str) -> ModuleType:
    """Import a module by its name, installed or in the current folder."""
    if not all(part.isidentifier() for part in source.split(".")):
        raise NotFound(f"policy must name a module as in an import, such as my_laws.pd, got {source!r}")
    try:
        with _outside_code(Path.cwd()):
            return importlib.import_module(source)
    except ModuleNotFoundError as problem:
        if not f"{source}.".startswith(f"{problem.name}."):
            raise
        places = f"installed or in {Path.cwd()}"
        raise NotFound(f"policy must name a module, but there is no module {source}, {places}") from None


def _load_file(path: Path) -> ModuleType:
    name = f"{FILE_MODULE}{hashlib.sha256(os.fsencode(path)).hexdigest()[:12]}"
    spec: Any = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    with _outside_code(path.parent):
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return module


#: Beginning of the name of a module that a file makes.
FILE_MODULE = "fbl_gym_external_"

#: Modules that external policies imported from folders, which may have changed since.
IMPORTED: set[str] = set()


@contextlib.contextmanager
def _outside_code(folder: Path) -> Iterator[None]:
    """Import from a folder first, anew what other policies imported, and keep no compiled code.

    Python's cache does not notice two edits within one second, and Numba's no edit of another file.
    """
    for compiled in (Dispatcher, CFunc, UFuncDispatcher):
        compiled.enable_caching = lambda _: None  # type: ignore[method-assign]
    importlib.invalidate_caches()
    beside = f"{folder}{os.sep}"
    hidden = {name: sys.modules.pop(name) for name, module in [*sys.modules.items()] if name in IMPORTED or (
        name != "__main__" and str(getattr(module, "__file__", "")).startswith(beside) and place(str(module.__file__)) == ""
    )}  # fmt: skip
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        if str(folder) not in sys.path:  # for what it imports later
            sys.path.append(str(folder))
            POLICY_FOLDERS.add(str(folder))
        sys.dont_write_bytecode = no_bytecode
        for name in sys.modules.keys() - before:
            if place(str(getattr(sys.modules[name], "__file__", None) or "<frozen")) == "":
                IMPORTED.add(name)
        sys.modules.update({name: module for name, module in hidden.items() if name not in sys.modules})
