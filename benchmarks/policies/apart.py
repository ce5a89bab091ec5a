"""Processes for external policies, one for each, since a policy may change anything in its process.

Examples are `np.seterr`, and a class of fbl-gym that a policy replaces.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import os
import pickle
import signal
import subprocess
import sys
from typing import Any

ATTEMPTS = 2
"""How often a process may die over one call before the call fails."""

LARGEST = 3
"""Processes that wait for further calls."""


class Died(RuntimeError):
    """The process of a policy died, and again in a new process."""


def call_apart(owner: str, function: str, *arguments: Any) -> Any:
    """Call a function in the process of a policy and return its result; an error is raised here.

    Args:
        owner: name of the policy; the process is kept for its further calls.
        function: "module:name".
        *arguments: plain data.

    Raises:
        Died: the process died.
    """
    for _ in range(ATTEMPTS):
        process = _process(owner)
        try:
            error, value = process.call(function, arguments)
        except (EOFError, OSError, pickle.UnpicklingError):
            _PROCESSES.pop((os.getpid(), owner)).close()
            continue
        except BaseException:  # the answer to this call must not be taken for that to the next one
            _PROCESSES.pop((os.getpid(), owner)).close()
            raise
        if error is not None:
            raise error
        return value
    raise Died(f"its worker died {ATTEMPTS} times")


class _Process:
    """A Python process that waits for calls. It ends with its parent, since its input ends then."""

    def __init__(self) -> None:
        code = f"import sys; sys.path[:] = {sys.path!r}; from benchmarks.policies.apart import serve; serve()"
        self.process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def call(self, function: str, arguments: tuple[Any, ...]) -> tuple[BaseException | None, Any]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        pickle.dump((os.getcwd(), function, arguments), self.process.stdin)
        self.process.stdin.flush()
        answer: tuple[BaseException | None, Any] = pickle.load(self.process.stdout)
        return answer

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()


_PROCESSES: dict[tuple[int, str], _Process] = {}
"""The process of each policy. A fork of this process starts others, so the identity of this process
is part of the key."""


def _process(owner: str) -> _Process:
    mine = [key for key in _PROCESSES if key[0] == os.getpid()]
    key = os.getpid(), owner
    if key not in _PROCESSES:
        if len(mine) >= LARGEST:
            _PROCESSES.pop(mine[0]).close()
        _PROCESSES[key] = _Process()
    _PROCESSES[key] = _PROCESSES.pop(key)  # the last used stands last
    return _PROCESSES[key]


@atexit.register
def close() -> None:
    """End the processes of this one."""
    for key in [key for key in _PROCESSES if key[0] == os.getpid()]:
        _PROCESSES.pop(key).close()


def serve() -> None:
    """Answer the calls on the standard input on the standard output, until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # A policy may read and print.
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    while True:
        try:
            folder, function, arguments = pickle.load(requests)
        except EOFError:
            return
        os.chdir(folder)  # the policy may be named by a relative path
        module, _, name = function.partition(":")
        try:
            answer = pickle.dumps((None, getattr(importlib.import_module(module), name)(*arguments)))
        except Exception as problem:
            answer = pickle.dumps((ValueError(f"{problem}"), None))
        replies.write(answer)
        replies.flush()
