"""From the action to the torque on the joints: limit, delay, lag, disturbance."""

import numpy as np

from fbl_gym.kernel.arm.physics import load_on_joints, lumped_terms
from fbl_gym.kernel.maths.fastmath import ceil, clip, floor, inline_njit, kernel_njit, larger, rint, sincos, smaller
from fbl_gym.kernel.maths.streams import TWO_PI, stream_key, uniforms
from fbl_gym.kernel.memory import layout
from fbl_gym.kernel.memory.views import pair, put

_STREAM = stream_key("disturbance")
_JITTER = stream_key("jitter")
_ZERO = np.uint64(0)


@kernel_njit
def command(block, rows, queue, settings, memory, first, count):
    """Set the torque commands of `count` lanes of a block, whose actions begin at lane `first`."""
    for joint in range(2):
        for lane in range(count):
            action = memory[settings.actions + 2 * (first + lane) + joint]
            block.action[joint, lane] = clip(action, settings.action_limit[joint])
    _keep_past(block, rows, queue, settings, count)
    (limit1, limit2), (scale1, scale2) = settings.torque_limit, settings.torque_scale
    for lane in range(count):
        tau1, tau2 = _asked_torque(block, settings, lane)
        tau1, tau2 = clip(tau1, limit1), clip(tau2, limit2)
        before1, before2 = pair(block.command, lane)
        block.chatter[lane] = abs(tau1 - before1) / scale1 + abs(tau2 - before2) / scale2
        put(block.command, lane, (tau1, tau2))
        put(queue[0], lane, (tau1, tau2))
    if settings.jittered:
        for lane in range(count):
            draw, _, _, _ = uniforms(block.seed[lane], _JITTER, block.episode[lane], block.step[lane], _ZERO)
            block.late[lane] = queue[0, 2, lane] = rint(block.jitter[lane] * draw)


@inline_njit
def _keep_past(block, rows, queue, settings, count):
    """Move the last commands and actions back by one control step, and store the new actions."""
    for age in range(settings.delay_steps, 0, -1):
        for row in range(3 if settings.jittered else 2):
            for lane in range(count):
                queue[age, row, lane] = queue[age - 1, row, lane]
    first = settings.past_row
    for row in range(first + 2 * settings.past_actions - 1, first + 1, -1):
        for lane in range(count):
            rows[row, lane] = rows[row - 2, lane]
    for joint in range(2 if settings.past_actions > 0 else 0):
        for lane in range(count):
            rows[first + joint, lane] = block.action[joint, lane]


@inline_njit
def _asked_torque(block, settings, lane):
    """Return the torque that a lane's action asks for."""
    a1, a2 = pair(block.action, lane)
    if settings.action_kind == layout.NORMALIZED:
        return a1 * settings.torque_limit[0], a2 * settings.torque_limit[1]
    return nominal_torque(block, settings, lane, a1, a2) if settings.action_kind == layout.ACCELERATION else (a1, a2)


@inline_njit
def nominal_torque(block, settings, lane, a1, a2):
    """Return the nominal feedback linearisation mapping at the measured state (figure 2)."""
    m1, m2, length1, length2 = settings.parameters
    lumped = lumped_terms(m1, m2, length1, length2, settings.gravity, settings.centre, settings.inertia)
    q, v = pair(block.measured[0], lane), pair(block.measured[1], lane)
    m11, m12, m22, load1, load2 = load_on_joints(lumped, (settings.rotor[0], settings.rotor[1]), q, v, (0.0, 0.0))
    return m11 * a1 + m12 * a2 - load1, m12 * a1 + m22 * a2 - load2


@kernel_njit
def apply_torque(block, queue, settings, width, substep):
    """Set the applied torque over a physics step."""
    # The newest command that has arrived, then the rate limit, the lag and the gain.
    for joint in range(2):
        for lane in range(width):
            block.tau[0, joint, lane] = queue[0, joint, lane]
    if settings.delay_steps > 0 and not settings.jittered:
        for lane in range(width):
            block.age[lane] = ceil((block.delay[lane] - substep) / settings.substeps)
    if settings.jittered:
        for lane in range(width):
            block.age[lane] = float(settings.delay_steps)  # the oldest one has always arrived
        for age in range(settings.delay_steps - 1, -1, -1):
            # An older command that arrives later is without effect.
            since, this = float(age * settings.substeps + substep), float(age)
            for lane in range(width):
                last, delay = block.age[lane], block.delay[lane] + queue[age, 2, lane]
                block.age[lane] = this if delay <= since else last
    for age in range(1, settings.delay_steps + 1):
        for joint in range(2):
            for lane in range(width):
                newer, delayed = block.tau[0, joint, lane], queue[age, joint, lane]
                block.tau[0, joint, lane] = delayed if block.age[lane] == age else newer
    for joint in range(2):
        for lane in range(width):
            start, half, end = block.fade[0, lane], block.fade[1, lane], block.fade[2, lane]
            before, rate, gain = block.target[joint, lane], block.rate_limit[joint, lane], block.gain[joint, lane]
            target = larger(smaller(block.tau[0, joint, lane], before + rate), before - rate)
            block.target[joint, lane] = target
            # A ramp over the whole step has the impulse of the limited rise at its start: a limit
            # that does not act gives a jump. A lag follows a ramp late by its time constant, once
            # the initial gap has faded. The gain comes last, so that its change acts at once.
            begin = target - (target - before) * (abs(target - before) / rate)
            rise = target - begin
            base = begin - rise * block.lag[lane]
            gap = block.lagged[joint, lane] - base
            lagged = base + rise + end * gap
            block.tau[0, joint, lane] = gain * (base + start * gap)
            block.tau[1, joint, lane] = gain * (base + 0.5 * rise + half * gap)
            block.tau[2, joint, lane] = gain * lagged
            block.lagged[joint, lane] = lagged
            block.torque[joint, lane] = gain * lagged


