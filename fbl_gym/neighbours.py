"""The folder of the packages, and the command line that imports none of them."""

import sys
import warnings
from importlib.util import find_spec
from pathlib import Path

#: Folder of this package, `controllers` and `benchmarks`.
ROOT = Path(__file__).resolve().parents[1]

_IS_COMMAND = sys.argv[0].endswith("fbl-gym") or sys.orig_argv[1:3] == ["-m", "fbl_gym"]

#: True in a command line that prints the list of commands, for which nothing else is imported.
IS_OVERVIEW = _IS_COMMAND and sys.argv[1:] in ([], ["-h"], ["--help"], ["--version"])


def warn_of_shadows() -> None:
    """Warn of a package that comes before one of fbl-gym's of the same name in the search path."""
    for name in () if _IS_COMMAND else ("controllers", "benchmarks"):
        place = sys.modules[name] if name in sys.modules else find_spec(name)
        file = getattr(place, "__file__", None) or getattr(place, "origin", None)
        if file and Path(file).resolve().parent.parent != ROOT:
            warnings.warn(
                f"`import {name}` takes {file}, not fbl-gym's package of that name: rename yours, or start Python "
                "elsewhere, to use fbl-gym's",
                stacklevel=3,
            )
