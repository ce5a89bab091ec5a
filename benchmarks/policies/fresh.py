"""The server of isolated calls (`isolation.py`), run as a script with a socket and the search path.

It imports what most calls need and runs no call itself: for each it divides, and the new process
runs the call in a session of its own, whose group it cannot leave. The group ends with the call, or
when the parent has ended.

It imports nothing later. A key follows what a policy imports (`key.py`), so what a new process has
must not depend on the calls before.
"""

import sys

if __name__ == "__main__":
    sys.path[:] = sys.argv[2:]  # before any other import: the script's folder is no place for modules

import contextlib
import os
import pickle
import random
import select
import signal
import socket
import warnings

import numpy as np

from benchmarks.policies.isolation import Failed, end_group
from benchmarks.text import reason_of, text_of

with contextlib.suppress(ImportError):  # Windows
    import resource

INTERVAL = 0.005
"""Time between two looks at the call [s]."""

MOST_WRITTEN = 1_000_000_000
"""Size of the largest file that a call may write, its prints included [bytes]."""


def divide(parent: socket.socket) -> list[int]:
    """Divide for each request; return its three files in the process that runs the call alone.

    The parent gets the number of that process, and its exit status when it has ended.
    """
    while True:
        request, files, _, _ = socket.recv_fds(parent, 1, 3)
        if not request:
            os._exit(0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # the threads of a library, which expects a fork
            call = os.fork()
        if not call:
            os.setsid()
            with contextlib.suppress(ValueError):  # this process may have a lower limit
                limits = MOST_WRITTEN, resource.getrlimit(resource.RLIMIT_FSIZE)[1]
                resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            parent.send(os.getpid().to_bytes(4, "little"))
            parent.close()
            return files
        for file in files:
            os.close(file)
        done = status = 0
        while not done:
            if select.select([parent], [], [], INTERVAL)[0]:
                os.kill(call, signal.SIGKILL)  # perhaps it has no group yet
                end_group(call)
                os._exit(1)
            done, status = os.waitpid(call, os.WNOHANG)
        end_group(call)
        code = os.waitstatus_to_exitcode(status)
        parent.send((code if code >= 0 else 128 - code).to_bytes(4, "little"))


def serve(request_file: int, answer_file: int, prints: int) -> None:
    """Answer the request in a file, and end this process.

    Args:
        request_file: descriptor of a file to be read.
        answer_file: descriptor of a file to be written.
        prints: descriptor of a file for what the call prints.
    """
    request, answer = os.fdopen(os.dup(request_file), "rb"), os.fdopen(os.dup(answer_file), "wb")
    for file, place in ((os.open(os.devnull, os.O_RDONLY), 0), (prints, 1), (prints, 2)):
        os.dup2(file, place)
    random.seed()
    np.random.seed()  # noqa: NPY002  a policy may use it, and all calls of the server share its state
    try:
        folder, variables, path, limits = pickle.load(request)
        os.environ.update(variables)
        sys.path[:] = path
        os.chdir(folder)  # the policy may be named by a relative path
        function, arguments = pickle.load(request)
        if limits.gigabytes is not None:
            resource.setrlimit(resource.RLIMIT_DATA, (int(1e9 * limits.gigabytes),) * 2)
        reply = pickle.dumps((None, False, function(*arguments)))
    except BaseException as problem:
        text = text_of(problem) if isinstance(problem, ValueError | Failed) else reason_of(problem)
        reply = pickle.dumps((text, isinstance(problem, ValueError), None))
    if os.name == "posix":
        resource.setrlimit(resource.RLIMIT_FSIZE, resource.getrlimit(resource.RLIMIT_FSIZE)[1:] * 2)
    answer.write(reply)
    answer.flush()
    os._exit(0)  # whatever threads the policy has started


if __name__ == "__main__":
    import benchmarks.policies.spec  # noqa: F401  most of what a call needs
    from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv

    env = TwoLinkArmVectorEnv(2)  # loads the compiled functions
    env.reset(seed=0)
    env.step(env.action_space.sample())

    serve(*(divide(socket.socket(fileno=int(sys.argv[1]))) if os.name == "posix" else (0, 1, 2)))
