"""Threads that step a batch together, without Python between them.

All environments of a process share one pool. Its workers are Python threads, each inside one call
of `_work`, which needs no lock of Python's. There they wait for a job: the blocks of a batch. The
thread that brings the job takes blocks too, so it never waits for a worker that is late. Blocks are
independent, so their bits do not depend on the thread.
"""

import contextlib
import math
import os
import threading
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
from numba import types
from numba.extending import intrinsic

from fbl_gym.kernel.maths.fastmath import cached_njit, kernel_njit
from fbl_gym.kernel.memory.layout import LANES, SETTINGS
from fbl_gym.kernel.memory.views import numbers_at, record_at
from fbl_gym.kernel.step.api import STEPS, check
from fbl_gym.model.arm import Array

#: Number of lanes from which on a batch has several threads by default.
LEAST_LANES = 1024

#: Blocks that a thread takes at once; to take one costs 0.1 us, and to step it 3 to 20.
_LEAST_BLOCKS = 4

#: Looks before a thread sleeps, some 50 us; to wake it costs 10 us and takes longer.
_LOOKS = 20_000

_JOB = np.dtype(
    [
        ("lock", np.int64, 8),  # at least as large as the C library's `pthread_mutex_t`
        ("posted", np.int64, 8),  # likewise `pthread_cond_t`: there is a job
        ("done", np.int64, 8),  # likewise: all its blocks are stepped
        ("step", np.int64),  # address of the compiled step
        ("memory", np.int64, 2),  # address and length of the batch's memory
        ("out", np.int64, 2),  # likewise of the observations
        ("moves", np.bool_),
        ("next", np.int64),  # first block that no thread has taken
        ("blocks", np.int64),
        ("left", np.int64),  # number of blocks that are not stepped yet
        ("threads", np.int64),
        ("seats", np.int64),  # number of workers that may still join
    ],
    align=True,
)
_POSTED, _DONE = (_JOB.fields[name][1] for name in ("posted", "done"))  # type: ignore[index]

_NUMBERS = types.float64[::1]
_STEP = types.Tuple((types.int64, types.float64, types.boolean, types.boolean))(
    _NUMBERS, _NUMBERS, types.boolean, types.int64, types.int64
)


def _external(name, arguments):
    """Return a function of the C library, of addresses."""
    return types.ExternalFunction(name, types.int32(*[types.intp] * arguments))


_init_lock, _init_condition = _external("pthread_mutex_init", 2), _external("pthread_cond_init", 2)
_acquire, _release = _external("pthread_mutex_lock", 1), _external("pthread_mutex_unlock", 1)
_wait, _wake = _external("pthread_cond_wait", 2), _external("pthread_cond_broadcast", 1)
_look = _external("pthread_self", 0)  # the compiler must read memory again after any call

#: False on Windows, where each batch has one thread.
SUPPORTED = llvm.address_of_symbol("pthread_cond_wait") is not None


@intrinsic
def _call(_context, _address, _memory, _out, _moves, _begin, _end):
    """Call the compiled step at an address."""

    def emit(context, builder, _signature, arguments):
        pointer = context.call_conv.get_function_type(_STEP.return_type, _STEP.args).as_pointer()
        step = builder.inttoptr(arguments[0], pointer)
        context.call_conv.call_function(builder, step, _STEP.return_type, _STEP.args, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, *_STEP.args), emit


