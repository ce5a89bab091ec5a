"""Processes for external policies, one for each, since a policy may change anything in its process.

Examples are `np.seterr`, and a class of fbl-gym that a policy replaces. A process may also hang,
take all memory or die: `limit` sets how long a call may take, and how much memory. All processes
end with their parent.
"""

import atexit
import contextlib
import ctypes
import importlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing import current_process
from typing import IO, Any

from fbl_gym.checks import check_number
from fbl_gym.records import set_fields

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

ATTEMPTS = 2
"""Number of processes that may die over one call before the call fails."""

MOST_PROCESSES = 3
"""Largest number of processes that wait for further calls."""


class Failed(RuntimeError):
    """The process of a policy died twice, took too long, or raised an error but no ValueError."""


@dataclass(frozen=True)
class Limits:
    """Longest time of one call [s], and most memory [GB]; None: as much as there is."""

    seconds: float = 3600.0
    gigabytes: float | None = None

    def __post_init__(self) -> None:
        set_fields(self, seconds=check_number("cell-timeout", self.seconds, above=0, high=threading.TIMEOUT_MAX))
        if self.gigabytes is not None:
            check_number("cell-memory", self.gigabytes, above=0, high=1e6)
            if not sys.platform.startswith("linux"):
                raise ValueError(f"cell-memory must be left out on {sys.platform}, which does not limit memory")


_LIMITS = [Limits()]


def limit(limits: Limits) -> None:
    """Set the limits of all calls from this process."""
    _LIMITS[0] = limits


def limits() -> Limits:
    """Return the limits of calls from this process."""
    return _LIMITS[0]


def call_apart(owner: str, function: str, *arguments: Any) -> Any:
    """Call a function in the process of a policy and return its result; raise its ValueError here.

    Args:
        owner: name of the policy; the process is kept for its further calls.
        function: "module:name".
        *arguments: plain data.

    Raises:
        Failed: there is no result.
    """
    for _ in range(ATTEMPTS):
        process = _process(owner)
        try:
            error, value = process.call(function, arguments)
        except BaseException as problem:  # a late answer must not be taken for that to the next call
            _PROCESSES.pop((os.getpid(), owner)).close()
            if not isinstance(problem, EOFError | OSError | pickle.UnpicklingError):
                raise
            if process.late:
                raise Failed(f"it took longer than {limits().seconds:g} s, see --cell-timeout") from None
            continue
        if error is not None:
            raise error
        return value
    raise Failed(f"its worker died {ATTEMPTS} times")


class _Process:
    """A Python process that waits for calls. It ends with its parent, since its input ends then."""

    def __init__(self) -> None:
        code = (
            f"import sys; sys.path[:] = {sys.path!r}; from benchmarks.policies.apart import serve; serve({os.getpid()})"
        )
        self.late = False
        with parent_decides():
            self.process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def call(self, function: str, arguments: tuple[Any, ...]) -> tuple[BaseException | None, Any]:
        requests, answers = self._pipes()
        timer = threading.Timer(limits().seconds, self._end)
        timer.daemon = True
        timer.start()
        try:
            pickle.dump((os.getcwd(), limits(), function, arguments), requests)
            requests.flush()
            answer: tuple[BaseException | None, Any] = pickle.load(answers)
        finally:
            timer.cancel()
        return answer

    def _pipes(self) -> tuple[IO[bytes], IO[bytes]]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        return self.process.stdin, self.process.stdout

    def _end(self) -> None:
        self.late = True
        self.process.kill()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in self._pipes():
            with contextlib.suppress(OSError):
                pipe.close()


_PROCESSES: dict[tuple[int, str], _Process] = {}
"""The process of each policy. A fork of this process starts others, so the identity of this process
is part of the key."""


def _process(owner: str) -> _Process:
    key = os.getpid(), owner
    process = _PROCESSES.pop(key, None)
    if process is None:
        close(MOST_PROCESSES - 1)
        process = _Process()
    _PROCESSES[key] = process  # the last used stands last
    return process


@atexit.register
def close(but: int = 0) -> None:
    """End the processes of this one but the last used ones."""
    mine = [key for key in _PROCESSES if key[0] == os.getpid()]
    for key in mine[: max(len(mine) - but, 0)]:
        _PROCESSES.pop(key).close()


def serve(parent: int) -> None:
    """Answer the calls of a parent process on the standard input, until the input ends."""
    _watch(parent)
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # A policy may read and print.
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    while True:
        try:
            folder, limits, function, arguments = pickle.load(requests)
        except EOFError:
            return
        limit(limits)
        if limits.gigabytes is not None:
            most = resource.getrlimit(resource.RLIMIT_DATA)[1]
            resource.setrlimit(resource.RLIMIT_DATA, (int(1e9 * limits.gigabytes), most))
        os.chdir(folder)  # the policy may be named by a relative path
        module, _, name = function.partition(":")
        try:
            answer = pickle.dumps((None, getattr(importlib.import_module(module), name)(*arguments)))
        except BaseException as problem:
            known = isinstance(problem, ValueError)
            answer = pickle.dumps((ValueError(text_of(problem)) if known else Failed(reason_of(problem)), None))
        replies.write(answer)
        replies.flush()


LONGEST = 2000
"""Characters of an error that are kept."""


def text_of(problem: BaseException) -> str:
    """Return the text of an error. An external policy's may raise one itself."""
    try:
        return str(problem)[:LONGEST]
    except BaseException:
        return "(its text raises an error)"


def reason_of(problem: BaseException) -> str:
    """Return the kind and the text of an error."""
    return f"{type(problem).__name__}: {text_of(problem)}"


@contextlib.contextmanager
def parent_decides() -> Iterator[None]:
    """Let processes that are started here ignore the signals of a terminal."""
    main = threading.current_thread() is threading.main_thread()
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGHUP") if main and hasattr(signal, name)]
    before = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


_WATCHED: list[int] = []


def end_with_parent() -> None:
    """End this process when its parent has ended, if it is a worker of joblib."""
    if current_process().name.startswith("LokyProcess") and not _WATCHED:
        _watch(os.getppid())


def _watch(parent: int) -> None:
    _WATCHED.append(parent)
    threading.Thread(target=_wait_for_the_end, args=(parent,), daemon=True).start()
    if sys.platform.startswith("linux") and not current_process().name.startswith("LokyProcess"):
        # Compiled code may hold Python's lock, so that no thread of Python runs. joblib starts its
        # workers in a thread that may end before the parent, and this signal would follow it.
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)


def _wait_for_the_end(parent: int) -> None:
    while os.name == "nt" or os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
