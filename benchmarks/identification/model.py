"""The arm of an identification: its parameters, and its simulation over windows of a log.

Each physics step is the kernel's, `fbl_gym.kernel.arm.physics.move`.
"""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from benchmarks.identification.logs import Log, smooth
from fbl_gym.kernel.arm.physics import move
from fbl_gym.kernel.maths.fastmath import cached_njit
from fbl_gym.kernel.memory.layout import EXACT_FRICTION
from fbl_gym.model.arm import ArmParameters, Array, regressor
from fbl_gym.options import Friction
from fbl_gym.records.record import middle
from fbl_gym.scenarios import Scenario

V_S = 0.04  # scale of the squared velocity at which stiction fades [(rad/s)^2]
POINTS = 10  # comparisons in a window, at equal times
PAD = 60  # samples before each log in which its first command acts
DELAYS = tuple(np.arange(0.0, 0.025, 0.004))  # that a linear fit tries [s]

#: The numbers of an arm [16], and the motion that identifies each.
PARAMETERS: dict[str, str] = tomllib.loads(Path(__file__).with_name("parameters.toml").read_text(encoding="utf-8"))

INDEX = {name: i for i, name in enumerate(PARAMETERS)}


def parameters_of(scenario: Scenario) -> Array:
    """Return the parameters of a scenario's arm, [16]; of distributions their middles."""
    friction, drive, rotor = scenario.friction or Friction(), scenario.actuator, scenario.rotor
    dry: Any = map(middle, (*friction.coulomb, *friction.viscous))  # type: ignore[misc]
    delay = middle(drive.delay) + middle(drive.delay_samples) * scenario.control_dt
    gains = [middle(gain) for gain in drive.gain]  # type: ignore[union-attr]
    p1, *lumped = scenario.arm.lumped
    return np.array([p1 + rotor[0], *lumped, rotor[1], *dry, 0.0, 0.0, *gains, delay, middle(drive.lag)])


def arm_of(parameters: Array, start: ArmParameters) -> ArmParameters:
    """Return the arm of point masses with these parameters, and with the lengths of another."""
    lumped = parameters[:5].copy()
    lumped[0] -= start.rotor[0]  # type: ignore[index]
    rotor = (start.rotor[0], parameters[INDEX["rotor 2"]])  # type: ignore[index]
    return ArmParameters.from_lumped(lumped, (start.L1, start.L2), rotor, start.gravity)


@cached_njit
def _simulate(parameters, state, command, start, h, keep, substeps):  # type: ignore[no-untyped-def]
    """Return angles after `keep` samples, from states of angles and velocities; see `Windows`."""
    variants, windows = state.shape[:2]
    out = np.empty((variants, windows, len(keep), 2))
    for k in range(variants):
        p = parameters[k]
        lumped, rotor = (p[0], p[1], p[2], p[3], p[4]), (0.0, p[5])
        friction = (p[8], p[9]), (p[6], p[7]), (p[10], p[11]), (V_S, V_S)
        late = p[14] / h
        whole = math.floor(late)
        part = late - whole
        # Of the torque at the start of a physics step, the shares in its mean and at its end.
        step, lag = h / substeps, max(p[15], 1e-9)
        kept = math.exp(-step / lag)
        mean = (1.0 - kept) * lag / step
        before = int(min(8.0 * p[15] / h, 50.0)) + 1
        for w in range(windows):
            q, v = (state[k, w, 0], state[k, w, 1]), (state[k, w, 2], state[k, w, 3])
            u1, u2, saved = 0.0, 0.0, 0
            for i in range(-before, keep[-1]):
                new = max(start[w] + i - whole, 0)
                old = max(new - 1, 0)
                end1 = p[12] * ((1.0 - part) * command[new, 0] + part * command[old, 0])
                end2 = p[13] * ((1.0 - part) * command[new, 1] + part * command[old, 1])
                for _ in range(substeps):
                    if i >= 0:
                        u = (end1 + mean * (u1 - end1), end2 + mean * (u2 - end2))
                        q, v = move(step, q, v, (u, u, u), lumped, rotor, friction, EXACT_FRICTION)
                    u1, u2 = end1 + kept * (u1 - end1), end2 + kept * (u2 - end2)
                if i + 1 == keep[saved]:
                    out[k, w, saved, 0], out[k, w, saved, 1] = q
                    saved += 1
    return out


