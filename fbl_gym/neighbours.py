"""The packages `controllers` and `benchmarks` beside this one, and others that hide them."""

import sys
import warnings
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

IS_COMMAND = sys.argv[0].endswith("fbl-gym") or sys.orig_argv[1:3] == ["-m", "fbl_gym"]
"""True in the command line, which finds its own packages."""

IS_OVERVIEW = IS_COMMAND and sys.argv[1:] in ([], ["-h"], ["--help"], ["--version"])
"""True in a command line that prints the list of commands, for which nothing else is imported."""


def _report(kind: type[BaseException], *problem: Any) -> None:
    """Report the end of a command; one that is stopped while it is imported, in one line."""
    if kind is KeyboardInterrupt:
        print("fbl-gym: stopped", file=sys.stderr)
    else:
        sys.__excepthook__(kind, *problem)


if IS_COMMAND:
    sys.excepthook = _report


def hidden_by() -> dict[str, Path]:
    """Return the file or folder that is imported in place of each package, by name; import none."""
    hiding = {}
    for name in ("controllers", "benchmarks"):
        spec = PathFinder.find_spec(name)
        paths = [] if spec is None else [Path(path) for path in spec.submodule_search_locations or [str(spec.origin)]]
        if paths and ROOT / name not in [path.resolve() for path in paths]:
            hiding[name] = paths[0]
    return hiding


def warn_of_hidden() -> None:
    """Warn of each package that is hidden."""
    for name, path in hidden_by().items():
        warnings.warn(
            f"import {name} finds {path}, which hides the package {name} of fbl-gym: rename it, or start Python in "
            "another folder. The command fbl-gym is not affected.",
            stacklevel=3,
        )
