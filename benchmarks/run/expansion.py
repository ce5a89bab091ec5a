"""Expansion of a board's names: policies into members, families into scenarios."""

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.agents.policy import best_seed, shipped
from benchmarks.policies.isolation import CallLimits
from benchmarks.policies.key import data_digest
from benchmarks.policies.spec import PolicyLike, PolicySpec, resolve
from benchmarks.run.cell import plain_options
from benchmarks.text import reason_of
from fbl_gym import Scenario, scenarios
from fbl_gym.reading import read_bytes
from fbl_gym.records.checks import Pair, unknown
from fbl_gym.records.record import merged, naming
from fbl_gym.scenarios import as_scenario
from fbl_gym.scenarios.files import split as split_file


def training(folder: Path) -> tuple[str, int]:
    """Return the settings of a run of `fbl-gym train` without the seed, as text, and the seed."""
    try:
        settings = json.loads(read_bytes(folder / "run.json"))
        seed = settings.pop("seed")
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as problem:
        raise ValueError(f"{folder / 'run.json'} must be as fbl-gym train writes it ({reason_of(problem)})") from None
    return json.dumps(settings, sort_keys=True), seed


def members(
    policies: Iterable[PolicyLike], limits: CallLimits | None = None, *, short: bool = False
) -> tuple[PolicySpec, ...]:
    """Return the members of a board's policies, each with its rows.

    The members of a shipped agent are its training seeds, first that with the smallest validation
    error, which alone is a member if the board is `short`. Folders of `fbl-gym train` whose
    settings differ in the seed alone are members of one row, with the name of the first folder
    without the seed at its end; a second folder of the same settings and seed is a row of its own.
    Any other policy is its only member. NAME and NAME@0 are two rows, both of which have the member
    NAME@0. `limits` are those of loading a policy.
    """
    rows: dict[str, tuple[PolicySpec, ...]] = {}
    runs: dict[str, dict[int, PolicySpec]] = {}
    given = dict.fromkeys(resolve(policy, limits) for policy in policies)
    for spec in given:
        if spec.name in shipped():
            best = best_seed(spec.name)
            seeds = (best, *(seed for seed in shipped()[spec.name] if seed != best and not short))
            rows[spec.name] = tuple(resolve(dataclasses.replace(spec.parsed, seed=seed)) for seed in seeds)
            continue
        if spec.parsed.form == "folder" and Path(spec.name, "run.json").is_file():
            settings, seed = training(Path(spec.name))
            if runs.setdefault(settings, {}).setdefault(seed, spec) is spec:
                continue
        for row in spec.rows or (spec.name,):
            rows[row] = (*rows.get(row, ()), spec)
    for run in runs.values():
        seed, spec = next(iter(run.items()))
        name = spec.name.rstrip("/\\").removesuffix(f"-{seed}") if len(run) > 1 else spec.name
        taken = name in rows or any(name == other.name for other in given)
        rows[spec.name if taken else name] = tuple(run.values())
    specs = dict.fromkeys(spec for row in rows.values() for spec in row)
    return tuple(dataclasses.replace(spec, rows=tuple(row for row in rows if spec in rows[row])) for spec in specs)


def expand(tasks: Sequence[str | Mapping[str, Any] | Scenario]) -> tuple[Scenario, ...]:
    """Return the scenarios of all that `as_scenario` takes, and of names of families.

    A family such as "noise" or "servo-noise" stands for its severities 1 to 3.
    """
    chosen: list[Scenario] = []
    for name in tasks:
        if not isinstance(name, str) or split_file(name)[0] or name.partition("@")[0] in scenarios.names():
            chosen.append(as_scenario(name))
            continue
        family = [member for tier in scenarios.TIERS for member in scenarios.in_tier(tier) if member[:-1] == f"{name}-"]
        if not family:
            raise unknown("scenario or family", name, (*scenarios.families(), *scenarios.names()))
        chosen.extend(map(scenarios.get, family))
    return tuple(chosen)


def distinguish(tasks: Sequence[Scenario]) -> tuple[Scenario, ...]:
    """Return the scenarios, each once, and distinct names for those that share one.

    A name is kept by the scenario that the package has under it, or else by the first one.
    """
    owners: dict[str, str] = {}
    distinct: dict[tuple[str, str], Scenario] = {}
    for task in tasks:
        usual = scenarios.get(task.name) if task.name in scenarios.names() else task
        content, first = (data_digest(plain_options(each, "name", "description")) for each in (task, usual))
        own = owners.setdefault(task.name, first) == content
        distinct[task.name, content] = task if own else task.replace(name=f"{task.name}~{content[:6]}")
    return tuple(distinct.values())


def _whole(x: float) -> float:
    """Return a whole number as an int, which options such as `encoder.latency` ask for."""
    return int(x) if float(x).is_integer() else x


def _scaled(option: str, value: Any, factor: float) -> Any:
    """Return the numbers of an option times a factor."""
    if isinstance(value, Mapping):
        return {name: _scaled(option, each, factor) for name, each in value.items() if each is not None}
    if isinstance(value, list):
        return [_scaled(option, each, factor) for each in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{option} must be numbers to multiply by x{factor:g}, got {value!r}: give values without x")
    return _whole(factor * value)


def with_option(scenario: Scenario, option: str, value: float | Pair, *, factor: bool = False) -> Scenario:
    """Return the scenario with another value of an option, which becomes part of its name.

    `option` is its path as `fbl-gym list options` prints it, such as "noise.position" or
    "disturbance[sine].amplitude". A pair has the values of the two joints. As a factor, a number
    multiplies the scenario's value: of both joints, and of a distribution's ends.
    """
    changes: Any = tuple(map(_whole, value)) if isinstance(value, tuple) else _whole(value)
    if factor:
        given: Any = scenario.to_dict()
        for part in option.split("."):
            given = given.get(part.partition("[")[0]) if isinstance(given, Mapping) else None
        changes = _scaled(option, given, value)  # type: ignore[arg-type]
    for part in reversed(option.split(".")):
        record, _, kind = part.rstrip("]").partition("[")
        changes = {record: {"kind": kind, **changes} if kind and isinstance(changes, Mapping) else changes}
    text = "/".join(f"{x:g}" for x in np.ravel(value))
    name = f"{scenario.name},{option}={'x' if factor else ''}{text}"
    with naming(changes):
        return Scenario.from_dict({**merged(scenario.to_dict(), changes), "name": name})
