"""The kernel's functions, compiled once and kept on disk.

Numba notices a change in the file of a cached function, but not in the files of the functions that it calls. So each door
below closes over a fingerprint of all the sources it is compiled from; Numba makes that part of the cache's key.
"""

import hashlib
from pathlib import Path

from numba import njit

from fbl_gym import kernel

_SOURCES = ("arm", "elementary", "friction", "kernel", "settings", "streams")


def _fingerprint() -> int:
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for name in _SOURCES:
        digest.update((folder / f"{name}.py").read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")


def _doors(fingerprint: int):
    @njit(nogil=True, error_model="numpy", cache=True)
    def reset(state, clock, x, tables, mask, out):
        kernel.reset(state, clock, x, tables, mask, out)
        return fingerprint

    @njit(nogil=True, error_model="numpy", cache=True)
    def step(state, clock, x, tables, actions, autoreset, out, final, rewards, terminated, truncated):
        bad, ended = kernel.first_bad(actions, clock, autoreset)
        if bad < 0 and ended < 0:
            kernel.step(state, clock, x, tables, actions, autoreset, out, final, rewards, terminated, truncated)
        return bad, ended, fingerprint

    @njit(nogil=True, error_model="numpy", cache=True)
    def inspect(state, x, lanes, out):
        kernel.inspect(state, x, lanes, out)
        return fingerprint

    return reset, step, inspect


reset, step, inspect = _doors(_fingerprint())
