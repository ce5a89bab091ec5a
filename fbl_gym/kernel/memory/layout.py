"""The layout of a batch's memory: one array of 64-bit numbers, which the kernel reads and writes.

    settings | tables | actions | rewards | flags | final observations | block | block | ...

The settings are the same for all lanes; most of them follow from the declarations of the options.
The tables are the arrays that a scenario contains, such as the samples of a reference. A block is
the state of `LANES` lanes: its fields, among them the numbers that may vary, then the last torque
commands (three rows: both joints, and the command's own delay), the way-points of the reference and
the last actions (pairs of rows, one row a joint), the last readings of the encoder (four rows:
position and velocity), and the events.

The kernel and `batch.py` see the fields through the structured types `SETTINGS` and `BLOCK`:
`block.position[0, lane]` is the position of joint 1.

The settings: those that the options declare, then those of program, environment and batch.

    varied: fixed values of the numbers that may vary, in the order of `VARIED`.
    draws, draw_table: number of draws of an episode; index of the first in the tables, where each
        has `DRAW_SIZE` numbers.
    events, event_table: number of events; index of the first one's kind in the tables.
    queue_row to event_row: first row of each kind that a block has after its fields.
    last_step: the control step that truncates an episode.
    action_kind, action_limit: meaning and bounds of an action.
    observed, observed_row, observed_bound: number of columns of an observation before previous
        actions and preview; the row of a block that each of them shows, and its bound.
    preview: reference samples ahead.
    lanes, block_size: their number; numbers in a block.
    refused: on a GPU, a lane that did not move, see `api.step_lane`; else 0.
    actions, rewards, flags, final_observations, blocks: index of each part's first number in the
        memory. Actions are [lanes x 2]; flags are bytes, terminated [lanes] and truncated [lanes];
        final observations are [lanes x size] with SAME_STEP, else empty.

The fields of a block; the last axis is that of its lanes. Pairs are of both joints.

    position, velocity, acceleration: motion of the real arm [rad], [rad/s], and [rad/s^2] if a
        sensor reads it.
    lumped: lumped parameters of the real arm with the payload [kg m^2], [N m].
    parameters: m1, m2 [kg], L1, L2 [m].
    payload, held_payload: carried now, and the part of it that `payload_drop` releases [kg].
    fade: remainder of the lag at the three times of a physics step: start, half and end.
    action, command: the last action, within its limits; its torque command [N m].
    late, age: further delay of the last command [physics steps]; age of the one that the drives
        follow [control steps].
    judged: tracking error and command of the last step, which a restart leaves as they are.
    chatter: change of the command / torque limit, sum of both joints.
    target, lagged: command after delay and rate limit, then after the lag too [N m].
    torque: applied torque: the same times the gain, and the ripple [N m].
    disturbance, disturbance_phase: torque [N m], and phase of a sine [rad].
    tau: applied torque less disturbance at the three times [N m].
    motor_position, motor_velocity: of elastic joints [rad], [rad/s].
    load: torque on the links of elastic joints at the three times [N m].
    bend, bend_velocity: of the hinges of links that bend [rad], [rad/s].
    segment_inertia, segment_moment: J and f of `model/chain.py` with the payload [kg m^2], [kg m].
    measured: position [rad], velocity [rad/s] and acceleration [rad/s^2].
    kept: the last readings of position and velocity that were not lost.
    reference_position, reference_velocity, reference_acceleration: [rad], [rad/s], [rad/s^2].
    start_position: at the episode's start [rad].
    given_position, given_velocity: where the next episode starts, if not NaN [rad], [rad/s].
    given_reference: 1 if the next episode has the way-points that are there now.
    far: control steps in a row beyond `max_error`.
    reward, cost: of the last step; the cost is 1 if it ended beyond a constraint, else 0.
    terminated, truncated, status: 0 or 1; RUNNING, ENDED or RESTART.
    seed, episode, step: number of the episode with this seed; control steps since its start.

A draw in the tables is its row, joint, kind, two numbers, and the halves of its stream's key. The
numbers are the ends of a uniform distribution; the lower end and the logarithm of high / low of a
log-uniform one; the index in the tables and the count of the values of a choice.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from fbl_gym.options import Reward
from fbl_gym.records.record import Option, declarations
from fbl_gym.scenarios.scenario import Scenario

#: Number of lanes in a block.
LANES = 16

# Kinds, as numbers in the settings, in the order of the options' classes. The friction laws are
# arguments of compiled functions, which Numba would compile again for each plain int.
NO_FRICTION, EXACT_FRICTION, LITERAL_FRICTION = np.arange(3)
NO_DISTURBANCE, PIECEWISE_CONSTANT, SINE, PULSES, ARRAY = range(5)
MINIMUM_JERK, STEPS, FILTERED_STEPS, ONE_SINE, FOURIER, SAMPLES = range(6)
NORMALIZED, TORQUE, ACCELERATION = range(3)
NO_AUTORESET, NEXT_STEP, SAME_STEP = range(3)
PICK_UP, DROP, FRICTION_CHANGE, DRIVE_CHANGE, KNOCK = range(5)

#: Rows of a block that an event takes: its time [physics steps] and a size per joint.
EVENT_ROWS = 3

# The status of a lane: within an episode, after its end, or about to start the next one.
RUNNING, ENDED, RESTART = 0.0, 1.0, 2.0

# Kinds of distributions.
UNIFORM, LOG_UNIFORM, CHOICE = range(3)

#: Largest number of columns of an observation, without preview and previous actions.
COLUMNS = 14


def _options(option: type) -> Iterator[Any]:
    """Yield the class of an option, and those of the options in it."""
    yield option
    for declaration in declarations(option).values():
        for inner in declaration.classes:
            yield from _options(inner) if issubclass(inner, Option) else ()


_DRAWN: dict[str, Any] = {}
_FIXED: dict[str, Any] = {}
for _option in (*_options(Scenario), *_options(Reward)):
    for _field in declarations(_option).values():
        if _field.kernel:
            (_DRAWN if _field.varies else _FIXED)[_field.kernel] = _field.dtype
    _DRAWN |= _option.drawn
    _FIXED |= _option.derived

#: The numbers that may differ between episodes: each episode fills their rows of a block.
VARIED = np.dtype([*_DRAWN.items()])

_COUNTS = (
    "draws", "draw_table", "events", "event_table", "queue_row", "waypoint_row", "past_row", "history_row", "event_row",
    "last_step", "action_kind", "observation_size", "observed", "preview", "autoreset",
    "lanes", "block_size", "refused", "actions", "rewards", "flags", "final_observations", "blocks",
)  # fmt: skip
_FIXED |= {"varied": (float, VARIED.itemsize // 8), "action_limit": (float, 2), **dict.fromkeys(_COUNTS, int)}
_FIXED |= {"observed_row": (int, COLUMNS), "observed_bound": (float, COLUMNS)}

SETTINGS = np.dtype([*_FIXED.items()], align=True)

#: Numbers of a draw in the tables.
DRAW_SIZE = 7

_PAIR, _TIMES = (float, 2), (float, (3, 2))
_FIELDS: dict[str, Any] = {
    "position": _PAIR, "velocity": _PAIR, "acceleration": _PAIR,
    "lumped": (float, 5), "parameters": (float, 4), "payload": float, "held_payload": float,
    **_DRAWN,
    "fade": (float, 3), "action": _PAIR, "command": _PAIR, "late": float, "age": float, "chatter": float,
    "target": _PAIR, "lagged": _PAIR, "torque": _PAIR, "disturbance": _PAIR, "disturbance_phase": _PAIR, "tau": _TIMES,
    "motor_position": _PAIR, "motor_velocity": _PAIR, "load": _TIMES,
    "bend": _PAIR, "bend_velocity": _PAIR, "segment_inertia": (float, 4), "segment_moment": (float, 4),
    "measured": (float, (3, 2)), "kept": (float, (2, 2)),
    "reference_position": _PAIR, "reference_velocity": _PAIR, "reference_acceleration": _PAIR,
    "start_position": _PAIR, "given_position": _PAIR, "given_velocity": _PAIR, "given_reference": float,
    "far": float, "judged": (float, 4), "reward": float, "cost": float,
    "terminated": float, "truncated": float, "status": float,
    "seed": np.uint64, "episode": np.uint64, "step": np.uint64,
}  # fmt: skip

BLOCK = np.dtype(
    [(name, np.dtype(kind).base, (*np.dtype(kind).shape, LANES)) for name, kind in _FIELDS.items()], align=True
)

#: What `api.inspect` computes of a lane [s], [rad/s^2], [N m]; blocks have the rest of it.
INSTANT = np.dtype([("time", float), ("acceleration", float, 2), ("friction_torque", float, 2)])

SETTINGS_SIZE = SETTINGS.itemsize // 8
ROWS = BLOCK.itemsize // (8 * LANES)


def rows(field: str) -> range:
    """Return the rows of a block that a field takes; a row is `LANES` numbers."""
    dtype, offset = BLOCK.fields[field][:2]  # type: ignore[index]
    return range(offset // (8 * LANES), (offset + dtype.itemsize) // (8 * LANES))


#: Row of a block that holds the first of the numbers that may vary.
FIRST_VARIED = rows(next(iter(_DRAWN)))[0]
