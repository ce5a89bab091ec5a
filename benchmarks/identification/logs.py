"""Logs of robots: CSV files, at a constant rate after reading."""

import io
import itertools
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

from fbl_gym.model.arm import Array
from fbl_gym.reading import read_text
from fbl_gym.records.checks import unknown

COLUMNS = {
    "time": ("time_s",),
    "position": ("position_1_rad", "position_2_rad"),
    "torque": ("torque_1_Nm", "torque_2_Nm"),
    "velocity": ("velocity_1_rad_s", "velocity_2_rad_s"),
}
"""The columns of each signal, as in the traces of `fbl-gym evaluate`; a mapping names others.

`torque` is commanded.
"""

SMOOTHING = 0.06
"""Time over which positions are smoothed by a cubic polynomial [s]."""

STEP = 0.004
"""Time between two samples after reading, of logs that are no slower [s]."""

MAX_GAP = 10.0
"""Longest interval between two samples, in median intervals."""

FASTEST, SLOWEST = 1e-5, 0.1
"""Shortest and longest median interval between two samples [s]; others are of another unit."""

MAX_SPEED = 100.0
"""Fastest motion between two samples; a faster one is a jump of the reading [rad/s]."""

_NEEDED = ("time", "position", "torque")


def smooth(signal: Array, dt: float, order: int, seconds: float = SMOOTHING) -> Array:
    """Return a derivative of a signal [n x m], by cubic polynomials over some seconds."""
    return savgol_filter(signal, 2 * max(2, round(seconds / dt / 2)) + 1, 3, deriv=order, delta=dt, axis=0)


@dataclass(frozen=True)
class Log:
    """One run of one robot, at a constant rate.

    Attributes:
        name: of the file.
        dt: time between two samples [s].
        position: as measured, with the zero of this package's angles [n x 2] rad.
        smooth: smoothed position and velocity [n x 4] rad, rad/s.
        torque: commanded [n x 2] N m.
        counts: positions per turn of each joint; 0 if none were found.
        difference: samples between the two positions whose difference is the logged velocity; 0: it
            is none.
        sample: median time between two samples of the file [s].
        rows: positions and torques of the file's different samples, as bytes.
        remarks: what was found, one line each.
    """

    name: str
    dt: float
    position: Array
    smooth: Array
    torque: Array
    counts: Array
    difference: int
    sample: float
    rows: frozenset[bytes]
    remarks: tuple[str, ...]


