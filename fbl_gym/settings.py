"""The scenario in numbers: where each number of the kernel's arrays lies, and the arrays packed from a Scenario.

The kernel sees one flat array of doubles, a batch's memory: the settings (what holds for all lanes; behind them the user's
samples, levels and amplitudes), actions, rewards, flags, last observations, and the state (what differs between
lanes). The names below are indices into the settings, and into a block of the state.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Context, Decimal

import numpy as np

from fbl_gym.arm import Array
from fbl_gym.checks import check_choice, check_whole
from fbl_gym.interface import ACTIONS, Interface, Limits, make_layout
from fbl_gym.references import (
    ArrayReference,
    FilteredSteps,
    FourierReference,
    MinimumJerk,
    SineReference,
    Steps,
)
from fbl_gym.reward import Reward
from fbl_gym.scenarios import Scenario
from fbl_gym.uncertainty import (
    PARAMETERS,
    SENSORS,
    ArrayDisturbance,
    Payload,
    PiecewiseConstantDisturbance,
    PulseDisturbance,
    SensorError,
    SineDisturbance,
)

LANES = 16
"""Lanes are worked on in blocks of this many, whatever the batch: one environment is a block with one lane in use."""

PAIR = 2 * LANES
"""From a joint-1 row of numbers that come in pairs to that of the next pair."""

_place = 0


def _rows(count: int) -> range:
    """Where the next rows of a block begin."""
    global _place
    _place += count * LANES
    return range(_place - count * LANES, _place, LANES)


# Rows of a block of a batch's state; lane l of a row is l further. Two names in a row: joints 1 and 2.
(Q1, Q2, V1, V2, A1, A2) = _rows(6)  # position, velocity, acceleration
(P1, P2, P3, P4, P5) = _rows(5)  # true lumped parameters, with the payload that is carried
(M1, M2, L1, L2, LOAD) = _rows(5)  # true masses and lengths, payload carried [kg]
(U1, U2, ACTION1, ACTION2, CHATTER) = _rows(5)  # last torque command, last action, change of the command
(T1, T2, D1, D2) = _rows(4)  # applied torque and disturbance now
(S1, S2, H1, H2, E1, E2) = _rows(6)  # applied torque less disturbance at a physics step's start, half and end
(Y1, Y2, Y3, Y4, Y5, Y6) = _rows(6)  # measured position, velocity, acceleration
(R1, R2, R3, R4, R5, R6) = _rows(6)  # reference position, velocity, acceleration now
(START1, START2, PHASE1, PHASE2) = _rows(4)  # position at the episode's start, phase of a sine disturbance
(REWARD, TERMINATED, TRUNCATED, ENDED) = _rows(4)  # what the last step gave; whether the episode is over
(SEED, EPISODE, STEP) = _rows(3)  # unsigned 64-bit integers in the place of doubles: seed, episode, control step
QUEUE = _place  # past torque commands, a pair each, then the reference's way-points or phases
RESTART = 2.0  # ENDED of a lane that is to start an episode

# What is told of the truth: rows of the state as they lie there (the first, and how many), then what is computed of them.
TRUE_ROWS = ((Q1, 4), (P1, 10), (T1, 4), (R1, 6))
_TRUE = {
    "position": 2, "velocity": 2, "lumped": 5, "masses": 2, "lengths": 2, "payload": 1, "applied_torque": 2,
    "disturbance": 2, "reference": 2, "reference_velocity": 2, "reference_acceleration": 2,
    "time": 1, "acceleration": 2, "friction_torque": 2, "leakage": 2,
}  # fmt: skip
TRUE_COLUMNS = sum(_TRUE.values())
_ends = dict(zip(_TRUE, np.cumsum(list(_TRUE.values())).tolist(), strict=True))
TRUE: dict[str, slice | int] = {
    name: slice(_ends[name] - size, _ends[name]) if size > 1 else _ends[name] - 1 for name, size in _TRUE.items()
}
"""The columns of each field of `Truth`."""

# Kinds, as numbers in `settings`.
(NO_FRICTION, EXACT_FRICTION, LITERAL_FRICTION) = range(3)
(NO_DISTURBANCE, PIECEWISE_CONSTANT, SINE, PULSES, ARRAY) = range(5)
(REFERENCE_TABLE, MINIMUM_JERK, STEPS, FILTERED_STEPS, HARMONICS) = range(5)
(FRACTION, TORQUE, ACCELERATION) = range(3)

_size = 0


def _at(count: int = 1) -> int:
    """The index of the next setting, which takes `count` places."""
    global _size
    _size += count
    return _size - count


# Rates and sizes.
(BLOCK, SUBSTEPS, LAST_STEP, CONTROL_DT, PHYSICS_DT, SIZE, AUTORESET) = (_at() for _ in range(7))
# The nominal arm in the order of ArmParameters, and how the real one differs.
(ARM_M1, ARM_M2, ARM_L1, ARM_L2, GRAVITY, CENTRE, INERTIA) = (_at() for _ in range(7))
RATIO, LOG_RADIUS, TOGETHER = _at(4), _at(4), _at()
(LOAD_MASS, LOAD_ON, LOAD_OFF) = (_at() for _ in range(3))
# Sensors: position, velocity, acceleration, each for two joints.
SIGMA, BIAS, QUANTUM, NOISY = _at(6), _at(6), _at(6), _at()
SENSES_ACCELERATION = _at()
# Friction, per joint.
FRICTION, VISCOUS, COULOMB, STICTION, V_S = _at(), _at(2), _at(2), _at(2), _at(2)
# Disturbance: amplitude, timing in physics steps, sine's rate and phase, array's place behind the settings.
DISTURBANCE, PUSH, PUSH_EVERY, PUSH_WIDTH, PUSH_START = _at(), _at(2), _at(), _at(), _at()
PUSH_RATE, PUSH_PHASE, PUSH_DRAWN, PUSH_TABLE, PUSH_ROWS = _at(2), _at(2), _at(), _at(), _at()
# Actuator: limit, delay, decay of the lag over no, half and a whole physics step.
TORQUE_LIMIT, QUEUE_DEPTH, QUEUE_SWITCH = _at(2), _at(), _at()
(LAG_START, LAG_HALF, LAG_END) = (_at() for _ in range(3))
VARIES = _at()  # whether applied torque or disturbance can change within a control interval
# Reference: first row of its numbers, how many points (or harmonics), box, place behind the settings, times.
REFERENCE, REFERENCE_ROW, POINTS, LOW, HIGH, POINT_TABLE = _at(), _at(), _at(), _at(2), _at(2), _at()
(MOVE_TIME, POINT_TIME, BANDWIDTH, BASE_RATE, PHASES_DRAWN) = (_at() for _ in range(5))
MIDDLE, INITIAL_ERROR = _at(2), _at(2)
# Interface, limits and reward.
ACTION, ACTION_LIMIT, PREVIEW = _at(), _at(2), _at()
FIRST_ROW = {
    "position": Y1, "velocity": Y3, "acceleration": Y5,
    "reference_position": R1, "reference_velocity": R3, "reference_acceleration": R5, "previous_action": ACTION1,
}  # fmt: skip
"""The first of the two rows that each slot of the observation shows, its preview aside."""
COLUMNS = 2 * len(FIRST_ROW)
OBSERVED, OBSERVED_ROW, OBSERVED_BOUND = _at(), _at(COLUMNS), _at(COLUMNS)  # how many; row and bound of each
(MAX_POSITION, MAX_VELOCITY, MAX_ACCELERATION) = (_at() for _ in range(3))
(REWARD_LOG, REWARD_SCALE, REWARD_NORM, W_TRACKING, W_EFFORT, W_CHATTER) = (_at() for _ in range(6))
# A batch's own: how many lanes, and where the rest of its memory lies: actions given, rewards, terminated and truncated (a
# byte each), last observations, the blocks of its state.
(COUNT, GIVEN, REWARDS, FLAGS, LASTS, STATE) = (_at() for _ in range(6))
SETTINGS = _size

(NO_AUTORESET, NEXT_STEP, SAME_STEP) = range(3)

MOST = 2**27
"""How many numbers a single option may add to the memory of a block of lanes: 1 GiB."""


@dataclass(frozen=True)
class Program:
    """A scenario as the kernel needs it, and the interface that policies are given."""

    interface: Interface
    settings: Array


def make_program(
    scenario: Scenario,
    *,
    action: str,
    reward: Reward,
    preview: int,
    max_episode_steps: int | None = None,
    autoreset: int = NO_AUTORESET,
) -> Program:
    """Pack a scenario, and what the environment adds to it, into the kernel's numbers."""
    x = np.zeros(SETTINGS)
    tables: list[float] = []
    x[AUTORESET] = autoreset
    x[SUBSTEPS], x[CONTROL_DT], x[PHYSICS_DT] = scenario.substeps, scenario.control_dt, scenario.physics_dt
    x[LAST_STEP] = scenario.steps if max_episode_steps is None else min(scenario.steps, max_episode_steps)
    _pack_arm(x, scenario)
    _pack_noise(x, scenario)
    _pack_friction(x, scenario)
    _pack_actuator(x, scenario)
    _pack_disturbance(x, tables, scenario)
    x[BLOCK] = _pack_reference(x, tables, scenario, QUEUE + PAIR * (int(x[QUEUE_DEPTH]) + 1))
    x[INITIAL_ERROR : INITIAL_ERROR + 2] = scenario.initial_error
    preview = check_whole("preview", preview)
    _fits("preview", preview, "", 6 * LANES * preview)
    limits = scenario.limits
    x[MAX_POSITION], x[MAX_VELOCITY], x[MAX_ACCELERATION] = limits.position, limits.velocity, limits.acceleration
    interface = _make_interface(scenario, action, limits, preview)
    x[ACTION] = ACTIONS.index(action)
    x[ACTION_LIMIT : ACTION_LIMIT + 2] = interface.action_limit
    _pack_observation(x, interface)
    _pack_reward(x, reward)
    return Program(interface, np.concatenate([x, tables]))


