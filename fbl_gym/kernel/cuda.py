"""A batch of arms on an NVIDIA GPU, with the bits of the batch on a processor.

A thread steps a lane by `api.LANE_STEPS`, the code of the processor's steps. Numba compiles it for
the GPU, and NVIDIA's linker joins it with a kernel of four lines, without contraction of a b + c.
The memory has the layout of `layout.py`. All that is not a step is done on a copy in the host's
memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import math
import os
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from fbl_gym.kernel.batch import ArmBatch
from fbl_gym.kernel.maths.fastmath import DIGEST, kernel_njit, named
from fbl_gym.kernel.memory import layout as memory
from fbl_gym.kernel.memory.views import numbers_at
from fbl_gym.kernel.step import api
from fbl_gym.model.arm import Array

#: Threads of a block of the GPU.
_THREADS = 128

#: Blocks that a multiprocessor must hold at once, by step: fewer registers for each thread. An H200
#: makes 1.6 and 1.3 times the steps so, of 65,536 lanes; steps of other classes would be slower.
_BLOCKS: dict[int | str, int] = {0: 4, 1: 4}

_KERNEL = f"""
typedef long long number;
extern "C" __device__ void step_lane(number, number, number, number, number, number lane);
extern "C" __global__ void __launch_bounds__({_THREADS}, BLOCKS)
run(number a, number b, number c, number d, number e, number lanes) {{
    number lane = blockIdx.x * {_THREADS}ll + threadIdx.x;
    if (lane < lanes) step_lane(a, b, c, d, e, lane);
}}
"""


def lane_function(name: int | str) -> Any:
    """Return what a thread calls: a function of five addresses or numbers, and its lane.

    Args:
        name: number of the step in `api.STEPS`, or "scale" for `api.scale_lane`.
    """
    if isinstance(name, str):

        def scale(observations, columns, out, results, size, lane):
            numbers = numbers_at(observations, 1, np.float64), numbers_at(columns, 1, np.float64)
            api.scale_lane(*numbers, numbers_at(out, 1, np.float32), results, size, lane)

        return scale
    step_lane = kernel_njit(api.LANE_STEPS[name])

    def step(memory, out, moves, _d, _e, lane):
        step_lane(numbers_at(memory, 1, np.float64), numbers_at(out, 1, np.float64), moves != 0, lane)

    return named(step, name)


def compile_lane(name: int | str, capability: tuple[int, int], ptx: bool = False) -> bytes:
    """Return the machine code of a `lane_function` as a kernel, or its PTX; no GPU is needed.

    Args:
        name: of the function.
        capability: of the GPU, such as (9, 0).
        ptx: True returns the text.
    """
    if importlib.util.find_spec("numba_cuda") is None:
        raise ImportError("the step must be compiled for this GPU: pip install 'fbl-gym[cuda]'")
    from cuda.bindings import nvjitlink
    from cuda.core import Program, ProgramOptions
    from numba import cuda

    arch = f"sm_{capability[0]}{capability[1]}"
    signature, info = types.void(*[types.int64] * 6), {"abi_name": "step_lane"}
    lane, _ = cuda.compile(lane_function(name), signature, cc=capability, abi="c", abi_info=info, output="ltoir")
    options = ProgramOptions(arch=arch, relocatable_device_code=True, link_time_optimization=True, fma=False)
    kernel = Program(_KERNEL.replace("BLOCKS", str(_BLOCKS.get(name, 1))), "c++", options).compile("ltoir").code
    flags = [f"-arch={arch}", "-lto", "-fma=0", *(["-ptx"] if ptx else [])]
    linker, kind = nvjitlink.create(len(flags), flags), "ptx" if ptx else "cubin"
    for part in (lane, kernel):
        nvjitlink.add_data(linker, nvjitlink.InputType.LTOIR, part, len(part), "part")
    nvjitlink.complete(linker)
    code = bytearray(getattr(nvjitlink, f"get_linked_{kind}_size")(linker))
    getattr(nvjitlink, f"get_linked_{kind}")(linker, code)
    nvjitlink.destroy(linker)
    return bytes(code)


def _machine_code(name: int | str, capability: tuple[int, int]) -> bytes:
    """Return the machine code of a kernel, which is kept on disk beside that of the processor."""
    key = hashlib.sha256(f"{DIGEST} {name} {capability} {numba.__version__}".encode()).hexdigest()
    folder = api.STEPS[0]._cache.cache_path
    path = Path(folder, f"cuda-{name}-{key[:16]}.cubin") if folder else None
    if path is not None and path.exists():
        return path.read_bytes()
    print("fbl_gym compiles this scenario's step for the GPU, once: some 10 to 25 s", file=sys.stderr, flush=True)
    code = compile_lane(name, capability)
    if path is not None:
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(code)
        part.replace(path)
    return code


class Gpu:
    """The present GPU. Its arrays have `__dlpack__`, by which other libraries take them over.

    Args:
        device: a `cuda.core.Device`.
    """

    def __init__(self, device: Any) -> None:
        self._device = device
        self._kernels: dict[int | str, Any] = {}
        self._grids: dict[int, Any] = {}

    def __reduce__(self) -> Any:
        return open_gpu, ()

    @property
    def stream(self) -> Any:
        """Return the stream in which all is done."""
        return self._device.default_stream

    def address(self, array: Any) -> int:
        """Return the address of an array's first number."""
        return array.ptr

    def empty(self, shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
        """Return a new array."""
        from cuda.core.utils import StridedMemoryView

        kind = np.dtype(dtype)
        buffer = self._device.allocate(math.prod(shape) * kind.itemsize, stream=self.stream)
        return StridedMemoryView.from_buffer(buffer, shape, dtype=kind)

    def take(self, array: Any, first: int, shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
        """Return a copy of a part of an array, which begins at its byte `first`."""
        out = self.empty(shape, dtype)
        self._copy(out.ptr, array.ptr + first, math.prod(shape) * np.dtype(dtype).itemsize)
        return out

    def write(self, array: Any, first: int, values: Any) -> None:
        """Set the numbers of an array from `first` on, from one of the host or of the GPU."""
        if hasattr(values, "__dlpack__") and not isinstance(values, np.ndarray):
            from cuda.core.utils import StridedMemoryView

            view = StridedMemoryView.from_any_interface(values, stream_ptr=int(self.stream.handle))
            if view.dtype != np.float64 or view.strides not in (None, (2, 1)):
                raise ValueError(f"actions must be float64 and contiguous, got {view.dtype}, strides {view.strides}")
            self._copy(array.ptr + 8 * first, view.ptr, 8 * math.prod(view.shape))
        else:
            values = np.ascontiguousarray(values, dtype=np.float64)
            self._copy(array.ptr + 8 * first, values.ctypes.data, values.nbytes)

    def read(self, array: Any, host: Array) -> None:
        """Copy the first numbers of an array to one of the host."""
        self._copy(host.ctypes.data, array.ptr, host.nbytes)
        self.stream.sync()

    def _copy(self, target: int, source: int, size: int) -> None:
        from cuda.bindings import driver

        (status,) = driver.cuMemcpyAsync(target, source, size, int(self.stream.handle))
        if status != driver.CUresult.CUDA_SUCCESS:
            raise RuntimeError(f"a copy of {size} bytes on the GPU failed: {status}")

    def launch(self, name: int | str, lanes: int, *arguments: Any) -> None:
        """Run the kernel of a `lane_function` over all lanes; arguments are arrays and numbers."""
        numbers = [value if isinstance(value, int) else self.address(value) for value in arguments]
        self._run(name, lanes, *numbers, *[0] * (5 - len(numbers)))

    def _run(self, name: int | str, lanes: int, *numbers: int) -> None:
        from cuda import core

        if name not in self._kernels:
            code = _machine_code(name, tuple(self._device.compute_capability))
            self._kernels[name] = core.ObjectCode.from_cubin(code).get_kernel("run")
        if lanes not in self._grids:
            self._grids[lanes] = core.LaunchConfig(grid=-(-lanes // _THREADS), block=_THREADS)
        core.launch(self.stream, self._grids[lanes], self._kernels[name], *numbers, lanes)


class TorchGpu(Gpu):
    """The present GPU of torch, whose tensors and current stream it takes.

    It keeps views of tensors and the stream, since making them takes longer than their work.
    """

    place = "cuda"

    def __init__(self, device: Any) -> None:
        import torch

        super().__init__(device)
        self._torch = torch
        self._views: dict[tuple[Any, ...], Any] = {}
        self._streams: dict[int, Any] = {}

    @property
    def stream(self) -> Any:
        """Return torch's current stream."""
        handle = self._torch.cuda.current_stream().cuda_stream
        if handle not in self._streams:
            from cuda.core import Stream

            self._streams[handle] = Stream.from_handle(handle)
        return self._streams[handle]

    def address(self, array: Any) -> int:
        """Return the address of a tensor's first number."""
        return array.data_ptr()

    def empty(self, shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
        """Return a new tensor."""
        return self._torch.empty(shape, dtype=getattr(self._torch, np.dtype(dtype).name), device=self.place)

    def _view(self, array: Any, first: int, shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
        key = array.data_ptr(), first, shape, dtype
        if key not in self._views:
            kind = getattr(self._torch, np.dtype(dtype).name)
            part = array.view(self._torch.uint8)[first : first + math.prod(shape) * kind.itemsize]
            self._views[key] = part.view(kind).view(shape)
        return self._views[key]

    def take(self, array: Any, first: int, shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
        """Return a copy of a part of a tensor, which begins at its byte `first`."""
        return self._view(array, first, shape, dtype).clone()

    def write(self, array: Any, first: int, values: Any) -> None:
        """Set the numbers of a tensor from `first` on, from an array of the host or the GPU."""
        values = self._torch.as_tensor(values)
        self._view(array, 8 * first, tuple(values.shape)).copy_(values)

    def read(self, array: Any, host: Array) -> None:
        """Copy the first numbers of a tensor to an array of the host."""
        self._torch.from_numpy(host).copy_(array[: len(host)])


def open_gpu() -> Gpu:
    """Return the present GPU: that of torch, if torch can use it.

    Raises:
        ImportError: without the packages of the extra `cuda`.
        RuntimeError: without a GPU or its driver.
    """
    try:
        from cuda.core import Device
    except ImportError:
        raise ImportError("device='cuda' needs NVIDIA's packages for Python: pip install 'fbl-gym[cuda]'") from None
    kind = Gpu
    with contextlib.suppress(ImportError):
        import torch

        kind = TorchGpu if torch.cuda.is_available() else Gpu
    try:
        device = Device()
        device.set_current()
    except Exception as problem:
        raise RuntimeError(
            f"device='cuda' needs an NVIDIA GPU and its driver for CUDA 13 (580 or newer); none answers: {problem}"
        ) from problem
    return kind(device)


def _through_host(name: str, changes: bool = False) -> Any:
    """Return the method of `ArmBatch` of a name, on a copy of the GPU's memory."""

    def method(self: CudaBatch, *arguments: Any) -> Any:
        self._pull()
        result = getattr(ArmBatch, name)(self, *arguments)
        if changes:
            self._push()
        return result

    return method


class CudaBatch(ArmBatch):
    """A batch of arms of one scenario on a GPU.

    Args:
        program: the scenario in numbers.
        lanes: number of arms, one or more.
    """

    seed, next_episode = _through_host("seed", changes=True), _through_host("next_episode", changes=True)
    give, restore = _through_host("give", changes=True), _through_host("restore", changes=True)
    field, true_signals, truth, state = map(_through_host, ("field", "true_signals", "truth", "state"))

    def _start(self) -> None:
        """Put the memory on the GPU; lanes beyond the last arm are not computed there."""
        self._blocks["status"] = memory.ENDED
        self._gpu, self._columns = open_gpu(), None
        self._stored = self._gpu.empty(self._memory.shape)
        self._push()

    def _pull(self) -> None:
        """Copy the memory from the GPU."""
        self._gpu.read(self._stored, self._memory)

    def _push(self) -> None:
        """Copy the memory to the GPU."""
        self._gpu.write(self._stored, 0, self._memory)

    def observations(self) -> Any:
        """Return an array for observations, [lanes x size]."""
        return self._gpu.empty((self.lanes, self._size))

    def reset(self, lanes: NDArray[np.int64], out: Any) -> None:
        """Start an episode in some lanes; write all observations to `out` [lanes x size]."""
        self._pull()
        self.settings["refused"] = 0
        super().reset(lanes, out)

    def sense(self, out: Any) -> None:
        """Take readings from the host's memory, without motion; see `ArmBatch.sense`."""
        self._push()
        self._gpu.launch(self._class, self.lanes, self._stored, out, 0)

    def step(self, actions: Any, out: Any) -> int:
        """Advance every lane that may move, see `api.step_lane`; do not wait for it.

        Args:
            actions: [lanes x 2] of the GPU or the host.
            out: takes the observations [lanes x size].
        """
        if tuple(np.shape(actions)) != (self.lanes, 2):
            raise ValueError(f"action must have shape ({self.lanes}, 2), got shape {tuple(np.shape(actions))}")
        self._gpu.write(self._stored, self._actions.start, actions)
        self._gpu.launch(self._class, self.lanes, self._stored, out, 1)
        return -1

    def refused(self) -> int:
        """Return a result of `api.check` of a step since the last reset or call."""
        settings = self._memory[self._parts["settings"]]
        self._gpu.read(self._stored, settings)
        refused = int(self.settings["refused"])
        self.settings["refused"] = 0
        self._gpu.write(self._stored, 0, settings)
        return refused - 1

    @property
    def outcomes(self) -> tuple[Any, Any, Any]:
        """Rewards, terminated and truncated of the last step, [lanes] each."""
        first, shape = 8 * self._parts["flags"].start, (self.lanes,)
        flags = (self._gpu.take(self._stored, begin, shape, bool) for begin in (first, first + self.lanes))
        return self._gpu.take(self._stored, 8 * self._parts["rewards"].start, shape), *flags

    @property
    def final_observations(self) -> Any:
        """With SAME_STEP, final observations of the last step [lanes x size]."""
        return self._gpu.take(self._stored, 8 * self._parts["final_observations"].start, (self.lanes, self._size))

    def scaled(self, observations: Any, columns: Array) -> Any:
        """Return what `api.subtract_and_scale` makes of observations, [lanes x results] float32."""
        if self._columns is None:
            self._columns = self._gpu.empty((columns.size,))
            self._gpu.write(self._columns, 0, columns.reshape(-1))
        out = self._gpu.empty((self.lanes, len(columns)), np.float32)
        self._gpu.launch("scale", self.lanes, observations, self._columns, out, len(columns), self._size)
        return out
