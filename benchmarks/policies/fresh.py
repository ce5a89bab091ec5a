"""The server of isolated calls (`isolation.py`), run as a script with a socket and the search path.

It imports what a call needs and runs no call itself: for each it divides, and the new process runs
the call. It ends the call's whole group with the call, or when the parent has ended.
"""

import sys

if __name__ == "__main__":
    sys.path[:] = sys.argv[2:]  # before any other import: the script's folder is no place for modules

import contextlib
import importlib
import os
import select
import signal
import socket
import warnings

INTERVAL = 0.005
"""Time between two looks at the call [s]."""


def divide(parent: socket.socket) -> tuple[int, int]:
    """Divide for each request; return its two files in the process that runs the call alone."""
    while True:
        module, files, _, _ = socket.recv_fds(parent, 1000, 2)
        if not module:
            os._exit(0)
        if module.startswith(b"benchmarks."):
            importlib.import_module(module.decode())  # once for all calls
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # the threads of a library, which expects a fork
            call = os.fork()
        os.setpgid(call, call)
        if not call:
            parent.close()
            return files[0], files[1]
        for file in files:
            os.close(file)
        done = status = 0
        while not done:
            if select.select([parent], [], [], INTERVAL)[0]:
                os.killpg(call, signal.SIGKILL)
                os._exit(1)
            done, status = os.waitpid(call, os.WNOHANG)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(call, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(status)
        parent.send((code if code >= 0 else 128 - code).to_bytes(4, "little"))


if __name__ == "__main__":
    from benchmarks.policies.isolation import serve
    from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv

    env = TwoLinkArmVectorEnv(2)  # loads the compiled functions
    env.reset(seed=0)
    env.step(env.action_space.sample())

    files = divide(socket.socket(fileno=int(sys.argv[1]))) if os.name == "posix" else (0, 1)
    serve(*files)
