"""The arm in hand-written C (`reference.c`): the limit that the kernel's speed is compared with."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fbl_gym.model.arm import ArmParameters, Array

LANES = 8  # of a block in `reference.c`

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
    return memory[-memory.ctypes.data // 8 % 8 :][:rows]


class Reference:
    """The physics alone of a batch of rigid arms in C, all with the same parameters.

    Args:
        library: the compiled `reference.c`, of `load`.
        arm: the parameters.
        lanes: number of arms, a multiple of eight.
        friction: viscous [N m s/rad], Coulomb [N m], and the velocity [rad/s] over which the
            Coulomb part changes sign.
    """

    def __init__(
        self, library: ctypes.CDLL, arm: ArmParameters, lanes: int, friction: Sequence[float] = (1.0, 1.0, 0.01)
    ) -> None:
        self._advance, self._arm = library.advance_rigid, (ctypes.c_double * 8)(*arm.lumped, *friction)
        self.state = _aligned(4 * lanes).reshape(lanes // LANES, 4, LANES)
        self.torque = _aligned(2 * lanes).reshape(lanes // LANES, 2, LANES)

    def step(self) -> int:
        """Advance every arm under its torque by ten physics steps of 1 ms; return their number."""
        blocks, dt = ctypes.c_long(len(self.state)), ctypes.c_double(1e-3)
        self._advance(self._arm, self.state.ctypes, self.torque.ctypes, blocks, 10, dt)
        return len(self.state) * LANES


class SameWork:
    """The arms of a batch in C, with friction, springs, torques, readings and errors as theirs.

    Args:
        library: the compiled `reference.c`, of `load`.
        env: the batch, a `TwoLinkArmVectorEnv`, after `reset`; its arms are a multiple of eight.
    """

    def __init__(self, library: ctypes.CDLL, env: Any) -> None:
        scenario, lanes, last = env.scenario, env.num_envs, env.truth.commands[:, 0]
        self._work = library.work_rigid if scenario.joint is None else library.work_elastic
        fields = {name: getattr(env.truth, name).reshape(lanes, -1) for name in _FIELDS}
        fields |= {name: fields[name] / scenario.physics_dt for name in ("delay", "lag")}
        rows = np.concatenate([*fields.values(), last, last, last, np.zeros((lanes, 8)), fields["position"]], axis=1)
        self._rows = _aligned(rows.size).reshape(lanes // LANES, -1, LANES)
        self._rows[:] = rows.reshape(lanes // LANES, LANES, -1).swapaxes(1, 2)
        self.state, self.command, self.readings = (self._rows[:, part] for part in _PARTS)
        level, noise = np.max(getattr(scenario.disturbance, "amplitude", 0)), np.max(env.interface.noise_std, axis=1)
        task = scenario.physics_dt, scenario.substeps, 50, level, env.interface.resolution[0], *noise
        self._task, self._count = (ctypes.c_double * 8)(*task), 0

    def step(self) -> int:
        """Advance every arm by one control step; return their number."""
        self._work(self._task, self._rows.ctypes, ctypes.c_long(len(self._rows)), ctypes.c_long(self._count))
        self._count += 1
        return len(self._rows) * LANES


_FIELDS = (
    "position", "velocity", "motor_position", "motor_velocity", "lumped", "viscous", "coulomb", "stiction", "v_s",
    "load_friction", "stiffness", "damping", "backlash", "rotor", "gain", "delay", "lag",
)  # fmt: skip
_PARTS = slice(0, 8), slice(-16, -14), slice(-8, -2)
"""A block of `reference.c`: fields of `Truth` at its start; rows of motion, command, readings."""
