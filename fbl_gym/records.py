"""Records: frozen dataclasses whose fields declare type, default, unit and bounds once.

Options of the environment and gains of the laws are records. A declaration such as

    @dataclass(frozen=True)
    class Payload(Record):
        mass: float = number(unit="kg", low=0)

gives the checks and their errors, the conversion from plain data (a dict, a number, a list), the tuning range of a gain
and the entry in the documentation. A rule that involves several fields goes into `validate`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from fbl_gym.checks import (
    bounds_text,
    check_choice,
    check_number,
    check_pair,
    check_table,
    check_whole,
    unknown,
)

Built = TypeVar("Built")

_KEY = "declaration"


@dataclass(frozen=True)
class Declaration:
    """The declaration of one field.

    Args:
        convert: a function (name, value) -> value that checks a value and converts plain data.
        form: the valid values in words.
        unit: of the value; empty: none.
        tune: range in which `fbl-gym tune` searches a gain; None: it is not tuned.
    """

    convert: Callable[[str, Any], Any]
    form: str
    unit: str = ""
    tune: tuple[float, float] | None = None


class Record:
    """Base of frozen dataclasses with declared fields."""

    def __post_init__(self) -> None:
        known = declarations(type(self))
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            declaration = known.get(field.name)
            value = getattr(self, field.name)
            if declaration is not None and not (value is None and field.default is None):
                object.__setattr__(self, field.name, declaration.convert(field.name, value))
        self.validate()

    def validate(self) -> None:
        """Refuse values that do not fit together. Called when every field has been checked on its own."""


def _declare(default: Any, declaration: Declaration) -> Any:
    return dataclasses.field(default=default, metadata={_KEY: declaration})


def number(
    default: Any = dataclasses.MISSING,
    *,
    unit: str = "",
    tune: tuple[float, float] | None = None,
    **bounds: Any,
) -> Any:
    """Declare a finite number.

    Args:
        default: None makes the field optional; left out, the field must be given.
        unit: of the number.
        tune: range in which `fbl-gym tune` searches; None: it is not tuned.
        **bounds: `low`, `high`, `above`, as in `check_number`.
    """
    convert = lambda name, value: check_number(name, value, **bounds)  # noqa: E731
    return _declare(default, Declaration(convert, "a number" + bounds_text(**bounds), unit, tune))


def pair(
    default: Any = dataclasses.MISSING,
    *,
    unit: str = "",
    tune: tuple[float, float] | None = None,
    **bounds: Any,
) -> Any:
    """Declare one number per joint; a single number stands for both joints.

    Args:
        default: None makes the field optional; left out, the field must be given.
        unit: of the numbers.
        tune: range in which `fbl-gym tune` searches one number for both joints; None: it is not tuned.
        **bounds: `low`, `high`, `above`, as in `check_number`.
    """
    convert = lambda name, value: check_pair(name, value, **bounds)  # noqa: E731
    return _declare(default, Declaration(convert, "one or two numbers" + bounds_text(**bounds), unit, tune))


def whole(default: Any = dataclasses.MISSING, *, low: int = 0) -> Any:
    """Declare a whole number.

    Args:
        default: None makes the field optional; left out, the field must be given.
        low: smallest valid number.
    """
    convert = lambda name, value: check_whole(name, value, low=low)  # noqa: E731
    return _declare(default, Declaration(convert, f"a whole number not below {low}"))


def choice(default: Any, known: Iterable[str]) -> Any:
    """Declare one of several names.

    Args:
        default: one of them, or None, which makes the field optional.
        known: the valid names.
    """
    known = tuple(known)
    convert = lambda name, value: check_choice(name, value, known)  # noqa: E731
    return _declare(default, Declaration(convert, " or ".join(f'"{name}"' for name in known)))


def table(default: Any = dataclasses.MISSING, *, unit: str = "") -> Any:
    """Declare rows of one number per joint, [n x 2].

    Args:
        default: None makes the field optional; left out, the field must be given.
        unit: of the numbers.
    """
    return _declare(default, Declaration(check_table, "an array [n x 2]", unit))


def record(cls: type, default: Any = dataclasses.MISSING, *, scalar: str | None = None) -> Any:
    """Declare a record, which may be given as a dict of its fields.

    Args:
        cls: class of the record.
        default: None makes the field optional; left out, the field must be given.
        scalar: name of the field that a bare value stands for; None: a bare value is refused.
    """
    form = f"a {cls.__name__}, a dict of its fields" + (f" or its {scalar}" if scalar else "")
    return _declare(default, Declaration(lambda name, value: build(name, value, cls, scalar=scalar), form))


def one_of(classes: tuple[type, ...], default: Any = dataclasses.MISSING) -> Any:
    """Declare one of several records, which may be given as a dict with the record's `kind`, or as the kind alone.

    Args:
        classes: of the records; each has a field `kind`.
        default: None makes the field optional; left out, the field must be given.
    """
    form = " or ".join(f'"{cls.kind}"' for cls in classes)  # type: ignore[attr-defined]
    return _declare(default, Declaration(lambda name, value: build_kind(name, value, classes), f"kind {form}"))


def kind(name: str) -> Any:
    """Declare the field that tells a record from others in plain data.

    Args:
        name: its only valid value.
    """
    return choice(name, (name,))


def declared(default: Any, convert: Callable[[str, Any], Any], form: str, unit: str = "") -> Any:
    """Declare a field with a conversion of its own.

    Args:
        default: None makes the field optional; `dataclasses.MISSING`: the field must be given.
        convert: a function (name, value) -> value that checks a value and converts plain data.
        form: the valid values in words.
        unit: of the value.
    """
    return _declare(default, Declaration(convert, form, unit))


def declarations(cls: type) -> dict[str, Declaration]:
    """Return the declared fields of a record's class, by name.

    A subclass that gives a field a plain default, such as `mass: float = 2.0`, keeps its parent's declaration.

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
        value: what was given.
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
    article = "an" if cls.__name__[0] in "AEIOU" else "a"
    form = f"{article} {cls.__name__}, a dict of its fields ({', '.join(fields)})" + (
        f" or its {scalar}" if scalar else ""
    )
    raise ValueError(f"{name} must be {form}, got {value!r}")


def build_kind(name: str, value: object, classes: tuple[type, ...]) -> Any:
    """Return one of several records, from itself, from a mapping with its `kind`, or from the kind alone.

    Args:
        name: of the argument, for the error.
        value: what was given.
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
