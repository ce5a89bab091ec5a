"""The arguments of the commands, which `commands.toml` declares, and the types of their values."""

import argparse
import contextlib
import os
import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from benchmarks.seeds import SPLITS

COMMANDS: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")
)
SHARED, EXTRAS = COMMANDS.pop("shared"), COMMANDS.pop("extras")
"""The commands, the arguments that several have, and the modules that each extra installs."""

CORES = os.cpu_count() or 1


def count(text: str, most: int = 1_000_000, why: str = "") -> int:
    """Return a whole number, from 1 to `most`; `why` explains the latter."""
    if not text.isdecimal() or int(text[:20]) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, 1 or more, got {text!r}")
    if int(text[:20]) > most:
        raise argparse.ArgumentTypeError(f"must be at most {most}{why}, got {text!r}")
    return int(text)


def bounded(most: float, text: str) -> float:
    """Return a number from 0 to the `most`."""
    with contextlib.suppress(ValueError):
        if 0.0 <= (number := float(text)) <= most:
            return number
    raise argparse.ArgumentTypeError(f"must be a number from 0 to {most:g}, got {text!r}")


def file_path(endings: Sequence[str], text: str) -> Path:
    """Return the path of a file that can be written."""
    path = Path(text)
    if path.suffix not in endings:
        raise argparse.ArgumentTypeError(f"must end in {' or '.join(endings)}, got {text!r}")
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"must be a file, got {text!r}, which is a folder")
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        raise argparse.ArgumentTypeError(f"must be a file that can be written, got {text!r}: none can be in {folder}")
    return path


TYPES: dict[str, Callable[[str], Any]] = {
    "int": int, "float": float, "Path": Path, "count": count,
    "episodes": partial(count, most=len(SPLITS["test"]), why=", the test seeds there are"),
    "processes": partial(count, most=max(64, 4 * CORES), why=", four for each core"),
    "degrees": partial(bounded, 180.0), "samples": partial(bounded, 1e3),
}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser, entries: Mapping[str, Mapping[str, Any]]) -> None:
    """Add the arguments of a command, by name, to its parser."""
    groups: dict[str, Any] = defaultdict(parser.add_mutually_exclusive_group)
    for name, changes in entries.items():
        fields = {field: _value(field, value) for field, value in (SHARED.get(name, {}) | changes).items()}
        target = groups[fields.pop("group")] if "group" in fields else parser
        if endings := fields.pop("endings", None):
            fields |= {"type": partial(file_path, endings), "metavar": "FILE"}
            fields["help"] += f": {' or '.join(endings)}"
        target.add_argument(name, **fields)


def _value(field: str, value: Any) -> Any:
    """Return what the value of a field stands for."""
    if field == "metavar" and isinstance(value, list):
        return tuple(value)
    if field == "type" and value in TYPES:
        return TYPES[value]
    return resolve_name(value) if isinstance(value, str) and re.fullmatch(r"[\w.]+:[\w.]+", value) else value


def trust(arguments: argparse.Namespace) -> None:
    """Turn the texts of the policies among the arguments into names.

    With `--trust`, their code may run. A Python file or module that is typed needs no permission.
    """
    from controllers.name import PolicyName  # imports NumPy, which the list of commands does without

    parse = partial(PolicyName.parse, trusted=arguments.trust)
    for option in ("policies", "policy"):
        if given := getattr(arguments, option, None):
            setattr(arguments, option, parse(given) if isinstance(given, str) else [*map(parse, given)])
