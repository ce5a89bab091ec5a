"""`fbl-gym list`: all names with one line each."""

import argparse
import contextlib
import itertools
import re
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module

from gymnasium.error import DependencyNotInstalled

import controllers
from benchmarks.run.suite import SUITES
from benchmarks.text import reason_of, visible
from controllers.composition import gain_name
from controllers.parts import PARTS
from fbl_gym import Reward, Scenario, scenarios
from fbl_gym.records.descriptions import Description, describe
from fbl_gym.scenarios.classes import CLASSES


def _policy(name: str) -> str:
    try:
        return f"{controllers.summary(name)}  [{controllers.kind(name)}, access: {controllers.access(name)}]"
    except Exception as problem:  # an installed package may be broken
        return f"cannot be loaded: {reason_of(problem)}"


def _scenarios() -> dict[str, str]:
    """Return each scenario, with one entry for all severities of a family, and for a practice."""
    texts = {f"{robot}-practice-FAMILY-1, -3": scenarios.TIERS[f"{robot}-practice"] for robot in CLASSES}
    named = (name for name in scenarios.names() if "-practice-" not in name)
    for _, group in itertools.groupby(named, lambda name: re.sub(r"-\d$", "", name)):
        first, *others = group
        last = f"{',' if len(others) == 1 else ' to'} {others[-1][-2:]}" if others else ""
        texts[first + last] = scenarios.get(first).description
    return texts


def _gains() -> dict[str, str]:
    """Return the gains of each law whose extra is installed, then those of the parts."""
    texts: dict[str, str] = {}
    for name in controllers.names():
        if controllers.kind(name) == "classical":
            with contextlib.suppress(ImportError, DependencyNotInstalled):
                texts |= _lines(describe(controllers.factory(name), f"{name}."))  # type: ignore[arg-type]
    for name, part in PARTS.items():
        texts |= _lines(describe(part, f"+{name} {gain_name(name, '')}"))
    return texts


def options() -> list[Description]:
    """Return the description of each option of the environment and of each of its fields."""
    return [*describe(Scenario), *describe(Reward, "reward.")]


def _lines(fields: Iterable[Description]) -> dict[str, str]:
    """Return the description of each field in one line."""
    texts = {}
    for field in fields:
        unit = f" [{field.unit}]" if field.unit else ""
        default = field.default if field.default == "required" else f"default {field.default}"
        tune = f"tuned within {field.tune}" if field.tune else ""
        texts[field.path] = "; ".join(filter(None, (field.form + unit, default, tune, field.meaning)))
    return texts


LISTS: dict[str, Callable[[], Mapping[str, str]]] = {
    "policies": lambda: {name: _policy(name) for name in controllers.names()},
    "scenarios": _scenarios,
    "suites": lambda: SUITES,
    "claims": lambda: {
        name: claim.texts["claim"] for name, claim in import_module("benchmarks.paper.claims").CLAIMS.items()
    },
    "options": lambda: _lines(options()),
    "gains": _gains,
}


def run(arguments: argparse.Namespace) -> int:
    """Print the lists."""
    for what in (arguments.what,) if arguments.what else LISTS:
        texts = LISTS[what]()
        if arguments.what is None:
            print(f"{what}:")
        name_width = max(map(len, texts), default=0) + 2
        for name, text in texts.items():
            print(visible(f"{name:<{name_width}}{text}"))
    return 0
