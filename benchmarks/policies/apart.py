"""Calls in other processes: several at once, and one process for each external policy.

An external policy may change anything in its process, such as `np.seterr` or a class of fbl-gym. It
may also hang, take all memory or die: `limit` sets how long a call may take, and how much memory.
All processes end with their parent.
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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import IO, Any, TypeVar

from fbl_gym.checks import check_number
from fbl_gym.records import set_fields

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

ATTEMPTS = 2
"""Number of processes that may die over one call before the call fails."""

MOST_PROCESSES = 3
"""Largest number of processes that wait for further calls of one thread."""

Answer = TypeVar("Answer")


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


def at_once(jobs: Sequence[Callable[[], Answer]], workers: int) -> Iterator[Answer]:
    """Yield the answers of functions in any order, each from a thread that waits for `call_apart`.

    One worker is this thread. All processes end with the iterator.
    """
    if workers <= 1:
        yield from (job() for job in jobs)
        return
    pool = ThreadPoolExecutor(workers)
    answers = [pool.submit(job) for job in jobs]
    try:
        left = set(answers)
        while left:  # on Windows, Ctrl-C acts between two waits
            done, left = wait(left, timeout=1.0, return_when=FIRST_COMPLETED)
            yield from (answer.result() for answer in done)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        close()
        while wait(answers, timeout=0.1).not_done:  # some had no process yet
            close()


def call_apart(owner: str, function: str, *arguments: Any) -> Any:
    """Call a function in the process of a policy and return its result; raise its ValueError here.

    Args:
        owner: name of the external policy; the thread's process for it is kept for further calls.
            Empty: one for built-in policies, whose calls may take any time by default.
        function: "module:name".
        *arguments: plain data.

    Raises:
        Failed: there is no result.
        CancelledError: the processes were closed meanwhile.
    """
    seconds = limits().seconds if owner or limits() != Limits() else threading.TIMEOUT_MAX
    for _ in range(ATTEMPTS):
        process = _process(owner)
        try:
            error, value = process.call(function, arguments, seconds)
        except BaseException as problem:  # a late answer must not be taken for that to the next call
            process.close()
            if not isinstance(problem, EOFError | OSError | ValueError | pickle.UnpicklingError):
                raise
            if process.reason is not None:
                raise process.reason from None
            continue
        if error is not None:
            raise error
        return value
    raise Failed(f"its worker died {ATTEMPTS} times")


class _Process:
    """A Python process that waits for calls. It ends with its parent, since its input ends then."""

    def __init__(self) -> None:
        # The parent decides at the signals of a terminal.
        code = (
            "import signal, sys\n"
            "for name in ('SIGINT', 'SIGHUP'):\n"
            "    hasattr(signal, name) and signal.signal(getattr(signal, name), signal.SIG_IGN)\n"
            f"sys.path[:] = {sys.path!r}\n"
            f"from benchmarks.policies.apart import serve; serve({os.getpid()})"
        )
        self.reason: Exception | None = None  # of its end
        self.process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def call(self, function: str, arguments: tuple[Any, ...], seconds: float) -> tuple[BaseException | None, Any]:
        requests, answers = self._pipes()
        timer = threading.Timer(seconds, self.end, [Failed(f"it took longer than {seconds:g} s, see --cell-timeout")])
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

    def end(self, reason: Exception) -> None:
        self.reason = reason
        self.process.kill()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in self._pipes():
            with contextlib.suppress(OSError):
                pipe.close()


_PROCESSES: dict[tuple[int, int, str], _Process] = {}
"""The process of each policy, by this process, of which a fork starts others, the thread, and the
policy's name. The last used stands last."""


def _process(owner: str) -> _Process:
    key = os.getpid(), threading.get_ident(), owner
    process = _PROCESSES.pop(key, None)
    if process is None or process.process.returncode is not None:  # it is closed
        mine = [other for other in list(_PROCESSES) if other[:2] == key[:2]]
        for other in mine[: len(mine) - MOST_PROCESSES + 1]:
            _PROCESSES.pop(other).close()
        process = _Process()
    _PROCESSES[key] = process
    return process


@atexit.register
def close() -> None:
    """End the processes of this one; calls that wait for them fail."""
    for key in [key for key in list(_PROCESSES) if key[0] == os.getpid()]:
        if (process := _PROCESSES.pop(key, None)) is not None:
            process.end(CancelledError())
            process.close()


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


def _watch(parent: int) -> None:
    """End this process when its parent has ended."""
    threading.Thread(target=_wait_for_the_end, args=(parent,), daemon=True).start()
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # also while compiled code holds Python's lock


def _wait_for_the_end(parent: int) -> None:
    while os.name == "nt" or os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
