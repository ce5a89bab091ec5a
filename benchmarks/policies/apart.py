"""A process for each external policy, which may change anything in it, such as `np.seterr`."""

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
"""Number of processes that may die over one call before the call fails."""

MOST_PROCESSES = 3
"""Largest number of processes that wait for further calls."""


class Died(RuntimeError):
    """The process of a policy died, and again in a new process."""


_PROCESSES: dict[tuple[int, str], subprocess.Popen[bytes]] = {}
"""The process of each policy, the last used last. A fork of this process must not use them, so the
identity of this process is part of the key."""


def call_apart(owner: str, function: str, *arguments: Any) -> Any:
    """Call "module:name" with plain data in the process of a policy, which is kept.

    An error of the function is raised here.

    Raises:
        Died: the process died.
    """
    key = os.getpid(), owner
    for _ in range(ATTEMPTS):
        process = _process(key)
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            pickle.dump((os.getcwd(), function, arguments), process.stdin)
            process.stdin.flush()
            error, value = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            _end(key)
            continue
        except BaseException:  # the answer to this call must not be taken for that to the next one
            _end(key)
            raise
        if error is not None:
            raise error
        return value
    raise Died(f"its worker died {ATTEMPTS} times")


def _process(key: tuple[int, str]) -> subprocess.Popen[bytes]:
    """Return the process of a policy. It ends with its parent, since its input ends then."""
    if key not in _PROCESSES:
        waiting = _ours()
        if len(waiting) >= MOST_PROCESSES:
            _end(waiting[0])
        code = f"import sys; sys.path[:] = {sys.path!r}; from benchmarks.policies.apart import serve; serve()"
        command = [sys.executable, "-c", code]
        _PROCESSES[key] = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    _PROCESSES[key] = _PROCESSES.pop(key)
    return _PROCESSES[key]


def _ours() -> list[tuple[int, str]]:
    return [key for key in _PROCESSES if key[0] == os.getpid()]


def _end(key: tuple[int, str]) -> None:
    process = _PROCESSES.pop(key)
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        with contextlib.suppress(OSError):
            if pipe is not None:
                pipe.close()


@atexit.register
def _end_all() -> None:
    for key in _ours():
        _end(key)


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
