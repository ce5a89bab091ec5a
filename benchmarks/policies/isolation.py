"""Calls in other processes: `run_isolated` for external code, `run_parallel` for many calls.

An external policy may change anything in its process, such as `np.seterr` or a class of fbl-gym. It
may also hang, take all memory, die, or start processes of its own. Each call of its code therefore
has a new process, and a group of processes that ends with the call.

    parent ── server ── the call ── processes that it starts
                        └─ one group: it ends with the call, at its limit, and with the parent

The server has imported the packages and run nothing (`fresh.py`). A call begins as its copy, which
takes a hundredth of the time of a start from nothing.
"""

import atexit
import contextlib
import multiprocessing
import os
import pickle
import random
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import IO, Any, TypeVar

import numpy as np

from benchmarks.text import reason_of, say, text_of
from fbl_gym.records.checks import check_number

with contextlib.suppress(ImportError):  # Windows
    import resource

#: Bytes of a call's prints that are shown, when it has ended.
MOST_PRINTED = 20_000

Answer = TypeVar("Answer")
Item = TypeVar("Item")


class Failed(RuntimeError):
    """An isolated call died, took too long, or raised an error but no ValueError."""


@dataclass(frozen=True)
class CallLimits:
    """Longest time of one call [s], and most memory [GB]; None: as much as there is."""

    seconds: float = 3600.0
    gigabytes: float | None = None

    def __post_init__(self) -> None:
        check_number("cell-timeout", self.seconds, above=0, high=threading.TIMEOUT_MAX)
        if self.gigabytes is not None:
            check_number("cell-memory", self.gigabytes, above=0, high=1e6)
            if not sys.platform.startswith("linux"):
                raise ValueError(f"cell-memory must be left out on {sys.platform}, which does not limit memory")


def run_isolated(function: Callable[..., Answer], *arguments: Any, limits: CallLimits | None = None) -> Answer:
    """Call a function in a new Python process and return its result; raise its ValueError here.

    The code in it reaches nothing in this process but the result, from which no code can be run.
    It has all rights of the user on files and processes: this stops accidents, and no attack.

    Args:
        function: of a module, or a `partial` of one; it returns plain data and arrays.
        *arguments: data of any type.
        limits: of the call; None: an hour, and as much memory as there is.

    Raises:
        Failed: there is no result.
    """
    limits = limits or CallLimits()
    # A file has no reader that waits for its end, which a process of the policy may hold open.
    with tempfile.TemporaryFile() as request, tempfile.TemporaryFile() as answer, tempfile.TemporaryFile() as prints:
        pickle.dump((os.getcwd(), dict(os.environ), _search_path(), limits), request)
        pickle.dump((function, arguments), request)
        request.seek(0)
        try:
            status = _call((request, answer, prints), limits.seconds)
        except (TimeoutError, subprocess.TimeoutExpired):
            raise Failed(f"it took longer than {limits.seconds:g} s, see leaderboard --cell-timeout") from None
        finally:
            prints.seek(0)
            if text := prints.read(MOST_PRINTED):
                say(text.decode(errors="replace") + " ..." * bool(prints.read(1)), sys.stderr)
        if not answer.seek(0, os.SEEK_END):
            raise Failed(f"its process died, with exit status {status}")
        answer.seek(0)
        try:
            error, is_value_error, result = _Answer(answer).load()
        except Exception as problem:  # the process may have written anything
            raise Failed(f"its answer cannot be read ({reason_of(problem)})") from None
    if error is not None:
        raise (ValueError if is_value_error else Failed)(str(error))
    return result


