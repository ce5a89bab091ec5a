"""Checks of single values. Every error names the argument, the value and the right form.

The checks share these arguments: `name`, of the argument, for the error; `value`, the value given;
`known`, the valid names; and the bounds `low` (smallest valid number), `high` (largest) and `above`
(every valid number is greater; None: no such bound). They return the value, converted to one type.
"""

import contextlib
import difflib
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

Pair = tuple[float, float]

#: An error lists at most this many names; of more, the three nearest.
MAX_NAMES = 20


def nearest(name: object, known: Iterable[str]) -> str:
    """Return the end of an error that suggests the name nearest to `name`, or an empty text."""
    names = sorted(known)
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5) or [n for n in names if str(name) in n][:3]
    return f"; did you mean {' or '.join(map(repr, near))}?" if near and str(name) else ""


def unknown(what: str, name: object, known: Iterable[str]) -> ValueError:
    """Return the error for a name that is not known, with the nearest valid names.

    `what` is the kind of thing that was named, such as "policy".
    """
    names = sorted(known)
    few = len(names) <= MAX_NAMES
    near = ", ".join(names if few else difflib.get_close_matches(str(name), names, n=3, cutoff=0.0)) or "none"
    return ValueError(f"unknown {what} {name!r}{nearest(name, names) or '.'} {'Known' if few else 'Nearest'}: {near}")


def check_choice(name: str, value: object, known: Iterable[str]) -> str:
    """Return `value` if it is one of the known names."""
    known = tuple(known)
    if not isinstance(value, str) or value not in known:
        raise unknown(name, value, known)
    return value


def check_choices(name: str, value: object, known: Iterable[str]) -> tuple[str, ...]:
    """Return names as a tuple in the order of the known ones; a single name stands alone.

    The argument's name is a plural.
    """
    known = tuple(known)
    if not isinstance(value, str | list | tuple | set | frozenset):
        raise ValueError(f"{name} must be names out of {known}, got {value!r}")
    given = (value,) if isinstance(value, str) else tuple(value)
    for each in given:
        check_choice(name.removesuffix("s"), each, known)
    return tuple(each for each in known if each in given)


def check_flag(name: str, value: object) -> bool:
    """Return a value that is True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return value


def bounds_text(low: float = -math.inf, high: float = math.inf, above: float | None = None) -> str:
    """Return bounds in words, such as " greater than 0"; an empty text if there are none."""
    lowest = f" not below {low:g}" if low > -math.inf else ""
    least = lowest if above is None else f" greater than {above:g}"
    most = f" not above {high:g}" if high < math.inf else ""
    return " and".join(filter(None, (least, most)))


def as_printed(value: Any) -> float:
    """Return a float; 0.01 in single precision divides an episode as 0.01 does, and becomes it."""
    single = isinstance(value, np.floating) and not isinstance(value, float)
    return float(np.format_float_scientific(value) if single else value)


def check_number(
    name: str, value: object, *, low: float = -math.inf, high: float = math.inf, above: float | None = None
) -> float:
    """Return `value` as a finite float within its bounds; one of NumPy counts as it is printed."""
    x = math.nan
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            x = as_printed(value)
    if not math.isfinite(x) or x < low or x > high or (above is not None and x <= above):
        raise ValueError(f"{name} must be a finite number{bounds_text(low, high, above)}, got {value!r}")
    return x


def check_whole(name: str, value: object, *, low: int = 0, high: float = math.inf) -> int:
    """Return `value` as an int within its bounds."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number{bounds_text(low, high)}, got {value!r}")
    return int(value)


def check_pair(name: str, value: object, check: Callable[..., Any] = check_number, **bounds: Any) -> Any:
    """Return one number per joint, each checked; a single number stands for both joints."""
    if isinstance(value, np.ndarray):
        value = [*value] if value.ndim else value[()]
    if isinstance(value, list | tuple):
        if len(value) != 2:
            raise ValueError(f"{name} must be one number, or one for each of the two joints, got {value!r}")
        return check(f"{name}[0]", value[0], **bounds), check(f"{name}[1]", value[1], **bounds)
    x = check(name, value, **bounds)
    return x, x


def check_table(name: str, value: object) -> tuple[Pair, ...]:
    """Return rows of one number per joint, [n x 2], as nested tuples.

    Tuples can be hashed and compared, and survive JSON.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} must be an array of shape [n x 2], got {value!r}") from None
    if array.ndim != 2 or array.shape[1] != 2 or len(array) == 0:
        raise ValueError(f"{name} must be an array of shape [n x 2] with n > 0, got shape {array.shape}")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array).all(axis=1))[0, 0])
        raise ValueError(f"{name} must be finite, got {array[row]} in row {row}")
    return tuple((float(x), float(y)) for x, y in array)
