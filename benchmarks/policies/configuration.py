"""The gains of a policy: those that its text gives, and all of them as exact data for a key."""

import dataclasses
import hashlib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

_NUMERIC = "biufcSUmM"
"""The kinds of NumPy arrays whose bytes are their content."""


class Inexact(ValueError):
    """A value that has no exact plain form, so that no key can tell it from others."""


def parse_gain(text: str) -> tuple[str, Any]:
    """Return a gain and its value, of "kp=25" or, with one number for each joint, "kp=25,30"."""
    name, _, value = text.partition("=")
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if not name or len(numbers) not in (1, 2):
        raise ValueError(f"must be such as kp=25, or kp=25,30 for the two joints, got {text!r}")
    return name, numbers[0] if len(numbers) == 1 else np.array(numbers)


def gains_file(law: str, path: str | Path) -> Path:
    """Return the file with the gains of a law: a .json file itself, or LAW.json in a folder."""
    name = re.sub(r"[^\w.+-]+", "_", Path(law).name) + ".json"
    return Path(path) if str(path).endswith(".json") else Path(path) / name


def read_gains(law: str, given: tuple[str, ...]) -> dict[str, Any]:
    """Return the gains of a law, of NAME=VALUE, a file or a folder each; the last value counts."""
    gains: dict[str, Any] = {}
    for text in given:
        if "=" in text:
            gains.update([parse_gain(text)])
            continue
        path = gains_file(law, text)
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            values = {
                name: np.array(value) if isinstance(value, list) else float(value)
                for name, value in data.get("gains", data).items()
            }
        except FileNotFoundError:
            raise ValueError(f"gains of {law}: there is no file {path}; `fbl-gym tune` writes one") from None
        except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as problem:
            raise ValueError(f'{path} must be JSON with numbers, such as {{"kp": 25}}: {problem}') from None
        expect_law(law, path, data)
        gains |= values
    return gains


def expect_law(law: str, path: Path, data: Mapping[str, Any]) -> None:
    """Refuse the gains of a file that names another law.

    A law in a file is the same law where one of both paths ends with the other.
    """
    tuned = data.get("policy", law)
    parts = zip(*(reversed([x for x in Path(name).parts if x != ".."]) for name in (str(tuned), law)), strict=False)
    if any(one != other for one, other in parts):
        raise ValueError(f"{path} has the gains of {tuned}, not of {law}: name another file or folder")


def configuration(policy: Any) -> dict[str, Any]:
    """Return the attribute `configuration`, or the fields without interface and environment.

    Raises:
        Inexact: a field holds a value that cannot be compared exactly.
    """
    fields = getattr(policy, "configuration", None)
    if not isinstance(fields, Mapping):
        names = [field.name for field in dataclasses.fields(policy)] if dataclasses.is_dataclass(policy) else []
        fields = {name: getattr(policy, name) for name in names if name not in ("interface", "env")}
    return {name: exact(value, f"{type(policy).__name__}.{name}") for name, value in fields.items()}


def exact(value: Any, name: str) -> Any:
    """Return a value as data that JSON keeps exactly; an array becomes a hash of its bytes."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float) and type(value) is float:
        return value if math.isfinite(value) else {"float": repr(value)}
    if isinstance(value, bytes):
        return {"bytes": hashlib.sha256(value).hexdigest()}
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in _NUMERIC:
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return {"array": value.dtype.str, "shape": list(value.shape), "sha256": digest}
    if isinstance(value, tuple | list):
        return [exact(item, f"{name}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: exact(value[key], f"{name}[{key!r}]") for key in sorted(value)}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: exact(getattr(value, f.name), f"{name}.{f.name}") for f in dataclasses.fields(value)}
        return {"type": type(value).__qualname__, "fields": fields}
    raise Inexact(
        f"{name} must be a number, text, a NumPy array of numbers, or tuples, dictionaries and dataclasses of these, so that "
        f"results can be told apart, got {type(value).__name__}: build it from such fields in a cached_property"
    )