class _Answer(pickle.Unpickler):
    """A reader of plain data and arrays, and of nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """Return what NumPy reads arrays and numbers with; refuse any other name."""
        if (module, name) not in _ARRAYS:
            raise pickle.UnpicklingError(f"it names {module}.{name}, which is no plain data")
        return super().find_class(module, name)


_ARRAYS = {
    ("numpy", "dtype"), ("numpy", "ndarray"), ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer"),
}  # fmt: skip


def _call(files: Sequence[IO[bytes]], seconds: float) -> int:
    """Run a call in a new process; return the process's exit status.

    The files are for its request, its answer and its prints. The error of a call that takes longer
    is a `TimeoutError`, or `subprocess.TimeoutExpired` on Windows.
    """
    if os.name != "posix":
        return subprocess.call(_command(""), stdin=files[0], stdout=files[1], stderr=files[2], timeout=seconds)
    with _SERVING:
        server, process = _server()
        call, status = 0, b""
        try:
            server.settimeout(LONGEST_START)
            socket.send_fds(server, [b"1"], [file.fileno() for file in files])
            call = int.from_bytes(server.recv(4), "little")
            server.settimeout(min(seconds, 1e6))
            status = server.recv(4)
        finally:  # also after Ctrl-C, and where it takes too long
            if not status:
                _end(server, process, call)
        return int.from_bytes(status, "little")


#: Longest time until the server begins a call [s]: it may have to compile the kernel.
LONGEST_START = 600.0

_SERVING = threading.Lock()
#: The server of this process, by the process's number: a copy of this process needs its own.
_SERVERS: dict[int, tuple[socket.socket, "subprocess.Popen[bytes]"]] = {}


def _server() -> tuple[socket.socket, "subprocess.Popen[bytes]"]:
    """Return the connection to the server, which is started with the first call, and the server."""
    if os.getpid() not in _SERVERS or _SERVERS[os.getpid()][1].poll() is not None:
        ours, its = socket.socketpair()
        with its:
            # Threads do not survive a fork; the order of a set must be the same in each run.
            fixed = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
            process = subprocess.Popen(
                _command(str(its.fileno())), stdin=subprocess.DEVNULL, env=os.environ | fixed, pass_fds=(its.fileno(),),
                start_new_session=True,
            )  # fmt: skip
        _SERVERS[os.getpid()] = ours, process
        atexit.register(_end, ours, process)
    return _SERVERS[os.getpid()]


def _end(server: socket.socket, process: "subprocess.Popen[bytes]", call: int = 0) -> None:
    """End a server and its call. A policy may have stopped or killed the server."""
    server.close()
    if call:
        end_group(call)
    if _SERVERS.pop(os.getpid(), None):
        try:
            process.wait(2.0)  # it ends a call that has not begun
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def end_group(number: int) -> None:
    """Kill all processes of a group."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(number, signal.SIGKILL)


def _command(argument: str) -> list[str]:
    return [sys.executable, os.path.join(os.path.dirname(__file__), "fresh.py"), argument, *_search_path()]


def _search_path() -> list[str]:
    """Return the folders of modules, the standard library's first, without the current folder.

    A file such as signal.py in a folder of the user must not take the place of a standard module,
    nor a module beside another policy the place of the call's own.
    """
    library, site = os.path.dirname(os.__file__), ("site-packages", "dist-packages")
    standard = [folder for folder in sys.path if folder.startswith(library) and not folder.endswith(site)]
    return [*standard, *(folder for folder in sys.path if folder and folder not in {*standard, *POLICY_FOLDERS})]


#: Time between two looks at the call [s].
INTERVAL = 0.005

#: Folders of policies in the search path of this process; those that it starts have none of them.
POLICY_FOLDERS: set[str] = set()

#: Size of the largest file that a call may write, its prints included [bytes].
MOST_WRITTEN = 1_000_000_000


def _divide(parent: socket.socket) -> list[int]:
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


def serve(connection: str) -> None:
    """Run each call that the parent asks for in a process of its own, which ends with it.

    `connection` is the descriptor of the socket; empty on Windows, where the standard files are
    those of one call.
    """
    request_file, answer_file, prints = _divide(socket.socket(fileno=int(connection))) if connection else (0, 1, 2)
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


def run_parallel(
    function: Callable[[Item], Answer], items: Sequence[Item], workers: int = 1
) -> Iterator[tuple[Item, Answer | Failed]]:
    """Yield each item with its answer, in any order. All processes end with the iterator.

    A worker that dies ends all of them: calls that are not finished have an error as their answer.

    Args:
        function: of a module, or a `partial` of one.
        items: plain data.
        workers: number of processes; 1: this one.
    """
    if workers <= 1:
        yield from ((item, function(item)) for item in items)
        return
    others = set(multiprocessing.active_children())
    safe = os.environ.get("PYTHONSAFEPATH", "")
    os.environ["PYTHONSAFEPATH"] = "1"  # what starts now imports no standard module from the current folder
    try:
        pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin, (POLICY_FOLDERS,))
        futures = {pool.submit(function, item): item for item in items}
    finally:
        os.environ["PYTHONSAFEPATH"] = safe  # empty: it is off
    try:
        for future in as_completed(futures):
            try:
                yield futures[future], future.result()
            except BrokenProcessPool:
                died = "a worker process died, perhaps for lack of memory; the same command goes on"
                yield futures[future], Failed(died)
    finally:
        processes = set(multiprocessing.active_children()) - others
        pool.shutdown(wait=False)
        for process in processes:
            if all(future.done() for future in futures):
                process.join(5.0)  # to kill an idle one may break a pipe that its pool still writes to
            process.kill()


def _begin(policy_folders: set[str]) -> None:
    """Leave Ctrl-C and policies to the parent, end with it, and use one core; of a worker."""
    sys.path[:] = [folder for folder in sys.path if folder not in policy_folders]
    os.environ["OMP_NUM_THREADS"] = "1"
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if parent := multiprocessing.parent_process():
        parent.join()
    os._exit(1)
