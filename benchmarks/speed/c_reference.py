"""The arm in hand-written C (`reference.c`): the limit that the kernel's speed is compared with."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from fbl_gym.model.arm import ArmParameters, Array

LANES = 8
"""Lanes of a block in `reference.c`."""

FLAGS = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-shared", "-fPIC")


@cache
def load() -> ctypes.CDLL | None:
    """Compile and load `reference.c`. Return None where no C compiler is found or it fails."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    source = Path(__file__).with_name("reference.c")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "reference.so"
        done = subprocess.run([compiler, *FLAGS, str(source), "-o", str(library)], capture_output=True, check=False)
        return ctypes.CDLL(str(library)) if done.returncode == 0 else None


def _aligned(rows: int) -> Array:
    """Return zeros whose memory begins at a multiple of 64 bytes, as vector loads need."""
    memory = np.zeros(rows + 8)
    start = (-memory.ctypes.data // 8) % 8
    return memory[start : start + rows]


class Reference:
    """A batch of arms in C, all with the same parameters.

    Args:
        arm: the parameters.
        lanes: number of arms, a multiple of eight.
        friction: viscous [N m s/rad], Coulomb [N m], and the velocity [rad/s] over which the
            Coulomb part changes sign.
        joint: stiffness [N m/rad], damping [N m s/rad] and rotor inertia [kg m^2] of elastic
            joints; None: rigid joints.

    Raises:
        RuntimeError: if no C compiler is found.
    """

    def __init__(
        self,
        arm: ArmParameters,
        lanes: int,
        friction: tuple[float, float, float] = (1.0, 1.0, 0.01),
        joint: tuple[float, float, float] | None = None,
    ) -> None:
        library = load()
        if library is None:
            raise RuntimeError("the C reference needs a C compiler (cc, gcc or clang), and none was found")
        if lanes % LANES:
            raise ValueError(f"lanes must be a multiple of {LANES}, got {lanes}")
        self._advance = library.advance_rigid if joint is None else library.advance_elastic
        self._arm = (ctypes.c_double * 11)(*arm.lumped, *friction, *(joint or (0.0, 0.0, 1.0)))
        rows = 4 if joint is None else 8
        self.state = _aligned(rows * lanes).reshape(lanes // LANES, rows, LANES)
        self.torque = _aligned(2 * lanes).reshape(lanes // LANES, 2, LANES)

    def step(self, substeps: int = 10, physics_dt: float = 1e-3) -> None:
        """Advance every arm under its torque by some physics steps of a length [s]."""
        pointer = ctypes.POINTER(ctypes.c_double)
        self._advance(
            self._arm, self.state.ctypes.data_as(pointer), self.torque.ctypes.data_as(pointer),
            ctypes.c_long(len(self.state)), ctypes.c_int(substeps), ctypes.c_double(physics_dt),
        )  # fmt: skip


def stepper(arm: ArmParameters, lanes: int, *, elastic: bool = False) -> Callable[[], int] | None:
    """Return a function that advances a batch by one control step; None without a C compiler.

    Elastic joints have 2,000 N m/rad, 5 N m s/rad and rotors of 0.5 kg m^2, and physics steps of
    half the length, as on a servo.
    """
    if load() is None:
        return None
    reference = Reference(arm, lanes, joint=(2000.0, 5.0, 0.5) if elastic else None)

    def step() -> int:
        reference.step(*((20, 5e-4) if elastic else (10, 1e-3)))
        return lanes

    return step
