"""Every option of the environment, read from its declarations, with values that differ from its default.

A new option is in `FIELDS` without a line here, unless it acts beside another one alone: `BASES`, `OUTER`.
"""

import dataclasses
import re
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass
from functools import cached_property
from typing import Any

from fbl_gym import TABLE_1, ElasticJoint, Reward, Scenario
from fbl_gym.records.record import Declaration, declarations

TABLE, OTHER_TABLE = ((-1.0, 0.5), (-1.5, 0.75)), ((-1.0, 0.5), (-1.25, 0.0))
#: Fields of the same record beside which a record is valid, or a field acts.
BASES = {
    ElasticJoint: {"stiffness": 1e3, "rotor_inertia": 0.5},
    "joint.frequency": {"stiffness": None, "frequency": 1.0},
    "joint.stiffness": {"frequency": None},
    "encoder.low_pass": {"difference": 2},
    "encoder.dropout_length": {"dropout": 0.5},
    "actuator.ripple_order": {"ripple": 1.0},
    "friction.law": {"stiction": 1.0},
    "parameter_error.parameters": {"radius": 0.5},
    "parameter_error.centre": {"centre": 1.0},  # a quarter of it is too near to the hinge of `link`
}

#: Options beside which others act, by the start of their path.
OUTER = {
    "events[friction]": {"friction": {"viscous": 1.0}},
    "limits.command": {"action": "acceleration"},
    "link": {"arm": dataclasses.replace(TABLE_1, gravity=0.0)},  # else 1 Hz is too soft
    "datasheet": {"joint": {"stiffness": 1e3, "rotor_inertia": 0.5}},
}

#: Values of fields whose form is none of those below.
SAMPLES = {
    "parameter_error.ratio": ((2.0, 2.0, 3.0, 3.0), (3.0,) * 4),
    "parameter_error.parameters": (("m1",), ("m2",)),
    "sensors": (("position",), ("position", "velocity")),
}


@dataclass(frozen=True)
class Field:
    """One field of an option.

    Args:
        path: as in the list of options, such as "disturbance[sine].amplitude".
        owner: the record that has the field.
        declaration: of the field.
        default: `MISSING`, if the field must be given.
        base: the fields beside it, with a value of this one if it must be given.
        wrap: a function from fields of the record to the options of an environment.
    """

    path: str
    owner: type
    declaration: Declaration
    default: Any
    base: dict[str, Any]
    wrap: Callable[[dict[str, Any]], dict[str, Any]]

    def __post_init__(self) -> None:
        self.__dict__.update(
            name=self.path.rpartition(".")[2],
            form=(form := self.declaration.form),
            is_record=bool(self.declaration.classes),
            is_whole=form.startswith("a whole number"),
            is_number=form.startswith(("a number", "a whole number", "one or two")) and self.path not in SAMPLES,
            is_pair=form.startswith("one or two"),
            is_table=form == "an array [n x 2]",
            varies="distribution" in form,
            names=re.findall(r'"([^"]+)"', form),
            bounds=[(word, float(x)) for word, x in re.findall(r"(not below|greater than) (\S+)\b", form)],
            highest=[float(x) for x in re.findall(r"not above ([^\s,]+)", form)],
            stream=re.sub(r"\[.*?\]", "", self.path).replace("events.", "events.0."),
            error=re.sub(r"\[.*?\]", "", self.path).replace(".", ": ").replace("events: ", r"events\[0\]: "),
        )

    @cached_property
    def values(self) -> tuple[Any, Any]:
        """Return two valid values, neither of which is the default or that of `base`."""
        if not self.is_number:
            others = [name for name in self.names if name != self.default]
            return (OTHER_TABLE, TABLE) if self.is_table else SAMPLES.get(self.path) or (others[0], others[-1])
        usual = self.base.get(self.name, None if self.default is MISSING else self.default)
        unit = [x or (1 if self.is_whole else 0.125) for x in (usual if isinstance(usual, tuple) else (usual, usual))]
        first, second = ((a * unit[0], b * unit[1]) for a, b in ((2, 3), (4, 5)))
        return (first, second) if self.is_pair else (first[0], second[0])

    def options(self, **values: Any) -> dict[str, Any]:
        """Return the options of an environment with the base of this field, and these fields of the record."""
        outer = [options for start, options in OUTER.items() if self.path.startswith(start)]
        return {key: x for options in (*outer, self.wrap({**self.base, **values})) for key, x in options.items()}

    def given(self, value: Any) -> dict[str, Any]:
        """Return the options of an environment with a value of this field."""
        return self.options(**{self.name: value})


def fields(cls: type, path: str = "", wrap: Any = dict) -> Iterator[Field]:
    """Yield every declared field of a record and of the records in it."""
    known = declarations(cls)
    defaults = {field.name: field.default for field in dataclasses.fields(cls)}
    base = {"kind": cls.kind} if hasattr(cls, "kind") else {}
    for name in known:
        if defaults[name] is MISSING:
            base[name] = TABLE if known[name].form == "an array [n x 2]" else 1.0
    base |= BASES.get(cls, {})
    for name in known.keys() - {"kind"}:
        field = Field(path + name, cls, known[name], defaults[name], {**base, **BASES.get(path + name, {})}, wrap)
        yield field
        for inner in known[name].classes:
            kind = f"[{inner.kind}]" if hasattr(inner, "kind") else ""
            yield from fields(inner, f"{path}{name}{kind}.", _inside(field))


def _inside(field: Field) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return a function from fields of the record that a field holds to the options of an environment."""
    return lambda values: field.wrap({**field.base, field.name: [values] if field.path == "events" else values})


FIELDS = sorted(
    [*fields(Scenario), *fields(Reward, "reward.", lambda values: {"reward": values})], key=lambda field: field.path
)
LEAVES = [field for field in FIELDS if not field.is_record]
NUMBERS = [field for field in LEAVES if field.is_number]
VARYING = [field for field in NUMBERS if field.varies]
