"""The command line, `fbl-gym` or `python -m fbl_gym`.

The packages `controllers` and `benchmarks` are those beside this one, even where a folder of the
user has one of these names and comes first in `sys.path`.
"""

import importlib
import sys

from fbl_gym.neighbours import ROOT


def main() -> int:
    """Run a command and return the exit status."""
    sys.path.insert(0, str(ROOT))  # workers get the same path
    try:
        return importlib.import_module("benchmarks.cli").main()
    except KeyboardInterrupt:  # while modules are imported
        return 130


if __name__ == "__main__":
    sys.exit(main())