def _fits(option: str, value: float, unit: str, numbers: int) -> None:
    """An error if an option takes too much memory.  numbers: how many doubles it adds to a block, about in proportion."""
    if numbers > MOST:
        raise ValueError(
            f"{option} must be at most some {MOST / (numbers / value):.3g}{unit} here, which take {MOST / 2**27:g} GiB for "
            f"{LANES} arms, got {value!r}{unit}"
        )


def _make_interface(scenario: Scenario, action: str, limits: Limits, preview: int) -> Interface:
    check_choice("action", action, ACTIONS)
    limit = scenario.actuator.torque_limit
    if action == "normalized":
        if limit is None:
            raise ValueError(
                "action='normalized' needs a torque limit, got actuator.torque_limit=None; use 'torque' or 'acceleration'"
            )
        bound, unit = (1.0, 1.0), "of the torque limit"
    elif action == "torque":
        # Without a limit, the box still needs one: far above what any arm here can use.
        bound, unit = (limit if limit is not None else (1e9, 1e9)), "N m"  # type: ignore[assignment]
    else:
        if "velocity" not in scenario.sensors:
            raise ValueError(
                f"action='acceleration' linearises with the measured velocity, but sensors={scenario.sensors} has none"
            )
        bound, unit = (limits.command,) * 2, "rad/s^2"
    slow = scenario.actuator.delay > 0 or scenario.actuator.lag > 0
    layout = make_layout(scenario.sensors, limits, bound if slow else None, unit, preview)
    return Interface(scenario.arm, layout, scenario.control_dt, limit, action, bound)  # type: ignore[arg-type]


