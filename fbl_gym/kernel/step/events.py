"""Events at a time, and the payload: changes of the arm between two physics steps."""

import numpy as np

from fbl_gym.kernel.arm.elastic import both
from fbl_gym.kernel.arm.flexible import chain_momentum, chain_velocity
from fbl_gym.kernel.arm.physics import inertia_terms, lump, rotor_of, solve_terms
from fbl_gym.kernel.maths.fastmath import inline_njit, kernel_njit, larger, sincos
from fbl_gym.kernel.memory.layout import DRIVE_CHANGE, DROP, EVENT_ROWS, FRICTION_CHANGE, KNOCK, PICK_UP
from fbl_gym.kernel.memory.views import pair, put


@inline_njit
def _rotor(block, settings, lane):
    """Return the rotors that meet an impulse; an elastic joint passes none to its motor."""
    return (0.0, 0.0) if settings.elastic else rotor_of(block, settings, lane)


@inline_njit
def _inertia(block, settings, lane):
    """Return the inertia that meets an impulse."""
    r1, r2 = _rotor(block, settings, lane)
    _, cos2 = sincos(block.position[1, lane])
    return inertia_terms(block.lumped[0, lane], block.lumped[1, lane], block.lumped[2, lane], r1, r2, cos2)


@inline_njit
def _momentum(block, settings, lane):
    """Return the momentum of the joints of a lane, and of the hinges of links that bend."""
    if settings.flexible:
        return chain_momentum(block, settings, lane, _rotor(block, settings, lane))
    (m11, m12, m22), (v1, v2) = _inertia(block, settings, lane), pair(block.velocity, lane)
    return m11 * v1 + m12 * v2, m12 * v1 + m22 * v2, 0.0, 0.0


@inline_njit
def _velocity(block, settings, lane, momentum):
    """Return the velocities that `_momentum` belongs to."""
    if settings.flexible:
        return chain_velocity(block, settings, lane, _rotor(block, settings, lane), momentum)
    m11, m12, m22 = _inertia(block, settings, lane)
    return *solve_terms(m11, m12, m22, momentum[0], momentum[1]), 0.0, 0.0


@kernel_njit
def change_payload(block, settings, lane, payload, held):
    """Let a lane carry another payload, with the part of the option `payload` in it.

    The velocities after a grasp conserve momentum.
    """
    momentum = _momentum(block, settings, lane)
    grasps = payload > block.payload[lane]
    block.payload[lane], block.held_payload[lane] = payload, held
    lump(block, settings, lane)
    if grasps:
        v1, v2, u1, u2 = _velocity(block, settings, lane, momentum)
        put(block.velocity, lane, (v1, v2))
        put(block.bend_velocity, lane, (u1, u2))


@kernel_njit
def carry_payload(block, settings, width, substep):
    """Take up or release the payload where its time has come."""
    changes = 0
    for lane in range(width):
        now = float(np.int64(block.step[lane])) * settings.substeps + substep
        changes += (now == block.payload_pick_up[lane]) | (now == block.payload_drop[lane])
    if changes == 0:  # the usual case, found by a loop without branches
        return
    for lane in range(width):
        now = float(np.int64(block.step[lane])) * settings.substeps + substep
        if now > 0.0 and block.payload_pick_up[lane] != block.payload_drop[lane]:
            if now == block.payload_pick_up[lane]:
                held = block.payload_mass[lane]
                change_payload(block, settings, lane, block.payload[lane] + held, held)
            if now == block.payload_drop[lane]:
                change_payload(block, settings, lane, larger(block.payload[lane] - block.held_payload[lane], 0.0), 0.0)


@kernel_njit
def apply_events(block, rows, settings, tables, width, substep):
    """Apply the events of a block whose time has come."""
    for event in range(settings.events):
        kind, row = tables[settings.event_table + event], settings.event_row + EVENT_ROWS * event
        for lane in range(width):
            if rows[row, lane] == float(np.int64(block.step[lane])) * settings.substeps + substep:
                _apply(block, settings, lane, kind, rows[row + 1, lane], rows[row + 2, lane])


@kernel_njit
def _apply(block, settings, lane, kind, size1, size2):
    """Apply an event to a lane."""
    if kind == PICK_UP:
        change_payload(block, settings, lane, block.payload[lane] + size1, block.held_payload[lane])
    elif kind == DROP:
        change_payload(block, settings, lane, 0.0, 0.0)  # `payload_drop` has nothing left to release
    elif kind == FRICTION_CHANGE:
        for friction in (block.viscous, block.coulomb, block.stiction, block.load_friction):
            friction[0, lane] *= size1
            friction[1, lane] *= size2
    elif kind == DRIVE_CHANGE:
        for torque in (block.gain, block.ripple):
            torque[0, lane] *= size1
            torque[1, lane] *= size2
    elif kind == KNOCK:
        change1, change2, change3, change4 = _velocity(block, settings, lane, (size1, size2, 0.0, 0.0))
        (v1, v2), (u1, u2) = both(block.velocity, block.bend_velocity, lane)
        put(block.velocity, lane, (v1 + change1, v2 + change2))
        put(block.bend_velocity, lane, (u1 + change3, u2 + change4))