@kernel_njit
def _take_part(job, lock):
    """Step blocks until all are taken; the lock is held before and after."""
    memory = numbers_at(job.memory[0], job.memory[1], np.float64)
    out = numbers_at(job.out[0], job.out[1], np.float64)
    while job.next < job.blocks:
        begin, step, moves = job.next, job.step, job.moves
        end = min(begin + max(_LEAST_BLOCKS, (job.blocks - begin) // (4 * job.threads)), job.blocks)
        job.next = end
        _release(lock)
        _call(step, memory, out, moves, begin, end)
        _acquire(lock)
        job.left -= end - begin
    if job.left == 0:
        _wake(lock + _DONE)


@cached_njit
def _work(pool):
    """Take part in every job that has a seat; never return."""
    job, lock = record_at(pool, 0, _JOB), pool.ctypes.data
    while True:
        looks = 0
        while looks < _LOOKS and (job.seats == 0 or job.next >= job.blocks):
            looks += 1
            _look()
        _acquire(lock)
        while job.seats == 0 or job.next >= job.blocks:
            _wait(lock + _POSTED, lock)
        job.seats -= 1
        _take_part(job, lock)
        _release(lock)


@cached_njit
def _prepare(pool):
    """Make the lock and the conditions."""
    _init_lock(pool.ctypes.data, 0)
    _init_condition(pool.ctypes.data + _POSTED, 0)
    _init_condition(pool.ctypes.data + _DONE, 0)


@cached_njit
def _run(pool, step, memory, out, moves, threads):
    """Step a batch together with workers; return the result of `check`."""
    problem = check(memory) if moves else -1
    if problem >= 0:
        return problem
    job, lock = record_at(pool, 0, _JOB), pool.ctypes.data
    _acquire(lock)
    job.step, job.moves, job.threads, job.seats = step, moves, threads, threads - 1
    job.memory[0], job.memory[1] = memory.ctypes.data, len(memory)
    job.out[0], job.out[1] = out.ctypes.data, len(out)
    job.blocks = job.left = (record_at(memory, 0, SETTINGS).lanes + LANES - 1) // LANES
    job.next = 0
    _wake(lock + _POSTED)
    _take_part(job, lock)
    _release(lock)
    looks = 0
    while looks < _LOOKS and job.left > 0:
        looks += 1
        _look()
    _acquire(lock)
    while job.left > 0:
        _wait(lock + _DONE, lock)
    _release(lock)
    return -1


class _Pool:
    """The workers of this process, as many as a batch has needed so far."""

    def __init__(self) -> None:
        self.renew()
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self.renew)

    def renew(self) -> None:
        """Begin without workers: they do not survive a fork."""
        self._free, self.workers = threading.Lock(), 0
        self.job = np.zeros(_JOB.itemsize // 8, np.int64)
        self._addresses: dict[int, int] = {}  # of the compiled steps

    def step(self, number: int, memory: Array, out: Array, moves: bool, threads: int) -> int:
        """Step a batch, alone if another thread of Python has the workers.

        Args:
            number: of the step in `api.STEPS`.
            memory: of the batch, an argument of that step as `out` and `moves`.
            out: takes the observations.
            moves: False: no lane moves.
            threads: number of threads, this one among them.

        Returns:
            The result of `api.check`.
        """
        free = self._free
        if threads == 1 or not free.acquire(blocking=False):
            return STEPS[number](memory, out, moves, 0, 0)[0]
        try:
            if not self.workers:
                _prepare(self.job)
            if number not in self._addresses:
                STEPS[number].compile(_STEP)
                code = STEPS[number].overloads[_STEP.args]
                self._addresses[number] = code.library.get_pointer_to_function(code.fndesc.llvm_func_name)
            with contextlib.suppress(RuntimeError):  # the system, or the interpreter at its end, allows no more threads
                while self.workers < threads - 1:
                    threading.Thread(target=_work, args=(self.job,), name="fbl_gym", daemon=True).start()
                    self.workers += 1
            return _run(self.job, self._addresses[number], memory, out, moves, threads)
        finally:
            free.release()


#: The pool of all batches of this process.
POOL = _Pool()


def cores() -> int:
    """Return the number of cores that this process may use.

    It is the least of the affinity, a container's quota, and the variable OMP_NUM_THREADS.
    """
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(OSError, ValueError):  # without a quota, "max 100000"
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        count = min(count, math.ceil(int(quota) / int(period)))
    with contextlib.suppress(ValueError):
        count = min(count, int(os.environ.get("OMP_NUM_THREADS", "").split(",")[0]))
    return max(count, 1)


def threads_for(lanes: int, threads: int | None) -> int:
    """Return the number of threads of a batch; None: all cores for many lanes, else one.

    A thread gets at least 64 lanes, since fewer take no longer than to wake it.
    """
    if threads is None:
        threads = cores() if lanes >= LEAST_LANES else 1
    return min(threads, max(1, lanes // (_LEAST_BLOCKS * LANES))) if SUPPORTED else 1
