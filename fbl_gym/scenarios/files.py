"""Scenarios from TOML files and tables, which may change a base.

A table has the fields of `Scenario`. Its entry `base` names another scenario or file, with which
the table is merged, record by record. `false` switches an option off. Where the base is of a class
of robots and the arm is another one, torques and payloads follow it.

    base = "servo-everything-2"
    noise.position = 1e-4
    friction = false

    [arm]
    m1 = 12.0

An arm with the fields of `Links`, in kg, m and kg m^2, replaces the arm of the base.
"""

import dataclasses
import re
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from fbl_gym.checks import unknown
from fbl_gym.model.arm import ArmParameters
from fbl_gym.reading import read_text
from fbl_gym.records import build, merged, naming
from fbl_gym.scenarios import classes
from fbl_gym.scenarios.scenario import Scenario, as_arm

Named = Callable[[str], Scenario]
"""The function `scenarios.get`."""

FARTHEST = 1.5
"""Centres of mass farther from a link's joint, in its lengths, are taken for a mistake of units.

Counterweights, and arms that logs identify, may lie somewhat outside of their links."""

LONGEST = 10.0
"""Longer links [m] are taken for a mistake of units."""


class UnitsWarning(UserWarning):
    """A number of an arm that looks like a mistake of units."""


_FILE = re.compile(r"(?P<path>.+\.toml)(:(?P<entry>[^:@]+))?(@(?P<world>.+))?$")


def split(text: str) -> tuple[str, str, str]:
    """Return the file, the entry and the world that a text names; three empty texts: no file."""
    match = _FILE.match(text)
    return ("", "", "") if match is None else (match["path"], match["entry"] or "", match["world"] or "")


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file."""
    try:
        return tomllib.loads(read_text(path))
    except (tomllib.TOMLDecodeError, RecursionError) as problem:
        raise ValueError(f"{path} is no TOML: {problem}") from None


def load(path: Path, entry: str, named: Named, above: tuple[str, ...] = ()) -> Scenario:
    """Return the scenario of a file. Without a name in it, the file's name is the scenario's.

    Args:
        path: of a TOML file.
        entry: name of one of the file's `scenarios`, if it is a suite; empty: the whole file.
        named: returns a scenario by name.
        above: the files whose base this one is.
    """
    if (place := f"{path.resolve()}:{entry}") in above:
        raise ValueError(f"{path}: base must be another scenario, but leads back to this file")
    table = read_toml(path)
    if entry:
        names = [each if isinstance(each, str) else each.get("name") for each in table.get("scenarios", ())]
        if entry not in names:
            raise unknown(f"scenario of {path}", entry, filter(None, names))
        table = table["scenarios"][names.index(entry)]
        if isinstance(table, str):
            return named(table)
    elif "scenarios" in table:
        raise ValueError(f"{path} is a suite: give it to --suite, or name one of its scenarios, {path}:NAME")
    return from_table({"name": path.stem, **table}, named, path, (*above, place))


def from_table(
    table: Mapping[str, Any], named: Named, path: Path | None = None, above: tuple[str, ...] = ()
) -> Scenario:
    """Return the scenario of a table: fields of `Scenario`, and optionally `base`.

    The path is that of the table's file, for errors and for relative paths; None: it has none. The
    other arguments are those of `load`.
    """
    folder = path.parent if path else Path()
    fields = {name: value for name, value in table.items() if name != "base"}
    base = table.get("base", "")
    file, entry, world = split(str(base))
    parent = load(folder / file, entry, named, above) if file else Scenario()
    if ".urdf" in str(arm := fields.get("arm")):
        fields["arm"] = str(folder / str(arm))
    try:
        if not isinstance(base, str) or (file and world):
            raise ValueError(f"base must be a name, or a .toml file without a world, got {base!r}")
        if base and not file:
            parent = named(base)
        if isinstance(arm, Mapping) and arm.keys() & {"mass", "length"}:
            if mixed := arm.keys() & {"m1", "m2", "L1", "L2"}:
                raise ValueError(f"arm must have mass and length, or m1, m2, L1 and L2, got also {min(mixed)}")
            fields["arm"] = dataclasses.asdict(as_arm("arm", arm))
        with naming(fields):
            if "arm" in fields:
                given = build("scenario", {"arm": merged(parent.to_dict()["arm"], fields["arm"])}, Scenario).arm
                for doubt in _doubts(given):  # before an error that follows from the mistake
                    warnings.warn(f"{path or 'arm'}: {doubt}", UnitsWarning, stacklevel=2)
                parent = classes.get(str(base), given) if base in classes.MEMBERS else parent
            fields.setdefault("description", f"{parent.name} with other options")
            return build("scenario", merged(parent.to_dict(), fields), Scenario)
    except ValueError as problem:
        raise ValueError(f"{path}: {str(problem).removeprefix('scenario: ')}" if path else str(problem)) from None


def _doubts(arm: ArmParameters) -> Iterator[str]:
    """Yield sentences on numbers of an arm that look like mistakes of units."""
    lengths, centres, inertias = (arm.L1, arm.L2), arm.centre, arm.inertia
    for link, (length, centre, inertia) in enumerate(zip(lengths, centres, inertias, strict=True), 1):  # type: ignore[arg-type]
        if length > LONGEST:
            yield f"link {link} is {length:g} m long; lengths are in m"
        if abs(centre) > FARTHEST:
            yield (
                f"the centre of mass of link {link} is {centre:.3g} link lengths from its joint; "
                "beside m1 and L1, arm.centre is a share of the length; beside arm.mass, it is in m"
            )
        if inertia > 1.0:
            yield (
                f"the inertia of link {link} is {inertia:.3g} times its mass times its length squared; "
                "beside m1 and L1, arm.inertia is that share; beside arm.mass, it is in kg m^2"
            )