_EXACT = Context(prec=50)


def _exp(x: float) -> float:
    """e**x to the last bit on every machine, which no C library promises."""
    return float(_EXACT.exp(Decimal(x)))


def _log1p(x: float) -> float:
    """log(1 + x), likewise."""
    return float(_EXACT.ln(_EXACT.add(1, Decimal(x))))


def _pack_arm(x: Array, scenario: Scenario) -> None:
    arm, error = scenario.arm, scenario.parameter_error
    x[ARM_M1 : INERTIA + 1] = arm.m1, arm.m2, arm.L1, arm.L2, arm.gravity, arm.centre, arm.inertia
    x[RATIO : RATIO + 4] = 1.0
    x[LOAD_ON] = x[LOAD_OFF] = np.inf
    if error is None:
        return
    x[RATIO : RATIO + 4] = error.ratios
    for i, name in enumerate(PARAMETERS):
        x[LOG_RADIUS + i] = _log1p(error.radius) if name in error.parameters else 0.0
    x[TOGETHER] = error.sampling == "together"
    load = error.payload
    if isinstance(load, Payload):
        x[LOAD_MASS] = load.mass
        x[LOAD_ON] = round(load.pick_up / scenario.physics_dt)
        x[LOAD_OFF] = np.inf if load.drop is None else round(load.drop / scenario.physics_dt)


