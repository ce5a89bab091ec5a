"""Records: frozen dataclasses whose fields declare type, default, unit and bounds once.

Options of the environment and gains of the laws are records. A declaration such as

    @dataclass(frozen=True)
    class Payload(Record):
        mass: float = number(unit="kg", low=0)

gives the checks and their errors, the conversion from plain data (a dict, a number, a list), the
tuning range of a gain and the entry in the documentation (`descriptions.py`). A rule that involves
several fields goes into `validate`.

The functions that declare a field share these arguments: `default`, without which the field must be
given, and which makes it optional if it is None; `unit`; `tune`, the range in which `fbl-gym tune`
searches a gain; `optional`, True if None is valid whatever the default; and the bounds `low`,
`high` and `above` of `check_number`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass
from typing import Any, TypeVar

from fbl_gym.checks import (
    bounds_text,
    check_choice,
    check_choices,
    check_number,
    check_pair,
    check_table,
    check_whole,
    unknown,
)

Built = TypeVar("Built")
Range = tuple[float, float]

_KEY = "declaration"


@dataclass(frozen=True)
class Declaration:
    """The declaration of one field.

    Args:
        convert: a function (name, value) -> value that checks a value and converts plain data.
        form: the valid values in words.
        unit: of the value; empty: none.
        tune: range in which `fbl-gym tune` searches a gain; None: it is not tuned.
        optional: True if None is valid.
        classes: the records that the field may hold.
    """

    convert: Callable[[str, Any], Any]
    form: str
    unit: str = ""
    tune: Range | None = None
    optional: bool = False
    classes: tuple[type, ...] = ()


class Record:
    """Base of frozen dataclasses with declared fields."""

    def __post_init__(self) -> None:
        for name, declaration in declarations(type(self)).items():  # type: ignore[arg-type]
            value = getattr(self, name)
            if not (value is None and declaration.optional):
                object.__setattr__(self, name, declaration.convert(name, value))
        self.validate()

    def validate(self) -> None:
        """Refuse values that do not fit together. Called after each field has been checked."""


def declared(
    default: Any,
    convert: Callable[[str, Any], Any],
    form: str,
    unit: str = "",
    *,
    tune: Range | None = None,
    optional: bool = False,
    classes: tuple[type, ...] = (),
) -> Any:
    """Declare a field with its own conversion.

    Args:
        default: `dataclasses.MISSING`: the field must be given.
        convert: a function (name, value) -> value that checks a value and converts plain data.
        form: the valid values in words.
        unit: of the value.
        tune: range of a gain.
        optional: True if None is valid, whatever the default.
        classes: the records that the field may hold.
    """
    declaration = Declaration(convert, form, unit, tune, optional or default is None, classes)
    return dataclasses.field(default=default, metadata={_KEY: declaration})


def number(
    default: Any = MISSING, *, unit: str = "", tune: Range | None = None, optional: bool = False, **bounds: Any
) -> Any:
    """Declare a finite number."""
    convert = lambda name, value: check_number(name, value, **bounds)  # noqa: E731
    return declared(default, convert, "a number" + bounds_text(**bounds), unit, tune=tune, optional=optional)


def pair(
    default: Any = MISSING, *, unit: str = "", tune: Range | None = None, optional: bool = False, **bounds: Any
) -> Any:
    """Declare one number per joint; a single number stands for both joints."""
    convert = lambda name, value: check_pair(name, value, **bounds)  # noqa: E731
    return declared(default, convert, "one or two numbers" + bounds_text(**bounds), unit, tune=tune, optional=optional)


def whole(default: Any = MISSING, *, low: int = 0) -> Any:
    """Declare a whole number not below `low`."""
    convert = lambda name, value: check_whole(name, value, low=low)  # noqa: E731
    return declared(default, convert, f"a whole number not below {low}")


def choice(default: Any, known: Iterable[str]) -> Any:
    """Declare one of several names."""
    known = tuple(known)
    convert = lambda name, value: check_choice(name, value, known)  # noqa: E731
    return declared(default, convert, _names(known))


def choices(default: Any, known: Iterable[str]) -> Any:
    """Declare some of several names, held in the order of `known`; one name stands alone."""
    known = tuple(known)
    convert = lambda name, value: check_choices(name, value, known)  # noqa: E731
    return declared(default, convert, "some of " + ", ".join(known))


def table(default: Any = MISSING, *, unit: str = "") -> Any:
    """Declare rows of one number per joint, [n x 2]."""
    return declared(default, check_table, "an array [n x 2]", unit)


def record(cls: type, default: Any = MISSING, *, scalar: str | None = None) -> Any:
    """Declare a record, which may be given as a dict of its fields.

    Args:
        cls: class of the record.
        default: None makes the field optional; left out, the field must be given.
        scalar: name of the field that a bare value stands for; None: a bare value is refused.
    """
    form = _either((_article(cls), "a dict of its fields", *([f"its {scalar}"] if scalar else [])))
    return declared(default, lambda name, value: build(name, value, cls, scalar=scalar), form, classes=(cls,))


def one_of(classes: tuple[type, ...], default: Any = MISSING) -> Any:
    """Declare one of several records, given as the record, a dict with its `kind`, or its kind.

    Args:
        classes: of the records; each has a field `kind`.
        default: None makes the field optional; left out, the field must be given.
    """
    form = "a dict with a kind of " + _names(cls.kind for cls in classes)  # type: ignore[attr-defined]
    return declared(default, lambda name, value: build_kind(name, value, classes), form, classes=classes)


def kind(name: str) -> Any:
    """Declare the field that names the kind of a record in plain data."""
    return choice(name, (name,))


def _names(known: Iterable[str]) -> str:
    return _either([f'"{name}"' for name in known])


def _either(texts: Sequence[str]) -> str:
    """Return "a, b or c"."""
    return " or ".join(filter(None, (", ".join(texts[:-1]), texts[-1])))


def _article(cls: type) -> str:
    return f"{'an' if cls.__name__[0] in 'AEIOU' else 'a'} {cls.__name__}"


@functools.cache
def declarations(cls: type) -> dict[str, Declaration]:
    """Return the declared fields of a record's class, by name.

    A subclass that gives a field a plain default, such as `mass: float = 2.0`, keeps its parent's
    declaration.

    Args:
        cls: a dataclass.
    """
    fields = [field for base in reversed(cls.__mro__) for field in vars(base).get("__dataclass_fields__", {}).values()]
    return {field.name: field.metadata[_KEY] for field in fields if _KEY in field.metadata}


def tuning_ranges(cls: type) -> dict[str, tuple[float, float]]:
    """Return the tuning range of each gain that has one, by name.

    Args:
        cls: class of a law.
    """
    return {name: d.tune for name, d in declarations(cls).items() if d.tune is not None}


def build(name: str, value: object, cls: type[Built], *, scalar: str | None = None) -> Built:
    """Return a record from a record, from a mapping of its fields, or from the value of one field.

    Args:
        name: of the argument, for the error.
        value: the value given.
        cls: class of the record.
        scalar: name of the field that a bare value stands for; None: a bare value is refused.
    """
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
    form = f"{_article(cls)}, a dict of its fields ({', '.join(fields)})" + (f" or its {scalar}" if scalar else "")
    raise ValueError(f"{name} must be {form}, got {value!r}")


def build_kind(name: str, value: object, classes: tuple[type, ...]) -> Any:
    """Return one of several records, from itself, a mapping with its `kind`, or its kind.

    Args:
        name: of the argument, for the error.
        value: the value given.
        classes: of the records; each has a field `kind`.
    """
    if isinstance(value, classes):
        return value
    by_kind = {cls.kind: cls for cls in classes}  # type: ignore[attr-defined]
    if isinstance(value, str):
        value = {"kind": value}
    if not isinstance(value, Mapping) or "kind" not in value:
        known = ", ".join(sorted(by_kind))
        raise ValueError(f"{name} must be one of its records, or a dict with a 'kind' of {known}, got {value!r}")
    if not isinstance(value["kind"], str) or value["kind"] not in by_kind:
        raise unknown(f"kind of {name}", value["kind"], by_kind)
    return build(name, value, by_kind[value["kind"]])


def set_fields(record: object, **values: object) -> None:
    """Set fields of a frozen record, from its `validate` or `__post_init__`.

    Args:
        record: whose fields are set.
        **values: by name.
    """
    for name, value in values.items():
        object.__setattr__(record, name, value)
