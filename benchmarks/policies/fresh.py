"""The start of an isolated call (`isolation.py`), run as a script with a pipe and the search path.

The process divides: the first one supervises the second one, which runs the call, and ends the
whole group when the call ends, or when the pipe says that the parent has ended.
"""

import sys

if __name__ == "__main__":
    sys.path[:] = sys.argv[2:]  # before any other import: the script's folder is no place for modules

import os
import select
import signal

INTERVAL = 0.02
"""Time between two looks at the call [s]."""


def supervise(alive: int) -> None:
    """Divide; return in the process that runs the call alone."""
    call = os.fork()
    if not call:
        return
    while True:
        done, status = os.waitpid(call, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            os._exit(code if code >= 0 else 128 - code)
        if select.select([alive], [], [], INTERVAL)[0]:
            os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    if os.name == "posix":
        supervise(int(sys.argv[1]))
    from benchmarks.policies.isolation import serve

    serve()
