"""Options as plain data: frozen records, built from themselves or from the dict, number or name that makes one.

Every error names the argument, the value and the right form, with the nearest known name where one was mistyped.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import numpy as np

Record = TypeVar("Record")
Pair = tuple[float, float]


_MANY = 20
"""So many names an error lists; of more, the nearest."""


def hint(name: object, known: Iterable[str]) -> str:
    """What may have been meant, as the end of an error: the nearest known name, or those that have it in them."""
    names = sorted(known)
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5) or [n for n in names if str(name) in n][:3]
    return f"; did you mean {' or '.join(map(repr, near))}?" if near and str(name) else ""


def unknown(what: str, name: object, known: Iterable[str]) -> ValueError:
    """The error for a name that is not known: the nearest that is, and a list of all, or of those near it."""
    names = sorted(known)
    meant = hint(name, names)
    shown, more = names, ""
    if meant and len(names) > _MANY:
        shown = difflib.get_close_matches(str(name), names, n=_MANY // 2, cutoff=0.0)
        more = f" and {len(names) - len(shown)} more"
    return ValueError(f"unknown {what} {name!r}{meant or '.'} Known: {', '.join(shown) or 'none'}{more}")


def choice(name: str, value: object, known: Iterable[str]) -> str:
    """`value`, if it is one of the known names."""
    known = tuple(known)
    if not isinstance(value, str) or value not in known:
        raise unknown(name, value, known)
    return value


def number(
    name: str, value: object, *, low: float = -math.inf, high: float = math.inf, above: float | None = None
) -> float:
    """`value` as a float within [low, high] and greater than `above`."""
    right = "a finite number"
    if above is not None:
        right += f" greater than {above:g}"
    elif low > -math.inf:
        right += f" not below {low:g}"
    if high < math.inf:
        right += f" and not above {high:g}"
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise ValueError(f"{name} must be {right}, got {value!r}")
    x = float(value)
    if not math.isfinite(x) or x < low or x > high or (above is not None and x <= above):
        raise ValueError(f"{name} must be {right}, got {value!r}")
    return x


def whole(name: str, value: object, *, low: int = 0) -> int:
    """`value` as an int not below `low`."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer) or value < low:
        raise ValueError(f"{name} must be a whole number not below {low}, got {value!r}")
    return int(value)


def pair(name: str, value: object, **limits: Any) -> Pair:
    """One number per joint; a single number stands for both."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        if len(value) != 2:
            raise ValueError(f"{name} must be one number, or one for each of the two joints, got {value!r}")
        return number(f"{name}[0]", value[0], **limits), number(f"{name}[1]", value[1], **limits)
    x = number(name, value, **limits)
    return x, x


def table(name: str, value: object) -> tuple[Pair, ...]:
    """Rows of one number per joint, [n x 2], as nested tuples (which survive JSON, hash and compare)."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of shape [n x 2], got {value!r}") from None
    if array.ndim != 2 or array.shape[1] != 2 or len(array) == 0:
        raise ValueError(f"{name} must be an array of shape [n x 2] with n > 0, got shape {array.shape}")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array).all(axis=1))[0, 0])
        raise ValueError(f"{name} must be finite, got {array[row]} in row {row}")
    return tuple((float(x), float(y)) for x, y in array)


def build(name: str, value: object, cls: type[Record], *, scalar: str | None = None) -> Record:
    """A `cls` from a `cls`, from a mapping of its fields, or, where `scalar` names a field, from that field's value."""
    if isinstance(value, cls):
        return value
    fields = [f.name for f in dataclasses.fields(cls)]  # type: ignore[arg-type]
    if isinstance(value, Mapping):
        for key in value:
            if key not in fields:
                raise unknown(f"field of {name}", key, fields)
        try:
            return cls(**value)
        except TypeError as problem:
            raise ValueError(f"{name} must have the fields of {cls.__name__}: {problem}; got {dict(value)!r}") from None
        except ValueError as problem:
            raise ValueError(f"{name}: {problem}") from None
    if scalar is not None and not isinstance(value, str):
        try:
            return cls(**{scalar: value})
        except ValueError as problem:
            raise ValueError(f"{name}: {problem}") from None
    article = "an" if cls.__name__[0] in "AEIOU" else "a"
    form = f"{article} {cls.__name__}, a dict of its fields ({', '.join(fields)})" + (
        f" or its {scalar}" if scalar else ""
    )
    raise ValueError(f"{name} must be {form}, got {value!r}")


def build_kind(name: str, value: object, kinds: tuple[type, ...]) -> Any:
    """One of several records, told apart by their field `kind`: from itself, or from a mapping with a `kind`."""
    if isinstance(value, kinds):
        return value
    by_kind = {cls.kind: cls for cls in kinds}  # type: ignore[attr-defined]
    if isinstance(value, str):
        value = {"kind": value}
    if not isinstance(value, Mapping) or "kind" not in value:
        known = ", ".join(sorted(by_kind))
        raise ValueError(f"{name} must be one of its records, or a dict with a 'kind' of {known}, got {value!r}")
    if not isinstance(value["kind"], str) or value["kind"] not in by_kind:
        raise unknown(f"kind of {name}", value["kind"], by_kind)
    return build(name, value, by_kind[value["kind"]])


def settle(record: object, **values: object) -> None:
    """Store checked values on a frozen record, from its `__post_init__`."""
    for name, value in values.items():
        object.__setattr__(record, name, value)
