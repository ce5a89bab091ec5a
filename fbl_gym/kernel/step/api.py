"""The functions that `batch.py` calls, compiled once and cached on disk."""

import numpy as np

from fbl_gym.kernel.arm.elastic import advance_elastic, elastic_acceleration_and_friction, start_motors
from fbl_gym.kernel.arm.flexible import advance_flexible, flexible_acceleration_and_friction, start_bends
from fbl_gym.kernel.arm.physics import acceleration_and_friction, advance_by_law, advance_smoothly
from fbl_gym.kernel.maths.fastmath import cached_njit, clip, inline_njit, kernel_njit, log, merged_njit, named, sqrt
from fbl_gym.kernel.memory import layout
from fbl_gym.kernel.memory.layout import BLOCK, LANES, SETTINGS, SETTINGS_SIZE
from fbl_gym.kernel.memory.views import array_at, record_at
from fbl_gym.kernel.step import readings
from fbl_gym.kernel.step.episode import judge, start
from fbl_gym.kernel.step.events import apply_events, carry_payload
from fbl_gym.kernel.step.motion import update_reference
from fbl_gym.kernel.step.torque import add_ripple, apply_torque, command, disturb, start_disturbance

_ZERO, _ONE = np.int64(0), np.uint64(1)


@inline_njit
def _count(settings, number):
    """Return the number of arms in a block."""
    return min(LANES, settings.lanes - number * LANES)


