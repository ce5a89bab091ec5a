"""Logs of robots: tables of any maker, at a constant rate after reading."""

import io
import itertools
import math
import re
import warnings
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.io import loadmat
from scipy.signal import savgol_filter

from fbl_gym.model.arm import Array
from fbl_gym.reading import read_bytes, read_text
from fbl_gym.records.checks import unknown

# Names of each signal's columns, without units and joints' numbers, the best first.
# A command is what the drive was told; it goes before a torque, which may be the one that acted.
MEANINGS = {
    "time": "time t timestamp stamp seconds sec secs",
    "position": "measuredposition posmeas actualposition presentposition actualq position pos q theta angle θ",
    "torque": "command torquecommand taucmd taucon u torque tau effort τ",
    "velocity": "measuredvelocity velmeas velocity vel dq qdot",
}

# Factors that `--signals` knows by name; a torque in A takes the torque constant, too.
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "rad": 1.0, "deg": np.pi / 180, "Nm": 1.0, "A": 1.0}

# Factors of the units in columns' names. `_OTHER` are units of no signal.
_NAMED = {
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    "position": {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180, "°": np.pi / 180, "rev": 2 * np.pi},
    "torque": {"nm": 1.0, "mnm": 1e-3},
    "velocity": {"rad/s": 1.0, "deg/s": np.pi / 180, "°/s": np.pi / 180, "rpm": np.pi / 30, "rev/s": 2 * np.pi},
}
_OTHER = {"a", "ma", "v", "mv", "%", "counts", "ticks", "m", "mm", "n", "w"}
_UNIT = re.compile(r"[\[(]([^\d\])]*)[\])]|_(rad|deg|nm|s|ms|us|ns|a)(_s)?$")
_JOINT = re.compile(r"(?:joint|axis|motor|j)[ _]?(\d)(?!\d)|(shoulder)|elbow")

SMOOTHING = 0.06  # time over which positions are smoothed by a cubic polynomial [s]
STEP = 0.004  # time between two samples after reading, of logs that are no slower [s]
MAX_GAP = 10.0  # longest interval between two samples, in median intervals
FASTEST, SLOWEST = 1e-5, 0.1  # median intervals between two samples [s]; others are of another unit
MAX_SPEED = 100.0  # fastest motion between two samples; a faster one is a jump of the reading [rad/s]
LEAST_TIME = 2.0  # shortest log [s]


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


# A column, or a unit, with its sign and factors.
_ITEM = re.compile(rf"(-?)((?:(?:[\d.]+(?:e[-+]?\d+)?|{'|'.join(UNITS)})\*)*)(.*)")


Columns = Mapping[str, tuple[str, ...]]


def columns(texts: Iterable[str]) -> Columns:
    """Return the columns and factors of each signal that texts such as "torque=-u1,0.1*i2" name."""
    mapping: dict[str, tuple[str, ...]] = {}
    for text in texts:
        signal, _, names = text.partition("=")
        if signal not in MEANINGS:
            raise unknown("signal", signal, MEANINGS)
        mapping[signal] = mapping.get(signal, ()) + tuple(name.strip() for name in names.split(",") if name.strip())
    return mapping


def _plain(name: str) -> str:
    """Return a column's name without path, unit and punctuation; the joint's number comes last."""
    name = _UNIT.sub("", name.strip().lower())
    last = re.split(r"[/.]", name)[-1]
    if joint := _JOINT.search(name):
        last = _JOINT.sub("", last) + (joint[1] or ("1" if joint[2] else "2"))
    return re.sub(r"[^\w\u0300-\u036f]|_", "", last)  # accents count: q is not its rate


def _unit(name: str) -> str:
    """Return the unit in a column's name, or ""."""
    found = _UNIT.search(name.lower())
    return re.sub(r"[\s.*·⋅]", "", (found[1] or found[2] or "") + "/s" * bool(found[3])) if found else ""