def _pack_noise(x: Array, scenario: Scenario) -> None:
    x[SENSES_ACCELERATION] = "acceleration" in scenario.sensors
    if scenario.noise is None:
        return
    for i, name in enumerate(SENSORS):
        error: SensorError | None = getattr(scenario.noise, name)
        if error is not None:
            x[SIGMA + 2 * i : SIGMA + 2 * i + 2] = error.std
            x[BIAS + 2 * i : BIAS + 2 * i + 2] = error.bias
            x[QUANTUM + 2 * i : QUANTUM + 2 * i + 2] = error.quantization
    x[NOISY] = np.any(x[SIGMA : QUANTUM + 6] != 0)


def _pack_friction(x: Array, scenario: Scenario) -> None:
    x[V_S : V_S + 2] = 1.0
    friction = scenario.friction
    if friction is None:
        return
    x[FRICTION] = EXACT_FRICTION if friction.law == "exact" else LITERAL_FRICTION
    if friction.coulomb == (0.0, 0.0) and friction.stiction == (0.0, 0.0):
        x[FRICTION] = NO_FRICTION  # what is left, viscous friction, is smooth
    x[VISCOUS : VISCOUS + 2] = friction.viscous
    x[COULOMB : COULOMB + 2] = friction.coulomb
    x[STICTION : STICTION + 2] = friction.stiction
    x[V_S : V_S + 2] = friction.v_s


