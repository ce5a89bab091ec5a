"""The command line, `fbl-gym` or `python -m fbl_gym`.

The packages `controllers` and `benchmarks` are those beside this one, even where a folder of the
user has one of these names and comes first in `sys.path`.
"""

import _thread
import importlib
import os
import signal
import sys
import threading
from typing import Any

from fbl_gym.neighbours import ROOT


def keep_interrupts() -> None:
    """Let Ctrl-C stop the program also where it comes in a finalizer, where Python ignores it."""

    def again(unraisable: Any) -> None:
        if unraisable.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(unraisable)
        elif os.name == "posix":  # the signal ends a call that waits, too
            threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
        else:
            threading.Timer(0.05, _thread.interrupt_main).start()

    sys.unraisablehook = again


def main() -> int:
    """Run a command and return the exit status."""
    keep_interrupts()
    sys.path.insert(0, str(ROOT))  # workers get the same path
    try:
        return importlib.import_module("benchmarks.cli").main()
    except KeyboardInterrupt:  # while modules are imported
        return 130


if __name__ == "__main__":
    sys.exit(main())