def _factor(path: Path, signal: str, name: str) -> float:
    """Return the factor of the unit in a column's name; 1 if there is none."""
    unit = _unit(name)
    if signal == "torque" and re.fullmatch(r"(i|current)\d?", _plain(name)):
        unit = "a"
    if unit in _OTHER.union(*_NAMED.values()) - {*_NAMED[signal]}:
        raise ValueError(
            f"{path}: {signal} must not be in {unit}, as {name!r} is: give another column, or a factor, "
            f"as in --signals {signal}=0.1*NAME"
        )
    return _NAMED[signal].get(unit, 1.0)


def _choose(path: Path, signal: str, items: tuple[str, ...], names: list[str]) -> dict[str, float]:
    """Return column and factor of one or both joints: a user's items, or names of that meaning."""
    plain: dict[str, list[str]] = {}
    for name in names:
        plain.setdefault(_plain(name), []).append(name)
    ends = [("",), ("0",)] if signal == "time" else [("1", "2"), ("0", "1")]

    def of_joints(stems: Iterable[str]) -> list[str]:
        each = ([stem + end for end in pair] for stem in stems for pair in ends)
        keys = next((keys for keys in each if plain.keys() >= set(keys)), [])
        if more := next((plain[key] for key in keys if len(plain[key]) > 1), None):
            raise ValueError(f"{path}: {' and '.join(more)} may be the {signal}: say which by --signals {signal}=...")
        return [plain[key][0] for key in keys]

    scale, scaled, chosen = 1.0, False, dict[str, float]()
    amperes = any("A" in item.split("*") for item in items if item not in names)
    for item in items:
        if item == "A" and item not in names:
            raise ValueError(f"--signals {signal}=A needs the torque constant [N m/A], as in {signal}=0.091*A")
        sign, factors, last = _ITEM.fullmatch(item).groups() if item not in names else ("", "", item)  # type: ignore[union-attr]
        parts = (UNITS.get(part) or float(part) for part in factors.split("*")[:-1])
        size = math.prod(parts, start=-1.0 if sign else 1.0)
        scaled |= bool(factors)
        if last in UNITS and last not in names:
            scale, scaled = scale * size * UNITS[last], True
        elif columns := [last] if last in names else of_joints([_plain(last)]):
            chosen |= dict.fromkeys(columns, size)
        else:
            raise unknown(f"column of {signal} of {path} (--signals)", last, names)
    chosen = chosen or dict.fromkeys(of_joints(MEANINGS[signal].split()), 1.0)
    if signal == "time" and not items and [_plain(name) for name in chosen] in (["sec"], ["secs"]):  # a stamp of ROS
        chosen |= dict.fromkeys(of_joints(["nanosec", "nsecs"]), 1e-9)
    for name in chosen:
        milli = 1e-3 if amperes and _unit(name) == "ma" else 1.0
        chosen[name] *= scale * (milli if scaled else _factor(path, signal, name))
    return chosen


def _signals(path: Path, table: Any, mapping: Columns) -> tuple[dict[str, Array], list[str]]:
    """Return the signals of a table [n x number of columns], and the columns in words."""
    signals, remarks = {}, []
    for signal in MEANINGS:
        wanted, left_out = 1 if signal == "time" else 2, mapping.get(signal) == ()
        columns = {} if left_out else _choose(path, signal, mapping.get(signal, ()), [*table.columns])
        if len(columns) == wanted or (signal == "time" and len(columns) == 2):  # s and ns
            parts = [table[name] - (table[name].iloc[0] if signal == "time" else 0) for name in columns]  # keeps digits
            signals[signal] = np.column_stack(parts).astype(float) * [*columns.values()]
            remarks.append(", ".join(name if size == 1 else f"{size:.4g}*{name}" for name, size in columns.items()))
        elif columns or signal != "velocity":
            need = f"give {wanted} column{'s' * (wanted - 1)} of {signal} by --signals {signal}=..."
            raise ValueError(f"{path}: {need}, got {len(columns)}; there are {', '.join(table.columns)}")
    bad = ~np.isfinite(np.hstack([*signals.values()])).all(axis=1)
    if bad.any():
        line = table.index[bad.argmax()]
        raise ValueError(f"{path}: numbers must be finite, but {bad.sum()} rows lack one, first line {line}")
    return signals, remarks


