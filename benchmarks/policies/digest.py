"""Digests of code: equal for sources that differ only in comments, docstrings and layout.

The modules that a result depends on are found by reading import statements, without running
anything.
"""

from __future__ import annotations

import ast
import hashlib
import io
import tokenize
from collections.abc import Iterator, Mapping
from functools import lru_cache
from importlib import metadata
from pathlib import Path

import controllers
from controllers.registry import ENTRY_POINTS

PACKAGES = ("benchmarks", "controllers", "fbl_gym")
"""The packages of fbl-gym. Their modules are followed wherever they are imported."""

SKIPPED = (
    "benchmarks.policies",
    "controllers.catalogue",
    "controllers.registry",
    "fbl_gym.picture",
    "fbl_gym.render",
    "fbl_gym.scenarios.families",
    "fbl_gym.scenarios.paper",
)
"""Modules that choose a policy, draw pictures, or hold scenarios.

The first two change no number. A scenario's options are part of the key themselves.
"""

_CORE = ("benchmarks.run", "controllers", "fbl_gym")
_ROOT = Path(__file__).resolve().parents[2]
_LAYOUT = (tokenize.COMMENT, tokenize.NL, tokenize.ENCODING, tokenize.ENDMARKER)
_BLOCKS = {tokenize.NEWLINE: "\n", tokenize.INDENT: "{", tokenize.DEDENT: "}"}
_FSTRING = (getattr(tokenize, "FSTRING_START", -1), getattr(tokenize, "FSTRING_END", -1))


def code_digest(modules: Mapping[str, Path]) -> str:
    """Return a hash of the code of some modules, each a name and its file."""
    lines = [f"{name} {source_digest(path.read_bytes())}" for name, path in sorted(modules.items())]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


@lru_cache(maxsize=1024)
def source_digest(source: bytes) -> str:
    """Return a hash of the tokens of a Python source; of its bytes where it is not valid Python."""
    try:
        text = "\0".join(_statements(source.decode()))
    except (SyntaxError, tokenize.TokenError, UnicodeDecodeError):
        return hashlib.sha256(source).hexdigest()
    return hashlib.sha256(text.encode()).hexdigest()


def _statements(source: str) -> Iterator[str]:
    """The tokens of a source, without those of statements that are nothing but a string."""
    statement: list[str] = []
    only_strings = True
    for kind, text in _tokens(source):
        if kind in _BLOCKS:
            if statement and not only_strings:
                yield from statement
                yield _BLOCKS[tokenize.NEWLINE]
            if kind != tokenize.NEWLINE:
                yield _BLOCKS[kind]
            statement, only_strings = [], True
        else:
            statement.append(text)
            only_strings &= kind == tokenize.STRING


def _tokens(source: str) -> Iterator[tuple[int, str]]:
    """Kind and text of each token that is code; an f-string is one token."""
    lines = source.splitlines(keepends=True)
    depth, begin = 0, (0, 0)
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == _FSTRING[0]:
            begin = begin if depth else token.start
            depth += 1
        elif token.type == _FSTRING[1]:
            depth -= 1
            if not depth:
                yield tokenize.NAME, _slice(lines, begin, token.end)
        elif not depth and token.type not in _LAYOUT:
            # Before Python 3.12 an f-string is a string, but no docstring.
            formatted = token.type == tokenize.STRING and "f" in token.string.lower().partition(token.string[-1])[0]
            yield tokenize.NAME if formatted else token.type, token.string


def _slice(lines: list[str], begin: tuple[int, int], end: tuple[int, int]) -> str:
    text = lines[begin[0] - 1 : end[0]]
    text[-1] = text[-1][: end[1]]
    text[0] = text[0][begin[1] :]
    return "".join(text)


def closure(roots: Mapping[str, Path], folder: Path | None = None) -> dict[str, Path]:
    """Return some modules with all that they import, each a name and its file.

    Only modules of fbl-gym and modules that lie in a folder are followed. A module outside of
    fbl-gym that contains the name of a registered policy as a string, such as "cascade-flm",
    depends on the module of that policy.

    Args:
        roots: the modules to begin with.
        folder: where modules outside of fbl-gym are looked for; None: nowhere.
    """
    modules = dict(roots)
    left = list(roots.items())
    while left:
        for name, path in _imported(*left.pop(), folder):
            if path not in modules.values():
                modules[name] = path
                left.append((name, path))
    return modules


def file_of(module: str, folder: Path | None = None) -> Path | None:
    """Return the file of a module by its full name; None where there is none."""
    if module.partition(".")[0] in PACKAGES:
        return _package_file(module)
    return None if folder is None else _file(module, folder)


@lru_cache(maxsize=4096)
def _package_file(module: str) -> Path | None:
    return _file(module, _ROOT)


def _file(module: str, folder: Path) -> Path | None:
    place = folder.joinpath(*module.split("."))
    files = (place / "__init__.py", place.with_name(f"{place.name}.py"))
    return next((file for file in files if file.is_file()), None)


def _imported(name: str, path: Path, folder: Path | None) -> Iterator[tuple[str, Path]]:
    """The modules that a module imports and that are followed."""
    for base, attribute in _imports(path.read_bytes(), name, path.name == "__init__.py"):
        for module in _locate(base, attribute, folder):
            file = file_of(module, folder)
            if file is not None and not any(f"{module}.".startswith(f"{skipped}.") for skipped in SKIPPED):
                yield module, file


def _locate(base: str, attribute: str, folder: Path | None) -> list[str]:
    """The modules behind `from base import attribute`, or behind `import base`."""
    module = f"{base}.{attribute}" if attribute and file_of(f"{base}.{attribute}", folder) else base
    parts = module.split(".")
    if parts[0] not in PACKAGES:
        return [".".join(parts[:n]) for n in range(1, len(parts) + 1)]
    file = file_of(module)
    # The __init__ files of fbl-gym only gather names.
    if attribute and module == base and file is not None and file.name == "__init__.py":
        for source, name in _imports(file.read_bytes(), base, True):
            if name == attribute:
                return _locate(source, name, folder)
    return [module]


@lru_cache(maxsize=1024)
def _imports(source: bytes, name: str, package: bool) -> tuple[tuple[str, str], ...]:
    """What a module imports: the module and, of `from module import attribute`, the attribute."""
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
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and not name.startswith(_CORE):
            imports += [(module, "") for module in _policy_modules().get(node.value, ())]
    return tuple(imports)


@lru_cache(maxsize=1)
def _policy_modules() -> dict[str, tuple[str, ...]]:
    """The module of each registered policy, by the policy's name."""
    external = {point.name for point in entry_points() if point.module.partition(".")[0] not in PACKAGES}
    return {name: (controllers.factory(name).__module__,) for name in controllers.names() if name not in external}


@lru_cache(maxsize=1)
def entry_points() -> tuple[metadata.EntryPoint, ...]:
    """Return the entry points by which installed packages register policies."""
    return tuple(metadata.entry_points(group=ENTRY_POINTS))
