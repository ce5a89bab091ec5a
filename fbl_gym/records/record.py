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
searches a gain; `varies`, True if a `Distribution` is valid in place of a number; `optional`, True
if None is valid whatever the default; the bounds `low`, `high` and `above` of `check_number`; and
`kernel`, `scale` and `none`, by which the value reaches the kernel, see `Declaration`.
"""

import contextlib
import dataclasses
import functools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass
from typing import Any, ClassVar, TypeAlias, TypeVar, dataclass_transform

import numpy as np

from fbl_gym.records import checks
from fbl_gym.records.checks import Pair

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
        optional: True if None is valid.
        classes: the records that the field may hold.
        varies: True if a distribution is valid.
        kernel: name under which the kernel has the value; empty: it has not.
        dtype: of the kernel's number.
        scale: the kernel's number / the value, or a function of the scenario that returns it.
        none: the kernel's value in place of None; None: it keeps its zero.
        names: the valid names, which the kernel numbers in this order.
    """

    convert: Callable[[str, Any], Any]
    form: str
    unit: str = ""
    tune: Pair | None = None
    optional: bool = False
    classes: tuple[type, ...] = ()
    varies: bool = False
    kernel: str = ""
    dtype: Any = float
    scale: float | Callable[[Any], float] = 1.0
    none: Any = None
    names: tuple[str, ...] = ()

    def number(self, value: Any, scenario: Any) -> Any:
        """Return the kernel's number of a value: a number, a distribution, or a pair of them."""
        if self.names:
            return self.names.index(value)
        return scaled(value, self.scale(scenario) if callable(self.scale) else self.scale)


class Record:
    """Base of frozen dataclasses with declared fields.

    Attributes:
        kind: the record's name in plain data, for records that take turns in one field.
    """

    kind: str

    def __post_init__(self) -> None:
        for name, declaration in declarations(type(self)).items():  # type: ignore[arg-type]
            value = getattr(self, name)
            if not (value is None and declaration.optional):
                object.__setattr__(self, name, declaration.convert(name, value))
        self.validate()

    def validate(self) -> None:
        """Refuse values that do not fit together. Called after each field has been checked."""


@dataclass_transform(frozen_default=True)
class Option(Record):
    """Base of the records of a task, from whose declarations the kernel's memory follows.

    Its subclasses are frozen dataclasses without a decorator. The argument `kind` of a class, such
    as `class Drop(Option, kind="drop")`, declares its field `kind`.

    The kernel gets each field that declares `kernel`, the name of its number there: from a setting,
    or, if it varies, from a row of a block, which each episode fills. `pack` writes other numbers.

    Attributes:
        derived: the types of the settings that `pack` writes, by name.
        drawn: the types of the numbers that may vary and that `pack` writes, by name.
    """

    derived: ClassVar[Mapping[str, Any]] = {}
    drawn: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls, kind: str | None = None) -> None:
        if kind is not None:
            cls.kind, cls.__annotations__["kind"] = choice(kind, (kind,)), str
        dataclass(frozen=True)(cls)

    def check(self, scenario: Any) -> None:
        """Refuse values that do not fit the rest of a scenario."""

    def pack(self, packer: Any) -> None:
        """Write `derived` and `drawn` by the packer of `kernel/memory/program.py`.

        Options that share a setting add to it, so that their order does not matter.
        """

    def facts(self, scenario: Any) -> dict[str, Any]:  # noqa: ARG002
        """Return what policies are told, as fields of `Interface`."""
        return {}


def steps(scenario: Any) -> float:
    """Return the scale of a time that the kernel counts in physics steps."""
    return 1 / scenario.physics_dt


def declared(
    default: Any, convert: Callable[[str, Any], Any], form: str, *, optional: bool = False, **more: Any
) -> Any:
    """Declare a field with its own conversion; see `Declaration`."""
    declaration = Declaration(convert, form, optional=optional or default is None, **more)
    return dataclasses.field(default=default, metadata={_KEY: declaration})


def number(default: Any = MISSING, *, varies: bool = False, joints: bool = False, **options: Any) -> Any:
    """Declare a finite number; with `joints`, one or two, where one stands for both joints."""
    bounds = {name: options.pop(name) for name in ("low", "high", "above") if name in options}
    check: Any = functools.partial(_check_varying if varies else checks.check_number, **bounds)
    form = ("a number or distribution" if varies else "a number") + checks.bounds_text(**bounds)
    if joints:
        form = form.replace("a number", "one or two numbers").replace("distribution", "distributions")
        check = functools.partial(checks.check_pair, check=check)
    return declared(default, check, form, varies=varies, dtype=(float, 2) if joints else float, **options)


#: Declare one number per joint; a single number or distribution stands for both joints.
pair = functools.partial(number, joints=True)