def read(path: Path, mapping: Columns | None = None, zero: Sequence[float] = (0.0, 0.0)) -> Log:
    """Return the log of a file: a text with columns, perhaps in .gz; or .mat, .npz or .parquet.

    Args:
        path: of the file.
        mapping: the columns of each signal, of `columns`; others are found by their meaning.
        zero: angles of this package at which the file's positions are zero [2] rad.

    Raises:
        ValueError: a column is missing, time runs back or has a gap, or an encoder is unplugged.
    """
    try:
        with warnings.catch_warnings(action="error"):
            table = _read_table(path)
    except (ValueError, Warning, ImportError, NotImplementedError, zipfile.BadZipFile) as problem:
        raise ValueError(f"{path} must be a table with a header and equal lines: {problem}") from None
    if len(table) < 200:
        raise ValueError(f"{path} must have 200 samples or more, got {len(table)}")
    signals, found = _signals(path, table, mapping or {})
    position, torque = signals["position"], signals["torque"]
    if {"alive", "time_s"} <= {*table.columns} and "command_1_Nm" in found[2]:  # of `fbl-gym evaluate --trace`
        torque = np.concatenate([torque[1:], torque[-1:]])  # each command was decided at the row before
    time, steps, sample, unit = _times(path, signals["time"].sum(axis=1), table.index)
    _refuse_faults(path, position, steps)
    dt = max(STEP, float(f"{sample:.2g}"))
    times = np.arange(time[0], time[-1], dt)
    impulse = np.concatenate([np.zeros((1, 2)), np.cumsum(torque[:-1] * steps[:, None], axis=0)])
    at_times = np.column_stack([np.interp(times, time, column) for column in (*position.T, *impulse.T)])
    even = at_times[:-1, :2] + zero
    held = np.diff(at_times[:, 2:], axis=0) / dt  # the mean of the held command over each step
    states = np.hstack([smooth(even, dt, order) for order in (0, 1)])
    counts = _counts(position)
    difference, how = _velocity(path, signals.get("velocity"), position, time, counts)
    peak = np.abs(torque).max(axis=0)
    full = (np.abs(torque) >= peak * (1 - 1e-9)).sum(axis=0) * (peak > 0)
    remarks = (
        f"columns {'; '.join(found)}" + f"; time is taken to be in {unit}" * (unit != "s"),
        f"{len(time)} samples in {np.ptp(time):.4g} s, {1 / sample:.4g} Hz, intervals of {1e3 * sample:.3g} ms "
        f"(99 %: {1e3 * np.quantile(steps, 0.99):.3g}, longest: {1e3 * steps.max():.3g})",
        "counts per turn: " + ", ".join(f"{n:.0f}" if n else "not found" for n in counts) + f"; velocity: {how}",
        f"commands up to {peak[0]:.3g} and {peak[1]:.3g} N m, {full[0]} and {full[1]} samples of them at that value"
        + ", perhaps a limit" * bool(full.max() > 20),
    )
    rows = frozenset(row.tobytes() for row in np.hstack([position, torque]))
    return Log(path.name, dt, even, states, held, counts, difference, sample, rows, remarks)