def _pack_actuator(x: Array, scenario: Scenario) -> None:
    actuator = scenario.actuator
    x[TORQUE_LIMIT : TORQUE_LIMIT + 2] = np.inf if actuator.torque_limit is None else actuator.torque_limit
    delay = round(actuator.delay / scenario.physics_dt)
    depth = -(-delay // scenario.substeps)
    _fits("actuator.delay", actuator.delay, " s", PAIR * depth)
    # Up to physics step QUEUE_SWITCH of a control interval the command of `depth` intervals ago acts, then the next one.
    x[QUEUE_DEPTH], x[QUEUE_SWITCH] = depth, delay - (depth - 1) * scenario.substeps if depth else 0
    if actuator.lag > 0:
        x[LAG_START] = 1.0
        x[LAG_HALF] = _exp(-0.5 * scenario.physics_dt / actuator.lag)
        x[LAG_END] = _exp(-scenario.physics_dt / actuator.lag)
    x[VARIES] = delay > 0 or actuator.lag > 0


def _pack_disturbance(x: Array, tables: list[float], scenario: Scenario) -> None:
    push, h, n = scenario.disturbance, scenario.physics_dt, scenario.substeps
    if push is None:
        return
    every = n
    if isinstance(push, PiecewiseConstantDisturbance):
        every = round(push.period / h)
        x[DISTURBANCE], x[PUSH_EVERY] = PIECEWISE_CONSTANT, every
        x[PUSH : PUSH + 2] = push.amplitude
    elif isinstance(push, SineDisturbance):
        x[DISTURBANCE], x[VARIES] = SINE, 1.0
        x[PUSH : PUSH + 2] = push.amplitude
        x[PUSH_RATE : PUSH_RATE + 2] = 2 * np.pi * np.array(push.frequency)
        x[PUSH_DRAWN] = push.phase is None
        x[PUSH_PHASE : PUSH_PHASE + 2] = 0.0 if push.phase is None else push.phase
    elif isinstance(push, PulseDisturbance):
        width, start = round(push.width / h), round(push.start / h)
        x[DISTURBANCE], x[PUSH_EVERY], x[PUSH_WIDTH], x[PUSH_START] = PULSES, round(push.period / h), width, start
        x[PUSH : PUSH + 2] = push.amplitude
        every = 1 if (width % n or start % n) else round(push.period / h)
    elif isinstance(push, ArrayDisturbance):
        every = round(push.dt / h)
        x[DISTURBANCE], x[PUSH_EVERY] = ARRAY, every
        x[PUSH_TABLE], x[PUSH_ROWS] = SETTINGS + len(tables), len(push.torque)
        tables.extend(value for row in push.torque for value in row)
    if every % n:
        x[VARIES] = 1.0


def _pack_reference(x: Array, tables: list[float], scenario: Scenario, row: int) -> int:
    """Pack the reference; returns the size of a block."""
    reference, steps = scenario.reference, scenario.steps
    x[REFERENCE_ROW] = row
    if isinstance(reference, ArrayReference):
        # One row more than the episode, whose last sample is held for previews beyond it.
        _fits("duration", scenario.duration, " s", 6 * (steps + 2))
        samples = reference.samples(scenario.control_dt * np.arange(steps + 2))
        samples[-1, 2:] = 0.0
        x[REFERENCE], x[POINT_TABLE], x[POINTS] = REFERENCE_TABLE, SETTINGS + len(tables), len(samples)
        tables.extend(samples.ravel())
        return row
    if isinstance(reference, SineReference | FourierReference):
        n = reference.harmonics if isinstance(reference, FourierReference) else 1
        phase = None if isinstance(reference, FourierReference) else reference.phase
        _fits("reference.harmonics", n, "", PAIR * n)
        weights = 1.0 / np.arange(1, n + 1)
        amplitudes = np.outer(weights / weights.sum(), reference.amplitude)
        x[REFERENCE], x[POINTS], x[POINT_TABLE] = HARMONICS, n, SETTINGS + len(tables)
        x[MIDDLE : MIDDLE + 2] = reference.centre
        x[BASE_RATE] = 2 * np.pi * reference.frequency
        x[PHASES_DRAWN] = phase is None
        tables.extend(amplitudes.ravel())
        tables.extend((0.0, 0.0) if phase is None else phase)  # type: ignore[arg-type]
        return row + PAIR * n
    period = reference.move_time + reference.hold_time if isinstance(reference, MinimumJerk) else reference.period
    x[POINT_TIME] = period
    x[LOW : LOW + 2], x[HIGH : HIGH + 2] = reference.low, reference.high
    if reference.points is None:
        n = int(scenario.duration / period + 1e-9) + 2  # one more than is reached, for a jump at the very end
        _fits("duration", scenario.duration, " s", (3 if isinstance(reference, FilteredSteps) else 1) * PAIR * n)
        x[POINT_TABLE] = -1.0
    else:
        n = len(reference.points)
        x[POINT_TABLE] = SETTINGS + len(tables)
        tables.extend(value for point in reference.points for value in point)
    x[POINTS] = n
    if isinstance(reference, MinimumJerk):
        x[REFERENCE], x[MOVE_TIME] = MINIMUM_JERK, reference.move_time
        return row + PAIR * n
    if isinstance(reference, Steps):
        x[REFERENCE] = STEPS
        return row + PAIR * n
    assert isinstance(reference, FilteredSteps)
    x[REFERENCE], x[BANDWIDTH] = FILTERED_STEPS, reference.bandwidth
    return row + 3 * PAIR * n  # each segment also holds the filter's state where it begins


def _pack_observation(x: Array, interface: Interface) -> None:
    layout, bounds = interface.layout, interface.layout.bounds[1]
    x[SIZE] = layout.size
    for slot in layout.slots:
        if slot.name == "preview":
            x[PREVIEW] = slot.size // 6
            continue
        for joint in range(2):
            column = int(x[OBSERVED])
            x[OBSERVED_ROW + column] = FIRST_ROW[slot.name] + LANES * joint
            x[OBSERVED_BOUND + column] = bounds[column]
            x[OBSERVED] += 1


def _pack_reward(x: Array, reward: Reward) -> None:
    total = reward.weight_tracking + reward.weight_effort + reward.weight_chatter
    x[REWARD_LOG] = reward.tracking == "log"
    x[REWARD_SCALE] = 1 / reward.resolution if x[REWARD_LOG] else 1 / reward.worst
    x[REWARD_NORM] = 1 / _log1p(reward.worst / reward.resolution)
    x[W_TRACKING] = reward.weight_tracking / total
    x[W_EFFORT] = reward.weight_effort / total
    x[W_CHATTER] = reward.weight_chatter / total
