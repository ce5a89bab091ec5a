"""What a policy opens, starts or asks for beside its key, seen by Python's audit hook.

An event counts if code from outside fbl-gym causes it, but for what an installed package does
while it is imported. Files of Python, of installed packages and of the system are free, and so are
files that only are written.
"""

import functools
import importlib.util
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from types import FrameType
from typing import Any

from benchmarks.policies.key import LAWS, place
from fbl_gym.neighbours import ROOT

VARIABLE = "environ"

FILE = {"open": 0, "import": 1, "ctypes.dlopen": 0, "sqlite3.connect": 0, VARIABLE: 0}
"""Events of a file or a variable, each with the position of its name among the arguments."""

DIRECT = ("ctypes.dlopen", VARIABLE)
"""Events that only count where the policy's code itself asks."""

OTHERS = {
    "os.exec": "starts a process", "os.fork": "starts a process", "os.posix_spawn": "starts a process",
    "os.spawn": "starts a process", "os.startfile": "starts a process", "os.system": "starts a process",
    "subprocess.Popen": "starts a process", "socket.bind": "uses the network", "socket.connect": "uses the network",
    "socket.getaddrinfo": "uses the network", "socket.gethostbyname": "uses the network",
}  # fmt: skip
"""Events that no key can cover."""

_SYSTEM = ("/dev/", "/etc/", "/lib", "/proc/", "/sys/", "/usr/")
_WRITES = os.O_WRONLY | os.O_TRUNC | os.O_EXCL


class Watch:
    """A context that notes what the policies in it depend on beside their key.

    Args:
        files: those of the key.
        home: folder of the policy's code.

    Attributes:
        seen: a line for each thing, which says how to declare it.
    """

    def __init__(self, files: Iterable[str], home: Path) -> None:
        self.seen: dict[str, None] = {}
        self._free, self._home = set(files), home

    def __enter__(self) -> "Watch":
        _install()
        _WATCHES.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _WATCHES.remove(self)

    def note(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note an event that code of the policy causes."""
        given = None if event in OTHERS else arguments[FILE[event]]
        if event in OTHERS:
            self.seen[f"it {OTHERS[event]}, and no key follows the answer"] = None
        elif event == VARIABLE:
            self.seen[f"it reads the environment variable {given}: make that a gain"] = None
        elif event == "ctypes.dlopen" and not os.path.dirname(os.fspath(given or "")):
            self.seen["it calls a library of the system by ctypes, which may read files unseen"] = None
        elif isinstance(given, str | bytes | os.PathLike):
            self._note_file(os.path.realpath(os.fsdecode(given)), arguments[2] if event == "open" else 0)

    def _note_file(self, path: str, flags: int) -> None:
        if path.endswith(".pyc"):
            path = importlib.util.source_from_cache(path)
        if flags & _WRITES:
            self._free.add(path)  # what it writes itself, it may read
        elif path not in self._free and not path.startswith(_SYSTEM) and not _is_free(path):
            name = os.path.relpath(path, self._home)
            if place(path) == "ours":
                name = os.path.relpath(path, ROOT)
                declared = 'uses = ("LAW",), with the name of its law'
            else:
                declared = f'data_files = ("{name}",)'
            self.seen[f"it reads {name}, which its key does not cover: add make_policy.{declared}"] = None


def _is_free(path: str) -> bool:
    """Return True for files of Python, of installed packages, and of fbl-gym beside policies."""
    if path.endswith((".nbi", ".nbc", "__init__.py")):  # Numba's, for the code of fbl-gym alone
        return True
    return place(path) != "" and not path.startswith(_POLICIES)


_POLICIES = tuple(f"{ROOT / name.replace('.', os.sep)}" for name in (*LAWS, "controllers.tuned."))

_WATCHES: list[Watch] = []


def _hook(event: str, arguments: tuple[Any, ...], depth: int = 1) -> None:
    if _WATCHES and (event in FILE or event in OTHERS) and _is_of_policy(sys._getframe(depth), event in DIRECT):
        for watch in _WATCHES:
            watch.note(event, arguments)


def _is_of_policy(frame: FrameType | None, direct: bool) -> bool:
    """Return True if a policy's code is on the stack; `direct`: if it is the caller itself."""
    while frame is not None:
        code, where = frame.f_code, place(frame.f_code.co_filename)
        if where != "standard" and (direct or where == "" or code.co_name == "<module>"):
            return where == ""
        frame = frame.f_back
    return False


class _Environment(dict[Any, Any]):
    """The environment variables; Python has no audit event for reading them."""

    def __getitem__(self, name: Any) -> Any:
        _hook(VARIABLE, (os.fsdecode(name),), 2)
        return super().__getitem__(name)


@functools.cache
def _install() -> None:
    sys.addaudithook(_hook)
    os.environ._data = _Environment(os.environ._data)  # type: ignore[attr-defined]
