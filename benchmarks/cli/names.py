"""`fbl-gym list`: all names with one line each, and the documentation's page of options."""

import argparse
import contextlib
import itertools
import re
import shutil
import sys
from collections.abc import Callable, Mapping

import controllers
from benchmarks.paper import claims
from benchmarks.policies.apart import reason_of
from benchmarks.run.suite import SUITES
from controllers.composition import PARTS, gain_name
from fbl_gym import Reward, Scenario, scenarios
from fbl_gym.descriptions import Description, describe


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "what", nargs="?", choices=tuple(LISTS),
        help="the list to print (all); a terminal gets one line for each name, a file or a pipe the whole text",
    )  # fmt: skip
    parser.add_argument("--markdown", action="store_true", help="print the options as a page for the documentation")


def _policies() -> dict[str, str]:
    return {name: _policy(name) for name in controllers.names()}


def _policy(name: str) -> str:
    try:
        return f"{controllers.summary(name)}  [{controllers.kind(name)}, access: {controllers.access(name)}]"
    except Exception as problem:  # an installed package may be broken
        return f"cannot be loaded: {reason_of(problem)}"


def _scenarios() -> dict[str, str]:
    """Return each scenario, with one entry for all severities of a family."""
    severities: dict[str, list[str]] = {}
    for name in scenarios.names():
        member = scenarios.member(name)
        one = member is None or not name.endswith(f"-{member.severity}")
        severities.setdefault(name if one else name[:-2], []).append(name)
    texts = {}
    for each in severities.values():
        last = f", {each[-1][-2:]}" if len(each) == 2 else f" to {each[-1][-2:]}"
        texts[each[0] + (last if each[1:] else "")] = scenarios.get(each[0]).description
    return texts


def _lines(*fields: Description) -> dict[str, str]:
    return {field.path: _line(field) for field in fields}


def _gains() -> dict[str, str]:
    """Return the gains of each law whose extra is installed, then those of the parts."""
    texts: dict[str, str] = {}
    for name in controllers.names():
        if controllers.kind(name) == "classical":
            with contextlib.suppress(ImportError):
                texts |= _lines(*describe(controllers.factory(name), f"{name}."))  # type: ignore[arg-type]
    for name, part in PARTS.items():
        texts |= _lines(*describe(part, f"+{name} {gain_name(name, '')}"))
    return texts


def options() -> list[Description]:
    """Return the description of each option of the environment and of each of its fields."""
    return [*describe(Scenario), *describe(Reward, "reward.")]


def _line(field: Description) -> str:
    """Return a field's description in one line."""
    unit = f" [{field.unit}]" if field.unit else ""
    default = field.default if field.default == "required" else f"default {field.default}"
    tune = f"tuned within {field.tune}" if field.tune else ""
    return "; ".join(filter(None, (field.form + unit, default, tune, field.meaning)))


def options_page() -> str:
    """Return the documentation's page of options, in Markdown."""
    text = """# All options

`gym.make` and `Scenario` take each option as a record or as plain data: `friction={"viscous": 1.0}`. The field
`disturbance[sine].amplitude` is given by `disturbance={"kind": "sine", "amplitude": 10.0}`. One number for a field
of two numbers is the value of both joints.

`fbl-gym list options` prints this list, and `fbl-gym list options --markdown` this page.
"""
    for option, fields in itertools.groupby(options(), lambda field: re.split(r"[.\[]", field.path)[0]):
        text += f"\n## `{option}`\n\n| field | valid values | unit | default | meaning |\n|---|---|---|---|---|\n"
        for field in fields:
            cells = (f"`{field.path}`", field.form, field.unit, field.default, field.meaning)
            text += "| " + " | ".join(cell.replace("|", "\\|").replace("*", "\\*") for cell in cells) + " |\n"
    return text


LISTS: dict[str, Callable[[], Mapping[str, str]]] = {
    "policies": _policies,
    "scenarios": _scenarios,
    "suites": lambda: SUITES,
    "claims": claims.listed,
    "options": lambda: _lines(*options()),
    "gains": _gains,
}


def run(arguments: argparse.Namespace) -> int:
    """Print the lists."""
    if arguments.markdown:
        if arguments.what != "options":
            raise ValueError(f"--markdown needs the list 'options', got {arguments.what!r}")
        print(options_page(), end="")
        return 0
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    for what in (arguments.what,) if arguments.what else LISTS:
        texts = LISTS[what]()
        if arguments.what is None:
            print(f"{what}:")
        name_width = max(map(len, texts), default=0) + 2
        for name, text in texts.items():
            line = f"{name:<{name_width}}{text}"
            print(line if width is None or len(line) <= width else line[: width - 1] + "…")
    return 0
