"""The command `fbl-gym completion`."""

import argparse
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import shtab

from benchmarks.cli.parser import COMMANDS, prepare
from benchmarks.paper.claims import CLAIMS
from benchmarks.policies.spec import names as policy_names
from benchmarks.run.suite import SUITES
from fbl_gym import scenarios

SHELLS = ("bash", "zsh", "fish")

KNOWN: Mapping[str, tuple[Callable[[], Iterable[str]], bool]] = {
    "policy": (policy_names, True),
    "policies": (policy_names, True),
    "scenario": (scenarios.names, False),
    "scenarios": (lambda: {**scenarios.families(), **dict.fromkeys(scenarios.names())}, False),
    "suite": (lambda: SUITES, True),
    "only": (lambda: CLAIMS, False),
}
"""The names that complete an argument, by the argument's name, and whether files complete it
too."""

_BREAKS = "# So that POLICY@tuned is one word.\nCOMP_WORDBREAKS=${COMP_WORDBREAKS//@}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS, help="the shell; docs/tutorials.md says where to put its script")


def run(arguments: argparse.Namespace) -> int:
    shell = arguments.shell
    print(shtab.complete(_everything(), shell, preamble=_BREAKS if shell == "bash" else ""))
    return 0


def _everything() -> argparse.ArgumentParser:
    """Return all commands in one parser, with the completions of each argument."""
    whole = argparse.ArgumentParser(prog="fbl-gym")
    commands = whole.add_subparsers()
    for name, command in COMMANDS.items():
        try:
            parser, _ = prepare(name)
        except ModuleNotFoundError:  # its extra is not installed, so its options are unknown
            commands.add_parser(name, help=command.help)
            continue
        for action in parser._actions:
            names, files = KNOWN.get(action.dest, (None, False))
            if files and names is not None:
                action.complete = _or_files(action.dest, names())  # type: ignore[attr-defined]
            elif names is not None:
                action.choices = tuple(names())
            elif action.metavar in ("DIR", "FILE"):
                action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
        commands.add_parser(name, help=command.help, parents=[parser], add_help=False)
    return whole


def _or_files(what: str, names: Iterable[str]) -> dict[str, Any]:
    """Return the completion by names, or by files where no name fits, in shtab's form."""
    function, text = f"_fbl_gym_{what}_or_file", " ".join(names)
    return {
        "bash": function,
        "zsh": function,
        "fish": f"({function})",
        "preamble": {
            "bash": f'{function}() {{\n  compgen -W "{text}" -- $1 || compgen -f -- $1\n}}',
            "zsh": f"{function}() {{\n  compadd -- {text} || _files\n}}",
            "fish": f"function {function}\n  string split ' ' '{text}'\n  __fish_complete_path (commandline -ct)\nend",
        },
    }
