"""A watch on policies: files, processes and variables beside the key, by Python's audit hook.

An event counts if code from outside fbl-gym causes it, but for what an installed package does
while it is imported. Files of Python, of installed packages and of the system are free, and so are
files that only are written.
"""

import contextlib
import functools
import importlib.util
import os
import re
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any

from benchmarks.policies.key import LAWS, place
from benchmarks.policies.spec import PolicySpec
from fbl_gym.neighbours import ROOT

VARIABLE = "environ"

PROCESS = ("os.exec", "os.fork", "os.posix_spawn", "os.spawn", "os.startfile", "os.system", "subprocess.Popen")
#: Events that no key can cover.
NETWORK = ("socket.bind", "socket.connect", "socket.getaddrinfo", "socket.gethostbyname")

LISTING = ("os.listdir", "os.scandir")

EVENTS = {"open", "import", "sqlite3.connect", "ctypes.dlopen", VARIABLE, *LISTING, *PROCESS, *NETWORK}

_SYSTEM = ("/dev/null", "/dev/random", "/dev/urandom", "/etc/", "/lib", "/proc/", "/sys/", "/usr/")


class Watch:
    """A context that notes what the policies in it depend on beside their key.

    Args:
        policy: the one that runs in it. Its key covers its files.

    Attributes:
        seen: a line for each thing, which says how to declare it.
    """

    def __init__(self, policy: PolicySpec) -> None:
        self.seen: dict[str, None] = {}
        self._home = Path(next(iter(policy.files.values()), ".")).parent
        self._factory = policy.parsed.attribute or "make_policy"
        # Warnings and tracebacks read the sources of modules that are loaded.
        loaded = {str(getattr(module, "__file__", None)) for module in [*sys.modules.values()]}
        folders = {str(folder) for file in policy.data for folder in Path(policy.files.get(file, "")).parents}
        self._free = policy.covered | folders | {file for file in loaded if place(file) == ""}
        # The policy of an installed package: its folder in site-packages is not free for it.
        installed = (re.match(r".*[/\\](site|dist)-packages[/\\][^/\\]+", file) for file in self._free)
        self._own = tuple(match[0] for match in installed if match and place(match.string) == "installed")

    def __enter__(self) -> "Watch":
        _install()
        _WATCHES.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _WATCHES.remove(self)

    def note(self, event: str, arguments: tuple[Any, ...], frame: FrameType) -> None:
        """Note an event, if code of the policy causes it."""
        given = arguments[event == "import"] if arguments else None
        of_system = event == "ctypes.dlopen" and not os.path.dirname(os.fspath(given or ""))
        if not self._is_cause(frame, of_system or event in (VARIABLE, *LISTING)):
            return
        if event in LISTING and "importlib" in frame.f_code.co_filename:  # it looks for a module
            return
        if event in (*PROCESS, *NETWORK):
            what = "starts a process" if event in PROCESS else "uses the network"
            self.seen[f"it {what}, and no key follows the answer"] = None
            return
        if event == VARIABLE:
            self.seen[f"it reads the environment variable {given}: make that a gain"] = None
        elif of_system:
            self.seen["it calls a library of the system by ctypes, which may read files unseen"] = None
        elif isinstance(given, str | bytes | os.PathLike):
            self._note_file(os.path.realpath(os.fsdecode(given)), arguments[2] if event == "open" else 0)

    def _is_cause(self, frame: FrameType | None, direct: bool) -> bool:
        """Return True if the policy's code is on the stack; `direct`: as the caller itself."""
        while frame is not None:
            file = frame.f_code.co_filename
            if file.startswith("<") and not file.startswith("<frozen") and frame.f_back:  # made of a text, by exec
                file = str(frame.f_globals.get("__file__", ""))
            where = place(file)
            own = where == "" or file.startswith(self._own)
            if where != "standard" and (direct or own or frame.f_code.co_name == "<module>"):
                return own
            frame = frame.f_back
        return threading.get_ident() != threading.main_thread().ident  # a function of a library, which it gave a thread

    def _note_file(self, path: str, flags: int) -> None:
        with contextlib.suppress(ValueError):  # it is no cache of a module's code
            path = importlib.util.source_from_cache(path)
        if flags & (os.O_TRUNC | os.O_EXCL):
            self._free.add(path)  # what it writes itself, it may read
        elif flags & os.O_WRONLY == 0 and path not in self._free and not self._is_free(path):
            ours = place(path) == "ours"
            name = os.path.relpath(path, ROOT if ours else self._home)
            declared = 'uses = ("LAW",), with the name of its law' if ours else f'data_files = ("{name}",)'
            self.seen[f"it reads {name}, which its key does not cover: add {self._factory}.{declared}"] = None

    def _is_free(self, path: str) -> bool:
        """Return True for files of the system, Python, packages, and fbl-gym beside policies."""
        # Those of Numba are for the code of fbl-gym alone.
        if path.startswith(_SYSTEM) or path.endswith((".nbi", ".nbc", "__init__.py")):
            return True
        return place(path) != "" and not path.startswith((*_POLICIES, *self._own))


_POLICIES = tuple(f"{ROOT / name.replace('.', os.sep)}" for name in (*LAWS, "controllers.tuned."))

_WATCHES: list[Watch] = []


def _hook(event: str, arguments: tuple[Any, ...], depth: int = 1) -> None:
    if _WATCHES and event in EVENTS:
        for watch in _WATCHES:
            watch.note(event, arguments, sys._getframe(depth))


class _Environment(dict[Any, Any]):
    """The environment variables; Python has no audit event for reading them."""

    def __getitem__(self, name: Any) -> Any:
        _hook(VARIABLE, (os.fsdecode(name),), 2)
        return super().__getitem__(name)


@functools.cache
def _install() -> None:
    sys.addaudithook(_hook)
    variables = _Environment(os.environ._data)  # type: ignore[attr-defined]
    for each in (os.environ, getattr(os, "environb", os.environ)):  # Windows has no bytes
        each._data = variables  # type: ignore[union-attr]