def columns(texts: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the columns of each signal, with those that texts such as "torque=u1,u2" name."""
    mapping: dict[str, tuple[str, ...]] = dict(COLUMNS)
    for text in texts:
        signal, _, names = text.partition("=")
        if signal not in COLUMNS:
            raise unknown("signal", signal, COLUMNS)
        mapping[signal] = tuple(filter(None, names.split(",")))
        wanted = 1 if signal == "time" else 2
        if len(mapping[signal]) not in ({wanted} if signal in _NEEDED else {0, wanted}):
            raise ValueError(f"--signals must name {wanted} of {signal}, separated by commas, got {text!r}")
    return mapping


def _numbers(path: Path, mapping: Mapping[str, tuple[str, ...]]) -> dict[str, Array]:
    """Return the signals of a file, [n x number of columns]."""
    content = io.StringIO(read_text(path))
    try:
        with warnings.catch_warnings(action="error"):  # an empty file, or numbers of columns that differ
            table = np.genfromtxt(content, delimiter=",", names=True, deletechars="")
    except (ValueError, UserWarning) as problem:
        raise ValueError(f"{path} must be a table with a header and equal lines: {problem}") from None
    header = table.dtype.names or ()
    for signal in _NEEDED:
        for name in mapping[signal]:
            if name not in header:
                raise ValueError(f"{path}: {unknown(f'column of {signal}', name, header)}; --signals names others")
    wanted = {signal: names for signal, names in mapping.items() if names and set(names) <= set(header)}
    signals = {signal: np.column_stack([table[name] for name in names]) for signal, names in wanted.items()}
    bad = ~np.isfinite(np.hstack(list(signals.values()))).all(axis=1)
    if bad.any():
        raise ValueError(
            f"{path} must have finite numbers, but {bad.sum()} rows lack one, first row {bad.argmax() + 2}"
        )
    return signals


def read(
    path: Path, mapping: Mapping[str, tuple[str, ...]] = COLUMNS, zero: Array | tuple[float, float] = (0.0, 0.0)
) -> Log:
    """Return the log of a CSV file, which may be packed with gzip.

    Args:
        path: of the file.
        mapping: the columns of each signal.
        zero: angles of this package at which the file's positions are zero [2] rad.

    Raises:
        ValueError: a column is missing, time runs back or has a gap, or an encoder is unplugged.
    """
    signals = _numbers(path, mapping)
    time = signals["time"][:, 0]
    if len(time) < 200:
        raise ValueError(f"{path} must have 200 samples or more, got {len(time)}")
    steps = np.diff(time)
    if (steps <= 0).any():
        raise ValueError(f"{path}: time must increase, but does not after {time[:-1][steps <= 0][0]:g} s")
    sample, most = float(np.median(steps)), float(steps.max())
    if not FASTEST <= sample <= SLOWEST:
        raise ValueError(f"{path}: time must be in s, {FASTEST:g} to {SLOWEST:g} s a sample, got {sample:g}")
    if most > MAX_GAP * sample:
        raise ValueError(
            f"{path} has a gap of {most:.3g} s after {time[steps.argmax()]:g} s: cut it there into two logs"
        )
    position = signals["position"]
    speed = np.abs(np.diff(position, axis=0)) / steps[:, None]
    for name, fastest in zip(mapping["position"], speed.max(axis=0), strict=True):
        if fastest == 0.0:
            raise ValueError(f"{path}: {name} does not change: its encoder is unplugged, or the column is another one")
        if fastest > MAX_SPEED:
            raise ValueError(
                f"{path}: {name} must not jump, got {fastest:.3g} rad/s: unplugged, or turns not unwrapped"
            )
    dt = max(STEP, round(sample, 4))
    times = np.arange(time[0], time[-1], dt)
    impulse = np.concatenate([np.zeros((1, 2)), np.cumsum(signals["torque"][:-1] * steps[:, None], axis=0)])
    held = np.diff(_at(times, time, impulse), axis=0) / dt  # the mean of the held command over each step
    even = _at(times[:-1], time, position) + zero
    states = np.hstack([smooth(even, dt, order) for order in (0, 1)])
    counts = _counts(position)
    difference, how = 0, "not logged"
    if "velocity" in signals:
        difference, how = _velocity(signals["velocity"], position, time)
    torque = signals["torque"]
    peak = np.abs(torque).max(axis=0)
    full = (np.abs(torque) >= peak * (1 - 1e-9)).sum(axis=0) * (peak > 0)
    remarks = (
        f"{len(time)} samples in {np.ptp(time):.4g} s, {1 / sample:.4g} Hz, intervals of {1e3 * sample:.3g} ms "
        f"(99 %: {1e3 * np.quantile(steps, 0.99):.3g}, longest: {1e3 * most:.3g})",
        "counts per turn: " + ", ".join(f"{n:.0f}" if n else "not found" for n in counts) + f"; velocity: {how}",
        f"commands up to {peak[0]:.3g} and {peak[1]:.3g} N m, "
        f"{full[0]} and {full[1]} samples of them at that value" + (", perhaps a limit" if full.max() > 20 else ""),
    )
    rows = frozenset(row.tobytes() for row in np.hstack([position, torque]))
    return Log(path.name, dt, even, states, held, counts, difference, sample, rows, remarks)


def refuse_twice(logs: Iterable[Log]) -> None:
    """Raise an error if two logs share most of their samples, which would narrow all intervals."""
    for one, other in itertools.combinations(logs, 2):
        if 2 * len(one.rows & other.rows) > min(len(one.rows), len(other.rows)):
            raise ValueError(f"each log must be given once, but {one.name} and {other.name} have the same samples")


def _at(times: Array, time: Array, signal: Array) -> Array:
    """Return a signal [n x m] at other times, interpolated."""
    return np.column_stack([np.interp(times, time, column) for column in signal.T])


def _counts(position: Array) -> Array:
    """Return the readings per turn of each joint [2]; 0 where they are no multiples of a step."""
    counts = np.zeros(2)
    for joint, column in enumerate(position.T):
        levels = np.unique(column)
        steps = np.diff(levels)
        steps = steps[steps > 1e-9]
        step = steps.min()
        whole = np.abs(steps / step - np.round(steps / step)) < 0.05
        if whole.mean() > 0.95 and len(levels) < 0.9 * len(column):
            counts[joint] = 2 * np.pi / np.median(steps[np.round(steps / step) == 1])
    return counts


def _velocity(velocity: Array, position: Array, time: Array) -> tuple[int, str]:
    """Return the samples of the difference that the velocity is, and how it was computed."""
    for n in range(1, 9):
        difference = (position[n:] - position[:-n]) / (time[n:] - time[:-n])[:, None]
        if np.median(np.abs(difference - velocity[n:])) < 0.05 * np.median(np.abs(velocity)):
            return n, f"difference of positions {n} sample{'s' * (n > 1)} apart"
    noise = np.std(velocity - smooth(position, float(np.median(np.diff(time))), 1), axis=0)
    return 0, f"measured, noise {noise[0]:.3g} and {noise[1]:.3g} rad/s"