@dataclass(frozen=True)
class Windows:
    """Windows of logs that begin in the measured state and end some time later.

    Attributes:
        dt: of the logs [s].
        keep: samples after the start at which positions are compared [k].
        spread: standard deviation of the states [4].
        substeps: physics steps between two samples.
        command: torques of all logs, one after the other [n x 2].
        state: measured positions and velocities at the starts [windows x 4].
        measured: positions [windows x k x 2] rad.
        start: of each window in `command` [windows].
        log: of each window [windows].
        time: of each start in its log [windows] s.
    """

    dt: float
    keep: Array
    spread: Array
    substeps: int
    command: Array
    state: Array
    measured: Array
    start: Array
    log: Any
    time: Array

    def take(self, some: Array) -> "Windows":
        """Return some of the windows, by a mask; their logs are numbered anew."""
        parts: Any = {name: getattr(self, name)[some] for name in ("state", "measured", "start", "time")}
        return replace(self, log=np.unique(self.log[some], return_inverse=True)[1], **parts)

    def simulate(self, parameters: Array, zero: Array, state: Array) -> Array:
        """Return simulated positions [m x windows x k x 2] of m sets of parameters.

        Args:
            parameters: [m x 16].
            zero: angles at which the readings are zero [m x windows x 2] rad.
            state: at the starts [windows x 4].
        """
        states = np.tile(state, (len(parameters), 1, 1))
        states[..., :2] += zero
        angles = _simulate(parameters, states, self.command, self.start, self.dt, self.keep, self.substeps)
        return np.nan_to_num(angles - zero[:, :, None], nan=1e3, posinf=1e3, neginf=-1e3).clip(-1e3, 1e3)


def windows(logs: list[Log], length: float = 0.5, every: float = 0.25, substeps: int = 4) -> Windows:
    """Return the windows of logs of one rate.

    Args:
        logs: one or more.
        length: of a window [s].
        every: time from one start to the next [s].
        substeps: physics steps between two samples.
    """
    dt = logs[0].dt
    if any(log.dt != dt for log in logs):
        rates = ", ".join(f"{log.name} {1 / log.sample:.4g} Hz" for log in logs)
        raise ValueError(f"logs must have one rate, got {rates}")
    keep = np.unique(np.round(np.linspace(0, length / dt, POINTS + 1)[1:]).astype(int))
    command, position, motion = (
        np.concatenate([np.pad(vars(log)[name], ((PAD, 0), (0, 0)), "edge") for log in logs])
        for name in ("torque", "position", "smooth")
    )
    starts = [np.arange(0, len(log.position) - keep[-1], max(1, round(every / dt))) for log in logs]
    if min(map(len, starts)) == 0:
        raise ValueError(f"each log must be longer than a window of {length:g} s")
    offsets = PAD + np.cumsum([0] + [len(log.position) + PAD for log in logs[:-1]])
    # Two ways of smoothing differ by the error of the states.
    differ = [log.smooth - np.hstack([smooth(log.position, dt, d, 0.12) for d in (0, 1)]) for log in logs]
    spread = np.sqrt(np.mean([np.mean(x**2, axis=0) for x in differ], axis=0)) + 1e-5
    start, number = np.concatenate(starts), np.repeat(np.arange(len(logs)), [*map(len, starts)])
    place = offsets[number] + start
    measured = position[place[:, None] + keep]
    return Windows(dt, keep, spread, substeps, command, motion[place], measured, place, number, start * dt)


def torque_columns(q: Array, v: Array, a: Array) -> Array:
    """Return the columns of the torques, for the first ten of `PARAMETERS` [n x 2 x 10]."""
    none, sign = np.zeros(len(q)), np.tanh(v / 0.1)
    more = (none, a[:, 1]), (sign[:, 0], none), (none, sign[:, 1]), (v[:, 0], none), (none, v[:, 1])
    return np.concatenate([regressor(q, v, a), np.moveaxis(np.array(more), (0, 1, 2), (2, 1, 0))], axis=-1)


def regress(logs: Sequence[Log], start: Scenario, delays: Sequence[float] = DELAYS) -> tuple[Array, float]:
    """Return parameters by linear least squares from filtered logs, as a start for a fit.

    The lumped parameters, the second rotor, Coulomb and viscous friction are linear in the torques,
    whose delay is tried. Each number stays within 0.2 and 5 times that of `start`. The second value
    is the size of the torques that are not explained, as a share of all.
    """
    best, arm = parameters_of(start), start.arm
    used = [0, 1, 3, 4, 5, 6, 7, 8, 9] if arm.gravity > 0 else [0, 1, 2, 5, 6, 7, 8, 9]
    bounds = best[used] - 0.8 * abs(best[used]), best[used] + 4.0 * abs(best[used]) + 0.1
    fits = []
    for delay in delays:
        rows, torques = [], []
        for log in logs:
            late, margin = round(delay / log.dt), round(0.08 / log.dt)
            q, v, a = (smooth(log.position, log.dt, d, 0.08)[late + margin : -margin] for d in range(3))
            columns = torque_columns(q, v, a)
            columns[..., 4] += columns[..., 2] * arm.L1 / arm.gravity if arm.gravity > 0 else 0.0
            rows.append(columns[..., used].reshape(-1, len(used)))
            torques.append(smooth(log.torque, log.dt, 0, 0.08)[margin : len(log.torque) - late - margin].ravel())
        every = np.concatenate(torques)
        solution = lsq_linear(np.concatenate(rows), every, bounds)
        fits.append((float(np.sqrt(2.0 * solution.cost / (every @ every))), delay, solution.x))
    share, best[INDEX["delay"]], best[used] = min(fits, key=lambda fit: fit[0])
    return best, share
