"""Hashes of the code that a result depends on, without comments, docstrings and layout.

The modules that a result depends on are found by reading import statements, without running
anything.
"""

import ast
import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

PACKAGES = ("benchmarks", "controllers", "fbl_gym")
"""The packages of fbl-gym. Their modules are followed wherever they are imported."""

SKIPPED = (
    "benchmarks.policies",
    "controllers.catalogue",
    "controllers.registry",
    "controllers.runner",
    "fbl_gym.view.picture",
    "fbl_gym.view.render",
    *(f"fbl_gym.scenarios.{name}" for name in ("files", "classes", "families", "ideal", "tiers", "worlds")),
)
"""Modules that choose a policy, run it on a robot, draw pictures, or hold scenarios.

None of these but scenarios changes a number. A scenario's options are part of the key.
"""

_ROOT = Path(__file__).resolve().parents[2]


def data_digest(data: Any) -> str:
    """Return a hash of plain data."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def code_digest(modules: Mapping[str, Path]) -> str:
    """Return a hash of the code of some modules, each a name and its file."""
    lines = [f"{name} {source_digest(path.read_bytes())}" for name, path in sorted(modules.items())]
    return hashlib.sha256("\n".join(lines).encode(errors="surrogateescape")).hexdigest()


@lru_cache(maxsize=1024)
def source_digest(source: bytes) -> str:
    """Return a hash of a source's syntax tree; of its bytes where it is not valid Python."""
    with contextlib.suppress(SyntaxError, ValueError, RecursionError):
        source = _text(ast.parse(source)).encode()
    return hashlib.sha256(source).hexdigest()


def _text(node: object) -> str:
    """Return a syntax tree as text, the same in every version of Python, without docstrings."""
    if isinstance(node, list):
        return f"[{' '.join(_text(item) for item in node if not _is_docstring(item))}]"
    if isinstance(node, ast.JoinedStr):  # Python 3.12 ends some with an empty string
        return f"f({' '.join(_text(item) for item in node.values if getattr(item, 'value', '') != '')})"
    if isinstance(node, ast.AST):
        # A later version has more fields, which are empty for code of an earlier one.
        fields = [f"{name}={_text(value)}" for name, value in ast.iter_fields(node) if value not in (None, [])]
        return f"{type(node).__name__}({' '.join(fields)})"
    return repr(node)


def _is_docstring(node: object) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def closure(roots: Mapping[str, Path], folder: Path | None = None) -> dict[str, Path]:
    """Return some modules with all that they import, each a name and its file.

    Only modules of fbl-gym, and modules that lie in the folder, are followed.
    """
    modules = dict(roots)
    unread = list(roots.items())
    while unread:
        for name, path in _imported(*unread.pop(), folder):
            if path not in modules.values():
                modules[name] = path
                unread.append((name, path))
    return modules


def file_of(module: str, folder: Path | None = None) -> Path | None:
    """Return the file of a module of fbl-gym, or of one in a folder; None where there is none."""
    if module.partition(".")[0] in PACKAGES:
        folder = _ROOT
    elif folder is None:
        return None
    path = folder.joinpath(*module.split("."))
    files = (path / "__init__.py", path.with_name(f"{path.name}.py"))
    return next((file for file in files if file.is_file()), None)


def _imported(name: str, path: Path, folder: Path | None) -> Iterator[tuple[str, Path]]:
    """Yield the modules that a module imports and that are followed."""
    for base, attribute in _imports(path.read_bytes(), name, path.name == "__init__.py"):
        for module in _locate(base, attribute, folder):
            file = file_of(module, folder)
            if file is not None and not any(f"{module}.".startswith(f"{skipped}.") for skipped in SKIPPED):
                yield module, file


def _locate(base: str, attribute: str, folder: Path | None) -> list[str]:
    """Return the modules behind `from base import attribute`, or behind `import base`."""
    module = f"{base}.{attribute}" if attribute and file_of(f"{base}.{attribute}", folder) else base
    parts = module.split(".")
    if parts[0] not in PACKAGES:
        return [".".join(parts[:n]) for n in range(1, len(parts) + 1)]
    return [module]


@lru_cache(maxsize=1024)
def _imports(source: bytes, name: str, package: bool) -> tuple[tuple[str, str], ...]:
    """Return the imported modules, each with the attribute of `from module import attribute`."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return ()
    imports = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parent = name.split(".")
            parent = parent[: len(parent) - node.level + package] if node.level else []
            base = ".".join([*parent, *([node.module] if node.module else [])])
            imports += [(base, alias.name) if base else (alias.name, "") for alias in node.names]
    return tuple(imports)