@merged_njit
def _views(memory, settings, first):
    """Return a block, the same memory as rows, its last commands, its way-points, and the tables.

    All but the tables are shifted so that lane 0 is the lane `first` of the batch.
    """
    index = settings.blocks + first // LANES * settings.block_size + first % LANES
    rows = array_at(memory, index, (settings.block_size // LANES, LANES), np.float64)
    queue = array_at(memory, index + LANES * settings.queue_row, (settings.delay_steps + 1, 3, LANES), np.float64)
    waypoints = array_at(memory, index + LANES * settings.waypoint_row, (settings.waypoints, 2, LANES), np.float64)
    tables = array_at(memory, SETTINGS_SIZE, (settings.actions - SETTINGS_SIZE,), np.float64)
    return record_at(memory, index, BLOCK), rows, queue, waypoints, tables


@inline_njit
def _finite(memory, settings, lane):
    """Return True if a lane's action is finite."""
    action1, action2 = memory[settings.actions + 2 * lane], memory[settings.actions + 2 * lane + 1]
    return (action1 - action1 == 0.0) & (action2 - action2 == 0.0)


@inline_njit
def _over(memory, settings, lane):
    """Return True if a lane's episode is over and does not start again by itself."""
    block = record_at(memory, settings.blocks + lane // LANES * settings.block_size, BLOCK)
    return settings.autoreset != layout.NEXT_STEP and block.status[lane % LANES] != layout.RUNNING


@kernel_njit
def check(memory):
    """Return -1 if all lanes can be stepped.

    Else return 2 i if lane i is the first whose action is not finite, or 2 i + 1 if all actions
    are finite and lane i is the first whose episode is over.
    """
    settings = record_at(memory, 0, SETTINGS)
    for lane in range(settings.lanes):
        if not _finite(memory, settings, lane):
            return 2 * lane
    for lane in range(settings.lanes):
        if _over(memory, settings, lane):
            return 2 * lane + 1
    return -1


@merged_njit
def _load(block, rows, queue, settings, tables, width, substep, real, rare):
    """Apply events, and set torques and payload of a block, for one physics step."""
    if rare and settings.events > 0:
        apply_events(block, rows, settings, tables, width, substep)
    if substep == 0 or settings.torque_varies:
        apply_torque(block, queue, settings, width, substep)
        if real and settings.rippled:
            add_ripple(block, settings, width)
        if real:
            disturb(block, settings, tables, width, substep)
    if real and settings.has_payload:
        carry_payload(block, settings, width, substep)


@merged_njit
def _end_episodes(block, rows, waypoints, settings, tables, memory, first, count):
    """Mark the lanes whose episode is over, and those that start another one now."""
    for lane in range(count):
        over = block.terminated[lane] + block.truncated[lane] != 0.0
        restarts = over and settings.autoreset == layout.SAME_STEP
        if restarts:
            size = settings.observation_size
            final = array_at(memory, settings.final_observations + first * size, (count, size), np.float64)
            readings.observe(block, rows, waypoints, settings, tables, final, lane, lane + 1)
        elif settings.autoreset == layout.NEXT_STEP and block.status[lane] != layout.RUNNING:
            block.reward[lane], block.terminated[lane], block.truncated[lane] = 0.0, 0.0, 0.0
            restarts = True
        block.status[lane] = layout.ENDED if over else layout.RUNNING
        if restarts:
            block.episode[lane] += _ONE
            block.status[lane] = layout.RESTART


@merged_njit
def _end(block, rows, waypoints, settings, tables, memory, first, count, width, real, rare, accelerate):
    """End the control step of a block, after its physics: clock, readings, reference and reward."""
    for lane in range(width):
        block.step[lane] += _ONE
    readings.sense(block, rows, settings, width, real, rare, accelerate)
    update_reference(block, waypoints, settings, tables, width)
    judge(block, settings, width)
    ended = 0
    for lane in range(count):
        over = block.terminated[lane] + block.truncated[lane] != 0.0
        ended += over | (block.status[lane] != layout.RUNNING)
    if ended > 0:
        _end_episodes(block, rows, waypoints, settings, tables, memory, first, count)
    flags = array_at(memory, settings.flags, (2, settings.lanes), np.uint8)
    for lane in range(count):
        memory[settings.rewards + first + lane] = block.reward[lane]
        flags[0, first + lane] = block.terminated[lane] != 0.0
        flags[1, first + lane] = block.truncated[lane] != 0.0


@merged_njit
def _start(block, rows, queue, waypoints, settings, tables, width, real, rare):
    """Start an episode in the lanes marked RESTART; return True if there are some."""
    restarts = False
    for lane in range(width):
        if block.status[lane] == layout.RESTART:
            restarts = True
            start(block, rows, queue, waypoints, settings, tables, lane)
            if real:
                start_disturbance(block, settings, tables, lane)
            if rare and settings.elastic:
                start_motors(block, settings, lane)
            if rare and settings.flexible:
                start_bends(block, settings, lane)
    return restarts


def _block_step(name, real, rare, advance, accelerate):
    """Return the step of a block in a class of scenarios, without the code of other classes.

    `real`: there may be payloads, disturbances, dry friction and errors of the sensors. `rare`:
    also events, encoders and another engine.
    `advance` moves a block over a physics step, `accelerate` computes its acceleration. No other
    class has the same `name`.
    """

    def step_lanes(memory, out, settings, moves, first, count, width):
        """Step `count` lanes from the lane `first` on, of which `width` are computed."""
        block, rows, queue, waypoints, tables = _views(memory, settings, first)
        if moves:
            command(block, rows, queue, settings, memory, first, count)
            for substep in range(settings.substeps):
                _load(block, rows, queue, settings, tables, width, substep, real, rare)
                advance(block, settings, width)
            _end(block, rows, waypoints, settings, tables, memory, first, count, width, real, rare, accelerate)
        restarts = _start(block, rows, queue, waypoints, settings, tables, width, real, rare)
        if restarts or not moves:
            readings.sense(block, rows, settings, width, real, rare, accelerate)
        size = settings.observation_size
        observations = array_at(out, first * size, (count, size), np.float64)
        readings.observe(block, rows, waypoints, settings, tables, observations, _ZERO, count)

    return merged_njit(named(step_lanes, name))


def _batch_step(name, step_lanes):
    """Return the step of a batch by that of its blocks. It is compiled when it is first called."""

    def step(memory, out, moves, begin, end):
        """Advance every lane by one control step; start an episode in lanes marked RESTART.

        Nothing moves if `check` finds a problem.

        Args:
            memory: of the batch, see `layout.py`.
            out: takes the observations [lanes * size].
            moves: False: no lane moves, but episodes start and readings are taken.
            begin: first of the blocks to step, whose lanes `check` has passed.
            end: the block after the last of them; 0: check and step all.

        Returns:
            The result of `check`; then reward, terminated and truncated of the first lane.
        """
        settings = record_at(memory, 0, SETTINGS)
        lanes = settings.lanes
        if end == 0:
            end = (lanes + LANES - 1) // LANES
            problem = check(memory) if moves else -1
            if problem >= 0:
                return problem, 0.0, False, False
        for number in range(begin, end):
            count = _count(settings, number)
            # Few lanes pay for half a block, which is a vector too; one lane pays for itself.
            width = 1 if count == 1 else (LANES // 2 if count <= LANES // 2 else LANES)
            step_lanes(memory, out, settings, moves, number * LANES, count, width)
        flags = array_at(memory, settings.flags, (2, lanes), np.uint8)
        return -1, memory[settings.rewards], flags[0, 0] != 0, flags[1, 0] != 0

    return cached_njit(named(step, name))


def _lane_step(name, step_lanes):
    """Return the step of one lane by that of a block, not compiled."""

    def step_lane(memory, out, moves, lane):
        """Do as `step` to one lane, which is a thread of a GPU.

        A lane that `check` would refuse does not move: its reward is NaN, and `settings.refused` is
        one more than the result of `check`, for one of such lanes.
        """
        settings = record_at(memory, 0, SETTINGS)
        if moves:
            infinite, over = not _finite(memory, settings, lane), _over(memory, settings, lane)
            if infinite or over:
                settings.refused = 2 * lane + (1 if infinite else 2)
                memory[settings.rewards + lane] = np.nan
                moves = False
        step_lanes(memory, out, settings, moves, lane, 1, 1)

    return named(step_lane, name)


@cached_njit
def inspect(memory, out):
    """Write the truth of each lane that the blocks do not have.

    Args:
        memory: of the batch, see `layout.py`.
        out: takes it, records of the type `INSTANT` [lanes].
    """
    settings = record_at(memory, 0, SETTINGS)
    for i in range(len(out)):
        block, _, _, _, _ = _views(memory, settings, i)
        lane, instant = _ZERO, out[i]
        if settings.flexible:
            a1, a2, friction1, friction2 = flexible_acceleration_and_friction(block, settings, lane)
        elif settings.elastic:
            a1, a2, friction1, friction2 = elastic_acceleration_and_friction(block, settings, lane)
        else:
            law = settings.friction_law
            a1, a2, friction1, friction2 = acceleration_and_friction(block, settings, lane, law)
        instant.time = float(np.int64(block.step[lane])) * settings.control_dt
        instant.acceleration[0], instant.acceleration[1] = a1, a2
        instant.friction_torque[0], instant.friction_torque[1] = friction1, friction2


@cached_njit
def load(memory, substep):
    """Set the torques and payloads of a physics step, for an engine other than the kernel.

    With `end`, it replaces `step`, and compiles only if used: load(memory, 0) to
    load(memory, substeps - 1), each before the engine's physics step, then `end`, then `step`
    without motion.

    Args:
        memory: of the batch, see `layout.py`.
        substep: number of the physics step within the control step. 0 takes the actions first.

    Returns:
        The result of `check` at substep 0, else -1.
    """
    if substep == 0:
        problem = check(memory)
        if problem >= 0:
            return problem
    settings = record_at(memory, 0, SETTINGS)
    for number in range((settings.lanes + LANES - 1) // LANES):
        block, rows, queue, _, tables = _views(memory, settings, number * LANES)
        count = _count(settings, number)
        if substep == 0:
            command(block, rows, queue, settings, memory, number * LANES, count)
        _load(block, rows, queue, settings, tables, count, substep, True, True)
    return -1


@cached_njit
def end(memory):
    """End a control step after its physics: clock, readings, reference, reward and flags."""
    settings = record_at(memory, 0, SETTINGS)
    for number in range((settings.lanes + LANES - 1) // LANES):
        block, rows, _, waypoints, tables = _views(memory, settings, number * LANES)
        first, count, accelerate = number * LANES, _count(settings, number), readings.accelerate_by_law
        _end(block, rows, waypoints, settings, tables, memory, first, count, count, True, True, accelerate)


@inline_njit
def scale_lane(observations, columns, out, results, size, lane):
    """Do as `subtract_and_scale` to one lane, with `size` numbers of an observation."""
    for i in range(results):
        less, value = int(columns[5 * i + 1]), observations[lane * size + int(columns[5 * i])]
        value -= (observations[lane * size + less] if less >= 0 else 0.0) + columns[5 * i + 2]
        value /= columns[5 * i + 3]
        if columns[5 * i + 3] < 0.0:
            share = log(abs(value) + sqrt(value * value + 1.0))
            value = -share if value > 0.0 else share
        out[lane * results + i] = clip(value, columns[5 * i + 4])


@cached_njit
def subtract_and_scale(observations, columns, out):
    """Write entries of observations, less others, in units of their scales, within bounds.

    Args:
        observations: [lanes * size].
        columns: of each result, the entry, the entry that is subtracted, or -1 for none, a number
            that is subtracted, the scale, and the bound, [results * 5]. With a scale of -s, the
            result is asinh(x / s).
        out: takes them [lanes * results].
    """
    results = len(columns) // 5
    lanes = len(out) // results
    for lane in range(lanes):
        scale_lane(observations, columns, out, results, len(observations) // lanes, lane)


#: Plain scenarios, real ones, those with rare options, elastic joints, and links that bend.
_CLASSES = {
    "plain": (False, False, advance_smoothly, readings.accelerate_smoothly),
    "real": (True, False, advance_by_law, readings.accelerate_by_law),
    "rare": (True, True, advance_by_law, readings.accelerate_by_law),
    "elastic": (True, True, advance_elastic, readings.accelerate_elastic),
    "flexible": (True, True, advance_flexible, readings.accelerate_flexible),
}

_BLOCK_STEPS = {name: _block_step(name, *each) for name, each in _CLASSES.items()}
STEPS = [_batch_step(name, step) for name, step in _BLOCK_STEPS.items()]
LANE_STEPS = [_lane_step(name, step) for name, step in _BLOCK_STEPS.items()]

#: Indices in `STEPS`, with settings of which any one needs it; the first that fits is taken.
_NEEDS = (
    (2, ("external_physics",)),
    (4, ("flexible",)),
    (3, ("elastic",)),
    (2, ("events", "history", "dropout_length")),
    (1, ("has_payload", "disturbance_kind", "friction_law", "noisy", "rippled")),
)


def step_number(settings):
    """Return the index in `STEPS` of the step that a scenario needs."""
    return next((number for number, names in _NEEDS if any(settings[name] > 0 for name in names)), 0)