def _read_table(path: Path) -> Any:
    """Return a `pandas.DataFrame` of a file's numbers, NaN where there is none.

    Its index has the lines of the file, or rows if it has none. Columns without a header are "0",
    "1" and so on; those of a matrix q of MATLAB "q_0", "q_1".
    """
    if path.suffix.lower() == ".parquet":
        table = pd.read_parquet(io.BytesIO(read_bytes(path)))
    elif path.suffix.lower() in (".mat", ".npz"):
        load = loadmat if path.suffix.lower() == ".mat" else np.load
        given = {name: np.atleast_2d(value) for name, value in load(io.BytesIO(read_bytes(path))).items()}
        fields = {name: value for name, value in given.items() if value.ndim == 2 and value.dtype.kind in "biuf"}
        tall = {name: pd.DataFrame(value if len(value) >= len(value.T) else value.T) for name, value in fields.items()}
        for name, value in tall.items():
            value.columns = [name] if len(value.columns) == 1 else [f"{name}_{i}" for i in value]
        table = pd.concat([*tall.values()], axis=1)
    else:
        table = _read_text(read_text(path))
    table.columns = [str(name).strip() for name in table.columns]
    return table.apply(_numbers)


def _numbers(column: Any) -> Any:
    """Return the numbers of a column, NaN where none is; of dates, seconds since the first."""
    numbers = pd.to_numeric(column, errors="coerce")
    if numbers.notna().any():
        return numbers
    dates = pd.to_datetime(column, errors="coerce", format="ISO8601", utc=True)
    return (dates - dates.min()).dt.total_seconds()


def _read_text(text: str) -> Any:
    """Return the table of a text, whatever its separators, comments and decimal signs are.

    A last line without line break may be cut, and is left out.
    """
    lines = {n: line for n, line in enumerate(text.lstrip("\ufeff").split("\n")[:-1], 1) if line.strip()}
    rows = {n: line for n, line in lines.items() if line.lstrip()[0] not in "#%"}
    first = min(rows, default=0)
    separator = next((each for each in ";\t|," if each in rows.get(first, "")), r"\s+")
    if separator == r"\s+" and rows:  # a unit belongs to the name before it
        rows[first] = re.sub(r"\s+(?=[\[(])|(?<=[\[(])[^\])]+", lambda found: "".join(found[0].split()), rows[first])

    def split(line: str) -> list[str]:
        return [part.strip(' "') for part in re.split(separator.replace("|", "[|]"), line.strip())]

    def has_numbers(parts: list[str]) -> bool:
        return any(re.fullmatch(r"[-+.,\d\s]*\d[-+.,eE\d\s]*", part) for part in parts)

    above = [line.lstrip("#% ") for n, line in lines.items() if n < first]
    parts = split(rows.get(first, ""))
    header = not has_numbers(parts)
    if not header and above and len(split(above[-1])) == len(parts):
        rows, header = {0: above[-1], **rows}, True  # NumPy writes its header as a comment
    after = next(itertools.islice(rows, 1, None), first)
    units = split(rows.get(after, ""))
    if header and after > first and len(units) == len(parts) and not has_numbers(units):  # a line of units
        join = (separator if separator != r"\s+" else " ").join
        rows[first] = join(f"{name}[{unit.strip('[]()')}]" for name, unit in zip(parts, units, strict=True))
        del rows[after]
    comma = separator != "," and any("," in line for line in [*rows.values()][1:])
    table = pd.read_csv(
        io.StringIO("\n".join(rows.values())), sep=separator, decimal="," if comma else ".", header=0 if header else None,
        index_col=False, skipinitialspace=True,
    )  # fmt: skip
    return table.set_axis([*rows][header:])


def _times(path: Path, time: Array, lines: Any) -> tuple[Array, Array, float, str]:
    """Return times [n], intervals [n - 1] and their median in s, and the unit by their size."""
    steps = np.diff(time)
    if (back := steps <= 0).any():
        line = lines[1:][back][0]
        raise ValueError(f"{path}: time must increase, but {back.sum()} rows do not, first line {line}: delete them")
    sample = float(np.median(steps))
    unit = next((unit for unit in ("s", "ms", "us", "ns") if FASTEST <= sample * UNITS[unit] <= SLOWEST), "s")
    time, steps, sample = time * UNITS[unit], steps * UNITS[unit], sample * UNITS[unit]
    if not FASTEST <= sample <= SLOWEST:
        raise ValueError(f"{path}: time must be in s, {FASTEST:g} to {SLOWEST:g} s a sample, got {sample:g}")
    if time[-1] + 1.001 * sample < LEAST_TIME:
        raise ValueError(f"{path} must be at least {LEAST_TIME:g} s long, got {time[-1]:.4g} s")
    last = steps.argmax()
    if steps[last] > MAX_GAP * sample:
        gap = f"a gap of {steps[last]:.3g} s after {time[last]:g} s"
        raise ValueError(f"{path} has {gap}: cut it there into two logs, before line {lines[last + 1]}")
    return time, steps, sample, unit