def whole(default: Any = MISSING, *, low: int = 0, high: float = math.inf, varies: bool = False, **options: Any) -> Any:
    """Declare a whole number within bounds; draws of a distribution are to be rounded."""
    check = functools.partial(_check_varying, check=checks.check_whole) if varies else checks.check_whole
    convert = functools.partial(check, low=low, high=high)
    form = f"a whole number{' or distribution' * varies}{checks.bounds_text(low, high)}"
    return declared(default, convert, form, varies=varies, dtype=float if varies else int, **options)


def choice(default: Any, known: Iterable[str], **options: Any) -> Any:
    """Declare one of several names."""
    known = tuple(known)
    check = functools.partial(checks.check_choice, known=known)
    return declared(default, check, _names(known), dtype=int, names=known, **options)


def choices(default: Any, known: Iterable[str]) -> Any:
    """Declare some of several names, held in the order of `known`; one name stands alone."""
    known = tuple(known)
    return declared(default, functools.partial(checks.check_choices, known=known), "some of " + ", ".join(known))


def table(default: Any = MISSING, *, unit: str = "") -> Any:
    """Declare rows of one number per joint, [n x 2]."""
    return declared(default, checks.check_table, "an array [n x 2]", unit=unit)


def record(cls: type, default: Any = MISSING, *, scalar: str | None = None, none: Any = None) -> Any:
    """Declare a record, which may be given as a dict of its fields.

    `scalar` is the field that a bare value stands for; without it, a bare value is refused.
    """
    form = either((_article(cls), "a dict of its fields", *([f"its {scalar}"] if scalar else [])))
    return declared(default, functools.partial(build, cls=cls, scalar=scalar), form, classes=(cls,), none=none)


def one_of(classes: tuple[type, ...], default: Any = MISSING) -> Any:
    """Declare one of several records with a field `kind`, given as itself, a dict or its kind."""
    form = "a dict with a kind of " + _names(cls.kind for cls in classes)  # type: ignore[attr-defined]
    return declared(default, functools.partial(build_kind, classes=classes), form, classes=classes)


def _names(known: Iterable[str]) -> str:
    return either([f'"{name}"' for name in known])


def either(texts: Sequence[str], word: str = "or") -> str:
    """Return "a, b or c"."""
    return f" {word} ".join(filter(None, (", ".join(texts[:-1]), texts[-1])))


def _article(cls: type) -> str:
    return f"{'an' if cls.__name__[0] in 'AEIOU' else 'a'} {cls.__name__}"


def _check_values(name: str, value: object, above: float | None = None) -> tuple[float, ...]:
    """Return one number or more."""
    if not isinstance(value, list | tuple | np.ndarray) or len(value) == 0:
        raise ValueError(f"{name} must be a list of numbers, got {value!r}")
    return tuple(checks.check_number(f"{name}[{i}]", each, above=above) for i, each in enumerate(value))


@dataclass(frozen=True)
class Distribution(Record):
    """A number that each episode draws anew, such as {"uniform": [0, 5]}. One field is given.

    Args:
        uniform: lowest and highest value.
        log_uniform: lowest and highest value of a number whose logarithm is uniform.
        choice: values with the same chance each.
    """

    uniform: Pair | None = declared(None, _check_values, "two numbers in order")
    log_uniform: Pair | None = declared(
        None, functools.partial(_check_values, above=0.0), "two numbers in order, greater than 0"
    )
    choice: tuple[float, ...] | None = declared(None, _check_values, "one number or more")

    def validate(self) -> None:
        """Refuse none and several fields, and a range without two ends in order."""
        if sum(value is not None for value in vars(self).values()) != 1:
            raise ValueError(f"give one of {', '.join(vars(self))}, got {self}")
        if self.choice is None and (len(self.values) != 2 or self.values[0] > self.values[1]):
            raise ValueError(f"a range must be two numbers in order, got {self.values}")

    @property
    def values(self) -> tuple[float, ...]:
        """Return the two ends, or the values of a choice."""
        return self.uniform or self.log_uniform or self.choice or ()


def is_distribution(value: object) -> bool:
    """Return True for the plain data of a distribution."""
    return isinstance(value, Mapping) and len(value) > 0 and value.keys() <= Distribution.__dataclass_fields__.keys()


#: A number of an option that may vary.
Number: TypeAlias = float | Distribution | Mapping[str, Sequence[float]]

#: One such number per joint, or one for both.
Numbers: TypeAlias = Number | tuple[Number, Number]


def ends(value: Any) -> Pair:
    """Return the lowest and the highest value of a number, a distribution, or a pair of them."""
    if isinstance(value, tuple):
        each = [ends(item) for item in value]
        return min(low for low, _ in each), max(high for _, high in each)
    values = value.values if isinstance(value, Distribution) else (value,)
    return min(values), max(values)


def scaled(value: Any, scale: float) -> Any:
    """Return a number, a distribution, or a pair of them, times a positive scale."""
    if isinstance(value, tuple):
        return tuple(scaled(each, scale) for each in value)
    if not isinstance(value, Distribution):
        return value * scale
    values = {name: each and tuple(x * scale for x in each) for name, each in vars(value).items()}
    return Distribution(**values)


