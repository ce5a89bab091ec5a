"""The files that a policy's numbers depend on, and their hashes.

1. All results run through the `SHARED` files: one hash.
2. A policy depends on its own code: the module of its law with the modules of laws whose functions
   and classes that uses, and, if it is external, every file of modules that it loaded.
3. It declares the rest: the laws that it makes by name in `uses`, and the files that it reads in
   `data_files`.

Hashes are of bytes, so a comment counts too.
"""

import functools
import hashlib
import json
import os
import sys
import sysconfig
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

from fbl_gym.neighbours import ROOT
from fbl_gym.reading import read_bytes

#: The packages of fbl-gym.
PACKAGES = ("benchmarks", "controllers", "fbl_gym")

#: The code that every result runs through: arm, rollout, metrics, margins, and the bases of laws.
#:
#: Any law is composed where a sensor that it needs is absent. The options of a scenario are part of
#: a cell's key themselves.
SHARED = (
    "fbl_gym/*.py", "fbl_gym/engines/*.py", "fbl_gym/envs/*.py", "fbl_gym/kernel/**/*.py", "fbl_gym/model/*.py",
    "fbl_gym/options/*.py", "fbl_gym/records/*.py", "fbl_gym/scenarios/scenario.py", "controllers/base.py",
    "controllers/composition.py", "controllers/parts.py", "controllers/drive.py", "controllers/preview.py",
    "controllers/numerics/*.py", "controllers/oracles/true_arm.py", "benchmarks/run/metrics.py",
    "benchmarks/run/rollout.py", "benchmarks/run/linearize.py", "benchmarks/run/loop.py",
)  # fmt: skip

#: The modules of policies: each counts for those that use it.
LAWS = ("controllers.laws.", "controllers.paper.", "controllers.oracles.", "benchmarks.agents.")

#: Libraries that every result runs through; a result states their versions.
PINNED = ("gymnasium", "llvmlite", "numba", "numpy", "scipy")


def data_digest(data: Any) -> str:
    """Return a hash of plain data."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def file_digest(path: Path | str) -> str:
    """Return a hash of a file's bytes; empty where it is gone."""
    try:
        return hashlib.sha256(read_bytes(path, 1_000_000_000)).hexdigest()
    except OSError:
        return ""


def digests(files: Mapping[str, Path | str]) -> dict[str, str]:
    """Return the hash of each file, by its name."""
    return {name: file_digest(path) for name, path in sorted(files.items())}


@functools.cache
def shared() -> str:
    """Return the hash of the `SHARED` files as this process first met them."""
    files = (path for pattern in SHARED for path in ROOT.glob(pattern))
    return data_digest(digests({path.relative_to(ROOT).as_posix(): path for path in files}))


@functools.lru_cache(maxsize=4096)
def place(path: str) -> str:
    """Return where a file is from: "ours", "standard" (Python's), "installed", "" (elsewhere)."""
    if any(path.startswith(f"{ROOT / package}{os.sep}") for package in PACKAGES):
        return "ours"
    if {"site-packages", "dist-packages"}.intersection(Path(path).parts):
        return "installed"
    return "standard" if path.startswith(("<", *_STANDARD)) else ""


_LIBRARIES = [sysconfig.get_path(name) for name in ("stdlib", "platstdlib")]
_STANDARD = (*(f"{path}{os.sep}" for path in _LIBRARIES), f"{Path(_LIBRARIES[0]).with_name('python')}")  # a zip


def law_modules(roots: Iterable[ModuleType]) -> dict[str, Path]:
    """Return the modules of `LAWS` among some, and those whose functions and classes they use."""
    found: dict[str, Path] = {}
    unread = list(roots)
    while unread:
        module = unread.pop()
        if module.__name__.startswith(LAWS):
            found[module.__name__] = Path(str(module.__file__))
        for value in [*vars(module).values()]:
            owner = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
            if str(owner).startswith(LAWS) and owner not in found and owner in sys.modules:
                unread.append(sys.modules[str(owner)])
    return found


_owners = functools.cache(metadata.packages_distributions)


def loaded_since(before: Iterable[str], own: str) -> tuple[dict[str, Path], set[str]]:
    """Return what was imported from outside fbl-gym and the standard library.

    Args:
        before: names of the modules that were there.
        own: name of the policy's own package, whose modules count as files where it is installed.

    Returns:
        The file of each module, by the module's name; and the installed packages of all others.
    """
    files: dict[str, Path] = {}
    packages: set[str] = set()
    for name, module in [*sys.modules.items()]:
        path, top = getattr(module, "__file__", None), name.partition(".")[0]
        if not isinstance(path, str) or place(path) == "ours" or (name in before and top != own):
            continue
        if place(path) == "installed":
            packages.update(_owners().get(top, ()))
        if place(path) == "" or top == own or (place(path) == "installed" and top not in _owners()):
            archive = (parent for parent in (Path(path), *Path(path).parents) if parent.is_file())  # of zipped modules
            files[name] = next(archive, Path(path)).resolve()
    return files, packages - {*PINNED}