def _refuse_faults(path: Path, position: Array, steps: Array) -> None:
    """Raise an error if a reading stays the same or jumps."""
    fastest = (np.abs(np.diff(position, axis=0)) / steps[:, None]).max(axis=0)
    for joint, speed in enumerate(fastest, 1):
        name = f"{path}: position {joint}"
        if speed == 0.0:
            raise ValueError(f"{name} does not change: its encoder is unplugged, or the column is another one")
        if speed > MAX_SPEED:
            causes = "unplugged, turns not unwrapped, or degrees (--signals position=deg)"
            raise ValueError(f"{name} must not jump, got {speed:.3g} rad/s: {causes}")


def refuse_twice(logs: Iterable[Log]) -> None:
    """Raise an error if two logs share most of their samples, which would narrow all intervals."""
    for one, other in itertools.combinations(logs, 2):
        if 2 * len(one.rows & other.rows) > min(len(one.rows), len(other.rows)):
            raise ValueError(f"each log must be given once, but {one.name} and {other.name} have the same samples")


def _counts(position: Array) -> Array:
    """Return the readings per turn of each joint [2]; 0 where they are no multiples of a step."""
    counts = np.zeros(2)
    for joint, column in enumerate(position.T):
        levels = np.unique(column)
        steps = np.diff(levels)
        steps = steps[steps > 1e-9]
        if not len(steps):  # the joint rests
            continue
        multiples = steps / steps.min()
        whole = np.abs(multiples - np.round(multiples)) < 0.05
        if whole.mean() > 0.95 and len(levels) < 0.9 * len(column):
            counts[joint] = 2 * np.pi / np.median(steps[np.round(multiples) == 1])
    return counts


def _velocity(path: Path, velocity: Array | None, position: Array, time: Array, counts: Array) -> tuple[int, str]:
    """Return the samples of the difference that the velocity is, and how it was computed."""
    if velocity is None:
        return 0, "not logged"
    for n in range(1, 9):
        difference = (position[n:] - position[:-n]) / (time[n:] - time[:-n])[:, None]
        apart, every = np.median(np.abs(difference - velocity[n:])), n * np.median(np.diff(time))
        # A better velocity differs by 0.3 steps of the encoder from a difference of its readings.
        step = 2 * np.pi / counts.max() if counts.any() else np.inf
        if apart < min(0.05 * np.median(np.abs(velocity)), 0.2 * step / every):
            return n, f"difference of positions {n} sample{'s' * (n > 1)} apart"
    slope = smooth(position, float(np.median(np.diff(time))), 1)
    for joint, (one, other) in enumerate(zip(velocity.T, slope.T, strict=True), 1):
        factor = one @ other / (other @ other)  # the least squares of velocity = factor * slope
        alike = (one @ other) ** 2 / max((one @ one) * (other @ other), 1e-30)
        far = f"is {factor:.3g} times as fast" if alike > 0.8 and not 0.5 < factor < 2.0 else ""
        if np.ptp(position[:, joint - 1]) > 0.1 and alike < 0.5:  # a joint that rests has noise alone
            far = f"shares {100 * alike:.0f} % of its motion"
        if far:
            raise ValueError(
                f"{path}: velocity {joint} must be that of position {joint}, but {far}: check the units of time, position "
                "and velocity and the order of columns, or leave it out by --signals velocity="
            )
    noise = np.std(velocity - slope, axis=0)
    return 0, f"measured, noise {noise[0]:.3g} and {noise[1]:.3g} rad/s"
