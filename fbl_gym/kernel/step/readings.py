"""The sensors' readings, and the observation that contains them."""

import numpy as np

from fbl_gym.kernel.arm.elastic import elastic_acceleration_and_friction
from fbl_gym.kernel.arm.flexible import flexible_acceleration_and_friction
from fbl_gym.kernel.arm.physics import acceleration_and_friction, over_lanes_by_law
from fbl_gym.kernel.maths.fastmath import clip, floor, inline_njit, kernel_njit, merged_njit, named, over_lanes
from fbl_gym.kernel.maths.streams import normals, stream_key, uniforms
from fbl_gym.kernel.memory.views import pair, put
from fbl_gym.kernel.step.motion import reference

_NOISE = np.array([stream_key(f"{sensor} noise") for sensor in ("position", "velocity", "acceleration")])
_DROPOUT = stream_key("lost readings")
_POSITION, _VELOCITY, _ACCELERATION = np.arange(3)  # the sensors, as indices of `measured`
_ZERO = np.uint64(0)


@merged_njit
def sense(block, rows, settings, width, real, rare, accelerate):
    """Take the readings of a block, which depend on its state alone; see `api.STEPS`."""
    if settings.senses_acceleration and not settings.external_physics:
        accelerate(block, settings, width)
    _read(block, settings, width)
    if real and settings.noisy:
        for sensor in range(3 if settings.senses_acceleration else 2):
            _disturb_reading(block, settings, width, sensor)
    if rare and settings.history > 0:
        _encode(block, rows, settings, width)
    if rare and settings.dropout_length > 0:
        _lose(block, settings, width)
    _limit(block, settings, width)


def _storing(function):
    """Return a function that stores the acceleration which another one returns."""

    def accelerate(block, settings, lane, *law):
        a1, a2, _, _ = function(block, settings, lane, *law)
        put(block.acceleration, lane, (a1, a2))

    return inline_njit(named(accelerate, function.__name__))


accelerate_smoothly, accelerate_by_law = over_lanes_by_law(_storing(acceleration_and_friction))
accelerate_elastic = over_lanes(_storing(elastic_acceleration_and_friction))
accelerate_flexible = over_lanes(_storing(flexible_acceleration_and_friction))


@kernel_njit
def _read(block, settings, width):
    """Take the exact readings."""
    position, velocity = block.position, block.velocity
    if settings.encoder_on_motor:
        position, velocity = block.motor_position, block.motor_velocity
    for joint in range(2):
        for lane in range(width):
            block.measured[_POSITION, joint, lane] = position[joint, lane]
            block.measured[_VELOCITY, joint, lane] = velocity[joint, lane]
            if settings.senses_acceleration:
                block.measured[_ACCELERATION, joint, lane] = block.acceleration[joint, lane]


@kernel_njit
def _limit(block, settings, width):
    """Clip the readings of a block: a sensor reads no further than its range."""
    for sensor in range(3):
        bound = settings.sensor_range[sensor]
        for joint in range(2):
            for lane in range(width):
                block.measured[sensor, joint, lane] = clip(block.measured[sensor, joint, lane], bound)


@kernel_njit
def _disturb_reading(block, settings, width, sensor):
    """Add bias and noise to the readings of one sensor, and quantize them."""
    measured, std, bias = block.measured[sensor], block.noise_std[sensor], block.noise_bias[sensor]
    if settings.has_noise[sensor]:
        for lane in range(width):
            draw1, draw2 = normals(block.seed[lane], _NOISE[sensor], block.episode[lane], block.step[lane], _ZERO)
            measured[0, lane] += std[0, lane] * draw1
            measured[1, lane] += std[1, lane] * draw2
    for joint in range(2):
        for lane in range(width):
            measured[joint, lane] += bias[joint, lane]
        quantum = settings.quantization[sensor, joint]
        if quantum > 0.0:
            for lane in range(width):
                measured[joint, lane] = floor(measured[joint, lane] / quantum + 0.5) * quantum