@inline_njit
def ripple_of(block, settings, lane, joint):
    """Return the torque ripple of a drive in the middle of a physics step."""
    angle, rate = block.position[joint, lane], block.velocity[joint, lane]
    if settings.elastic:
        angle, rate = block.motor_position[joint, lane], block.motor_velocity[joint, lane]
    angle += 0.5 * settings.physics_dt * rate
    sine, _ = sincos(settings.ripple_order[joint] * angle + block.ripple_phase[joint, lane])
    return block.ripple[joint, lane] * sine


@kernel_njit
def add_ripple(block, settings, width):
    """Add the torque ripple, which is held over a physics step."""
    for joint in range(2):
        for lane in range(width):
            ripple = ripple_of(block, settings, lane, joint)
            block.torque[joint, lane] += ripple
            for time in range(3):
                block.tau[time, joint, lane] += ripple


@kernel_njit
def disturb(block, settings, tables, width, substep):
    """Subtract the disturbance from the torque over a physics step."""
    elastic = settings.elastic
    tau = block.load if elastic else block.tau  # a disturbance of elastic joints loads the links, not the drives
    if settings.disturbance_kind == layout.NO_DISTURBANCE:
        return
    for time in range(3):
        if time == 0 or settings.disturbance_kind == layout.SINE:  # the others are constant over a physics step
            _renew(block, settings, tables, 0, width, substep + 0.5 * time)
        for joint in range(2):
            for lane in range(width):
                torque = 0.0 if elastic else tau[time, joint, lane]
                tau[time, joint, lane] = torque - block.disturbance[joint, lane]


@inline_njit
def _pick(block, settings, tables, lane, substep):
    """Return a disturbance other than a sine at the start of a physics step."""
    kind, period = settings.disturbance_kind, settings.disturbance_period
    amplitude1, amplitude2 = pair(block.disturbance_amplitude, lane)
    now = float(np.int64(block.step[lane])) * settings.substeps + substep
    if kind == layout.PIECEWISE_CONSTANT:
        level = np.uint64(floor(now / period))
        draw1, draw2, _, _ = uniforms(block.seed[lane], _STREAM, block.episode[lane], level, _ZERO)
        return (2.0 * draw1 - 1.0) * amplitude1, (2.0 * draw2 - 1.0) * amplitude2
    if kind == layout.PULSES:
        since = now - settings.disturbance_start
        phase = since - floor(since / period) * period
        on = 1.0 if since >= 0.0 and phase < settings.disturbance_width else 0.0
        return on * amplitude1, on * amplitude2
    if kind == layout.ARRAY:
        sample = int(smaller(floor(now / period), settings.disturbance_samples - 1.0))
        index = settings.disturbance_table + 2 * sample
        return tables[index], tables[index + 1]
    return 0.0, 0.0


@kernel_njit
def _renew(block, settings, tables, first, last, substep):
    """Set the disturbance of the lanes from `first` up to `last`, at a time in physics steps."""
    if settings.disturbance_kind == layout.SINE:
        for joint in range(2):
            for lane in range(first, last):
                amplitude, rate = block.disturbance_amplitude[joint, lane], block.disturbance_rate[joint, lane]
                steps = float(np.int64(block.step[lane])) * settings.substeps + substep
                sine, _ = sincos(rate * (steps * settings.physics_dt) + block.disturbance_phase[joint, lane])
                block.disturbance[joint, lane] = amplitude * sine
        return
    if settings.disturbance_kind == layout.PIECEWISE_CONSTANT:
        changes, period = 0, settings.disturbance_period
        for lane in range(first, last):
            now = float(np.int64(block.step[lane])) * settings.substeps + substep
            changes += floor(now / period) != floor((now - settings.substeps) / period)
        if changes == 0:  # the levels of the last step stay: a draw is slow
            return
    for lane in range(first, last):
        put(block.disturbance, lane, _pick(block, settings, tables, lane, substep))


@kernel_njit
def start_disturbance(block, settings, tables, lane):
    """Set the disturbance at the start of an episode."""
    phase1, phase2 = settings.disturbance_phase[0], settings.disturbance_phase[1]
    if settings.disturbance_phase_drawn:
        draw1, draw2, _, _ = uniforms(block.seed[lane], _STREAM, block.episode[lane], _ZERO, _ZERO)
        phase1, phase2 = TWO_PI * draw1, TWO_PI * draw2
    put(block.disturbance_phase, lane, (phase1, phase2))
    _renew(block, settings, tables, lane, lane + 1, 0.0)
