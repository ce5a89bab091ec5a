"""Scenarios by name, from TOML files and from tables, which may change a base.

A table has the fields of `Scenario`. Its entry `base` names another scenario or file, with which
the table is merged, record by record. `false` switches an option off. Where the base is of a class
of robots and the arm is another one, torques and payloads follow it, except in "mujoco-lab".

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
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fbl_gym.model.arm import ArmParameters
from fbl_gym.model.urdf import FILE, RobotFile, read_robot
from fbl_gym.reading import read_text
from fbl_gym.records.checks import check_choice, unknown
from fbl_gym.records.record import build, merged, naming
from fbl_gym.scenarios.scenario import Scenario, as_arm
from fbl_gym.scenarios.tiers import MEMBERS, TIERS, in_tier, tier_scenario
from fbl_gym.scenarios.worlds import in_world

#: Centres of mass farther from a link's joint, in its lengths, are taken for a mistake of units.
#:
#: Counterweights, and arms that logs identify, may lie somewhat outside of their links.
FARTHEST = 1.5

#: Longer links [m] are taken for a mistake of units.
LONGEST = 10.0


class UnitsWarning(UserWarning):
    """A number of an arm that looks like a mistake of units."""


_FILE = re.compile(r"(?P<path>.+\.toml)(:(?P<entry>[^:@]+))?(@(?P<world>.+))?$")


def split(text: str) -> tuple[str, str, str]:
    """Return the file, the entry or name, and the world that a text names, each may be empty."""
    if match := _FILE.match(text):
        return match["path"], match["entry"] or "", match["world"] or ""
    name, _, world = text.partition("@")
    return "", name, world


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file."""
    try:
        return tomllib.loads(read_text(path).removeprefix("\ufeff"))  # which Notepad begins a file with
    except (tomllib.TOMLDecodeError, RecursionError) as problem:
        raise ValueError(f"{path} is no TOML: {problem}") from None


def load(path: Path, entry: str, above: tuple[str, ...] = ()) -> Scenario:
    """Return the scenario of a file. Without a name in it, the file's name is the scenario's.

    Args:
        path: of a TOML file.
        entry: name of one of the file's `scenarios`, if it is a suite; empty: the whole file.
        above: the files whose base this one is.
    """
    if (place := f"{path.resolve()}:{entry}") in above:
        raise ValueError(f"{path}: base must be another scenario, but leads back to this file")
    table = read_toml(path)
    if entry:
        names = [each if isinstance(each, str) else each.get("name") for each in table.get("scenarios", ())]
        check_choice(f"scenario of {path}", entry, filter(None, names))
        table = table["scenarios"][names.index(entry)]
        if isinstance(table, str):
            return get(table)
    elif "scenarios" in table:
        raise ValueError(f"{path} is a suite: give it to --suite, or name one of its scenarios, {path}:NAME")
    return from_table({"name": path.stem, **table}, path, (*above, place))


def from_table(table: Mapping[str, Any], path: Path | None = None, above: tuple[str, ...] = ()) -> Scenario:
    """Return the scenario of a table: fields of `Scenario`, and optionally `base`.

    The path is that of the table's file, for errors and for relative paths; None: it has none.
    `above` is that of `load`.
    """
    folder = path.parent if path else Path()
    fields = {name: _off(value) for name, value in table.items() if name != "base"}
    base = table.get("base", "")
    file, entry, world = split(str(base))
    parent = load(folder / file, entry, above) if file else Scenario()
    arm = fields.get("arm")
    try:
        if not isinstance(base, str) or (file and world):
            raise ValueError(f"base must be a name, or a .toml file without a world, got {base!r}")
        if base and not file:
            parent = get(base)
        if isinstance(arm, Mapping) and arm.keys() & {"mass", "length"}:
            if mixed := arm.keys() & {"m1", "m2", "L1", "L2"}:
                raise ValueError(f"arm must have mass and length, or m1, m2, L1 and L2, got also {min(mixed)}")
            fields["arm"] = dataclasses.asdict(as_arm("arm", arm))
        if isinstance(arm, str) and FILE.match(arm):
            fields["arm"] = arm = read_robot(str(folder / arm))
        with naming(fields):
            if "arm" in fields:
                given = as_arm("arm", merged(parent.to_dict()["arm"], fields["arm"]))
                for doubt in () if isinstance(arm, str) else _doubts(given):  # before an error that follows from it
                    doubt = doubt.partition("; beside")[0] if isinstance(arm, RobotFile) else doubt
                    warnings.warn(f"{path or 'arm'}: {doubt}", UnitsWarning, stacklevel=2)
                if not file and entry in MEMBERS and world != "mujoco-lab":
                    try:
                        parent = tier_scenario(entry, given)
                    except ValueError:  # such as of joints that need the shorter physics step of the table
                        parent = tier_scenario(entry, given, **{n: x for n, x in fields.items() if n == "physics_dt"})
                    parent = in_world(parent, world) if world else parent
                fields = arm.options(fields, parent.to_dict()) if isinstance(arm, RobotFile) else fields
            own = f"{fields['name']}: " if "name" in fields else ""
            fields.setdefault("description", f"{own}{parent.name} with other options")
            return build("scenario", merged(parent.to_dict(), fields), Scenario)
    except ValueError as problem:
        raise ValueError(f"{path}: {str(problem).removeprefix('scenario: ')}" if path else str(problem)) from None


def _off(data: Any) -> Any:
    """Return plain data with None in place of False, since TOML has no None."""
    if isinstance(data, Mapping):
        return {name: _off(value) for name, value in data.items()}
    return None if data is False else data


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


#: The file of each scenario of the paper's figures and of laboratories' arms.
_FILES = {
    table["name"]: file
    for file in (Path(__file__).with_name("paper.toml"), Path(__file__).with_name("real.toml"))
    for table in read_toml(file)["scenarios"]
}


def names() -> tuple[str, ...]:
    """Return every name that `get` knows: the paper's figures, laboratories' arms, tiers."""
    return (*_FILES, *MEMBERS)


def get(name: str) -> Scenario:
    """Return the scenario of a name or a file.

    Args:
        name: one of `names()`; the TOML file of a scenario; or "FILE:NAME", a scenario of a suite's
            file. Each may end in "@" and one of `WORLDS`: "everything-2@mujoco-lab".
    """
    path, entry, world = split(name)
    if path:
        scenario = load(Path(path), entry)
    elif entry in MEMBERS:
        scenario = tier_scenario(entry)
    elif entry in _FILES:
        scenario = load(_FILES[entry], entry)
    elif entry in TIERS:
        some = f"such as {in_tier(entry)[0]!r}; scenarios.in_tier({entry!r}) names all"
        raise ValueError(f"scenario must be one scenario, got the tier {entry!r}: take one of it, {some}")
    elif FILE.match(entry):
        raise ValueError(
            f"scenario must be a name or a TOML file, got a robot's file: write arm = {entry!r} in a TOML file"
        )
    else:
        raise unknown("scenario", entry, names())
    return in_world(scenario, world) if world else scenario


def as_scenario(value: Any) -> Scenario:
    """Return a scenario from itself, its name, its file or its plain data; None: the nominal one.

    Plain data may have a `base`, as `from_table` describes.
    """
    if isinstance(value, str | Path):
        return get(str(value))
    if isinstance(value, Mapping) and "base" in value:
        return from_table(value)
    if isinstance(value, list | tuple):
        raise ValueError(f"scenario must be one scenario, got {len(value)}: gym.make_vec takes a list")
    return Scenario() if value is None else build("scenario", value, Scenario)