@kernel_njit
def _encode(block, rows, settings, width):
    """Compute the velocity from the position readings, and show both as late as they are.

    The readings of a control step are at the row (step % history). Therefore sensing twice at the
    same step changes nothing. An episode starts as if the arm had moved uniformly before.
    """
    depth, interval = settings.history, settings.difference
    for lane in range(width):
        if block.step[lane] == 0:
            _recall(block, rows, settings, lane, 0)
            _recall(block, rows, settings, lane, 1)
    for lane in range(width):
        now = np.int64(block.step[lane]) % depth
        for joint in range(2):
            first = settings.history_row + joint
            reading, velocity = block.measured[0, joint, lane], block.measured[1, joint, lane]
            row = first + 4 * now
            rows[row, lane] = reading
            if interval > 0:
                before = rows[first + _row_of(now, interval, depth), lane]
                filtered = rows[first + _row_of(now, 1, depth) + 2, lane]
                velocity = (reading - before) / (interval * settings.control_dt)
                velocity = filtered + settings.low_pass * (velocity - filtered)
            rows[row + 2, lane] = velocity
            row = first + _row_of(now, settings.latency, depth)
            block.measured[0, joint, lane], block.measured[1, joint, lane] = rows[row, lane], rows[row + 2, lane]


@inline_njit
def _row_of(now, ago, depth):
    """Return the row with the readings of some control steps ago; a division would be slow."""
    return 4 * (now - ago if now >= ago else now - ago + depth)


@kernel_njit
def _lose(block, settings, width):
    """Show the last readings again where those of this control step are lost."""
    for lane in range(width):
        step, lost = np.int64(block.step[lane]), False
        for ago in range(min(settings.dropout_length, step)):
            draw, _, _, _ = uniforms(block.seed[lane], _DROPOUT, block.episode[lane], np.uint64(step - ago), _ZERO)
            lost |= draw < block.dropout[lane]
        for sensor in range(2):
            if lost:
                put(block.measured[sensor], lane, pair(block.kept[sensor], lane))
            else:
                put(block.kept[sensor], lane, pair(block.measured[sensor], lane))


@kernel_njit
def _recall(block, rows, settings, lane, joint):
    """Store the readings before an episode, with the errors of the sensors."""
    depth, interval, dt = settings.history, settings.difference, settings.control_dt
    position, speed = block.position[joint, lane], block.velocity[joint, lane]
    if settings.encoder_on_motor:
        position, speed = block.motor_position[joint, lane], block.motor_velocity[joint, lane]
    velocity = speed
    for ago in range(depth - 1, 0, -1):
        reading = _past(block, settings, lane, joint, _POSITION, position - ago * dt * speed, ago)
        if interval == 0:
            velocity = _past(block, settings, lane, joint, _VELOCITY, speed, ago)
        else:
            before = position - (ago + interval) * dt * speed
            before = _past(block, settings, lane, joint, _POSITION, before, ago + interval)
            velocity += settings.low_pass * ((reading - before) / (interval * dt) - velocity)
        row = settings.history_row + joint + 4 * (depth - ago)
        rows[row, lane], rows[row + 2, lane] = reading, velocity


@inline_njit
def _past(block, settings, lane, joint, sensor, value, ago):
    """Return a reading of some control steps before the episode, with its errors."""
    if settings.has_noise[sensor]:
        draws = normals(block.seed[lane], _NOISE[sensor], block.episode[lane], _ZERO, np.uint64(ago))
        value += block.noise_std[sensor, joint, lane] * draws[joint]
    value += block.noise_bias[sensor, joint, lane]
    quantum = settings.quantization[sensor, joint]
    return floor(value / quantum + 0.5) * quantum if quantum > 0.0 else value


@kernel_njit
def observe(block, rows, waypoints, settings, tables, out, first, last):
    """Write the observations of the lanes from `first` up to `last` to `out` [lanes x size]."""
    for column in range(0, settings.observed, 2):  # both joints, which lie side by side in both arrays
        row, bound = settings.observed_row[column], settings.observed_bound[column]
        for lane in range(first, last):
            out[lane, column] = clip(rows[row, lane], bound)
            out[lane, column + 1] = clip(rows[row + 1, lane], settings.observed_bound[column + 1])
    for column in range(2 * settings.past_actions):
        for lane in range(first, last):
            out[lane, settings.observed + column] = rows[settings.past_row + column, lane]
    for ahead in range(settings.preview):
        for lane in range(first, last):
            step = np.int64(block.step[lane]) + ahead + 1
            sample = reference(block, waypoints, settings, tables, lane, step)
            column = settings.observed + 2 * settings.past_actions + 6 * ahead
            for i in range(6):
                out[lane, column + i] = clip(sample[i], settings.sensor_range[i // 2])
