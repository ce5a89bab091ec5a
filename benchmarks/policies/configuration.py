"""The gains of a policy as exact data for a key."""

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

_NUMERIC = "biufcSUmM"
"""The kinds of NumPy arrays whose bytes are their content."""


class Inexact(ValueError):
    """A value that has no exact plain form, so that no key can tell it from others."""


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