def middle(value: Any) -> float:
    """Return the middle of a number or distribution: of the logarithms, if it is log-uniform."""
    low, high = ends(value)
    logarithmic = isinstance(value, Distribution) and value.log_uniform is not None
    return math.sqrt(low * high) if logarithmic else (low + high) / 2


def _check_varying(name: str, value: object, check: Any = checks.check_number, **bounds: Any) -> float | Distribution:
    """Return a number, or a distribution whose values are all within the bounds."""
    if not isinstance(value, Distribution | Mapping):
        return check(name, value, **bounds)
    distribution = build(name, value, Distribution)
    for each in distribution.values:
        checks.check_number(f"{name}, a distribution,", each, **bounds)
    return distribution


@functools.cache
def declarations(cls: type) -> dict[str, Declaration]:
    """Return the declared fields of a record's class, by name.

    A subclass that gives a field a plain default, such as `mass: float = 2.0`, keeps its parent's
    declaration.
    """
    fields = [field for base in reversed(cls.__mro__) for field in vars(base).get("__dataclass_fields__", {}).values()]
    return {field.name: field.metadata[_KEY] for field in fields if _KEY in field.metadata}


def tuning_ranges(cls: type) -> dict[str, Pair]:
    """Return the tuning range of each gain of a law's class that has one, by name."""
    return {name: d.tune for name, d in declarations(cls).items() if d.tune is not None}


def build(name: str, value: object, cls: type[Built], *, scalar: str | None = None) -> Built:
    """Return a record from a record, from a mapping of its fields, or from the value of one field.

    `scalar` is the field that a bare value stands for; None: a bare value is refused. `name` is
    that of the argument, for the error.
    """
    if isinstance(value, cls):
        return value
    fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    if isinstance(value, Mapping) and not (scalar and is_distribution(value)):
        given = dict(value)
    elif scalar is not None and not isinstance(value, str):
        given = {scalar: value}
    else:
        form = f"{_article(cls)}, a dict of its fields ({', '.join(fields)})" + (f" or its {scalar}" if scalar else "")
        raise ValueError(f"{name} must be {form}, got {value!r}")
    for key in given:
        if key not in fields:
            raise checks.unknown(f"field of {name}", key, fields)
    required = (name for name, field in fields.items() if (field.default, field.default_factory) == (MISSING, MISSING))
    if lacking := [name for name in required if name not in given]:
        raise ValueError(f"{name} must give {either(lacking, 'and')}, got {given!r}")
    try:
        return cls(**given)
    except ValueError as problem:
        raise ValueError(f"{name}: {problem}") from None


def build_kind(name: str, value: object, classes: tuple[type, ...]) -> Any:
    """Return one of several records, from itself, a mapping with its `kind`, or its kind."""
    if isinstance(value, classes):
        return value
    by_kind = {cls.kind: cls for cls in classes}  # type: ignore[attr-defined]
    if isinstance(value, str):
        value = {"kind": value}
    if not isinstance(value, Mapping) or "kind" not in value:
        known = ", ".join(sorted(by_kind))
        raise ValueError(f"{name} must be one of its records, or a dict with a 'kind' of {known}, got {value!r}")
    return build(name, value, by_kind[checks.check_choice(f"kind of {name}", value["kind"], by_kind)])


def merged(base: Any, changes: Any) -> Any:
    """Return plain data with changes, table by table; the base is left alone.

    A distribution, and a table of another `kind`, replace the base's value.
    """
    tables = isinstance(base, Mapping) and isinstance(changes, Mapping)
    if not tables or is_distribution(changes) or changes.get("kind", base.get("kind")) != base.get("kind"):
        return changes
    return {**base, **{name: merged(base.get(name), value) for name, value in changes.items()}}


@contextlib.contextmanager
def naming(options: Mapping[str, Any]) -> Iterator[None]:
    """Add the paths of given options to a `ValueError` that names none of them.

    An option may be at fault for what another one becomes, such as an arm for the torque limit of
    its class.
    """
    try:
        yield
    except ValueError as problem:
        given = [*_paths(options)]
        if {path.rpartition(".")[2] for path in given} & {*re.findall(r"\w+", str(problem))} or not given:
            raise
        raise ValueError(f"given {', '.join(given[:5])}: {str(problem).removeprefix('scenario: ')}") from None


def _paths(options: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for name, value in options.items():
        if isinstance(value, Mapping) and value and not is_distribution(value):
            yield from _paths(value, f"{above}{name}.")
        elif name not in ("name", "description", "kind"):
            yield f"{above}{name}"


def set_fields(record: object, **values: object) -> None:
    """Set fields of a frozen record, from its `validate` or `__post_init__`."""
    for name, value in values.items():
        object.__setattr__(record, name, value)
