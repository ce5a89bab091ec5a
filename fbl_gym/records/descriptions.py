"""Documentation of records, from the declarations of their fields and their docstrings."""

import dataclasses
import inspect
import re
from collections.abc import Iterator
from dataclasses import MISSING
from typing import NamedTuple

from fbl_gym.records.record import declarations


class Description(NamedTuple):
    """The documentation of one field, in words.

    Args:
        path: name of the field, after those of the fields that lead to it, such as
            "friction.viscous" or "disturbance[sine].amplitude".
        form: the valid values.
        unit: of the value; empty: none.
        default: "required" if the field must be given.
        meaning: from the docstring of the record's class.
        tune: range in which `fbl-gym tune` searches a gain; empty: it is not tuned.
    """

    path: str
    form: str
    unit: str
    default: str
    meaning: str
    tune: str


def describe(cls: type, path: str = "", described: set[type] | None = None) -> Iterator[Description]:
    """Yield the documentation of the declared fields of a class, and of the records in them.

    A record that several fields may hold is described once, at the first of them. `path` is the
    text before each field's name, `described` are the records that are described elsewhere.
    """
    described = set() if described is None else described
    meanings = argument_texts(cls)
    defaults = {field.name: field.default for field in dataclasses.fields(cls)}
    for name, d in declarations(cls).items():
        if name == "kind":
            continue
        default = "required" if defaults[name] is MISSING else _text(defaults[name])
        form = d.form + (", or None" if d.optional else "")
        tune = f"{d.tune[0]:g} to {d.tune[1]:g}" if d.tune else ""
        yield Description(path + name, form, d.unit, default, meanings.get(name, ""), tune)
        for inner in d.classes:
            if inner not in described:
                described.add(inner)
                by_kind = f"[{inner.kind}]" if hasattr(inner, "kind") else ""
                yield from describe(inner, f"{path}{name}{by_kind}.", described)


def _text(value: object) -> str:
    """Return a default in words."""
    if dataclasses.is_dataclass(value):
        return getattr(value, "kind", type(value).__name__ + "()")
    if isinstance(value, tuple):
        return ", ".join(map(_text, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def argument_texts(cls: type) -> dict[str, str]:
    """Return each field's meaning from the section `Args:` of a class and its bases, by name."""
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        _, _, section = (inspect.cleandoc(vars(base).get("__doc__") or "")).partition("\nArgs:\n")
        section = re.split(r"\n(?=\S)", section)[0]
        for entry in re.split(r"\n(?=    \S)", section):
            names, colon, text = entry.strip().partition(": ")
            texts |= {name: " ".join(text.split()) for name in names.split(", ") if colon}
    return texts
