"""The folder of the packages, and the command line that imports none of them."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""Folder of this package, `controllers` and `benchmarks`."""

_IS_COMMAND = sys.argv[0].endswith("fbl-gym") or sys.orig_argv[1:3] == ["-m", "fbl_gym"]

IS_OVERVIEW = _IS_COMMAND and sys.argv[1:] in ([], ["-h"], ["--help"], ["--version"])
"""True in a command line that prints the list of commands, for which nothing else is imported."""
