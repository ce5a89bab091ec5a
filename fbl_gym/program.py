"""A scenario in numbers: its options packed into the settings and tables of `memory.py`."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Context, Decimal

import numpy as np
from numpy.typing import NDArray

from fbl_gym import memory
from fbl_gym.arm import Array
from fbl_gym.checks import check_choice, check_whole
from fbl_gym.interface import ACTIONS, Interface, Limits, make_layout
from fbl_gym.memory import LANES, SETTINGS
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

Settings = NDArray[np.void]
"""One record of the type `memory.SETTINGS`, shape ()."""

MAX_NUMBERS = 2**27
"""Largest count of numbers that a single option may add to a block of lanes: 1 GiB."""

_PAIR = 2 * LANES  # numbers of a pair of rows: both joints of a block

_FIELDS = {
    "position": "measured_position",
    "velocity": "measured_velocity",
    "acceleration": "measured_acceleration",
    "reference_position": "reference_position",
    "reference_velocity": "reference_velocity",
    "reference_acceleration": "reference_acceleration",
    "previous_action": "action",
}
"""The field of a block that each slot of the observation shows, without the preview."""


@dataclass(frozen=True)
class Program:
    """A scenario as the kernel needs it, and the interface that policies are given.

    Attributes:
        interface: for policies.
        settings: a record of the type `memory.SETTINGS`, shape ().
        tables: arrays that the scenario contains, one after the other.
    """

    interface: Interface
    settings: Settings
    tables: Array


def make_program(
    scenario: Scenario,
    *,
    action: str,
    reward: Reward,
    preview: int,
    max_episode_steps: int | None = None,
    autoreset: int = memory.NO_AUTORESET,
) -> Program:
    """Pack a scenario and the options of an environment into numbers.

    Args:
        scenario: the task.
        action: kind of action, one of `ACTIONS`.
        reward: weights of the reward.
        preview: number of reference samples ahead in the observation.
        max_episode_steps: shortens the episode; None leaves its length to the scenario.
        autoreset: `memory.NO_AUTORESET`, `NEXT_STEP` or `SAME_STEP`.
    """
    settings = np.zeros((), SETTINGS)
    tables: list[float] = []
    settings["autoreset"] = autoreset
    settings["substeps"] = scenario.substeps
    settings["control_dt"], settings["physics_dt"] = scenario.control_dt, scenario.physics_dt
    steps = scenario.steps
    settings["last_step"] = steps if max_episode_steps is None else min(steps, max_episode_steps)
    _pack_arm(settings, scenario)
    _pack_noise(settings, scenario)
    _pack_friction(settings, scenario)
    _pack_actuator(settings, scenario)
    _pack_disturbance(settings, tables, scenario)
    waypoints = _pack_reference(settings, tables, scenario)
    settings["waypoints"] = waypoints
    settings["block_size"] = memory.BLOCK_SIZE + _PAIR * (int(settings["delay_steps"]) + 1 + waypoints)
    settings["initial_error"] = scenario.initial_error
    preview = check_whole("preview", preview)
    _check_size("preview", preview, "", 6 * LANES * preview)
    limits = scenario.limits
    settings["max_position"], settings["max_velocity"] = limits.position, limits.velocity
    settings["max_acceleration"] = limits.acceleration
    interface = _make_interface(scenario, action, limits, preview)
    settings["action_kind"] = ACTIONS.index(action)
    settings["action_limit"] = interface.action_limit
    _pack_observation(settings, interface)
    _pack_reward(settings, reward)
    return Program(interface, settings, np.array(tables))


def _check_size(option: str, value: float, unit: str, numbers: int) -> None:
    """Raise an error if an option adds too many numbers to a block."""
    if numbers > MAX_NUMBERS:
        raise ValueError(
            f"{option} must be at most some {MAX_NUMBERS / (numbers / value):.3g}{unit} here, which take "
            f"{MAX_NUMBERS / 2**27:g} GiB for {LANES} arms, got {value!r}{unit}"
        )


def _make_interface(scenario: Scenario, action: str, limits: Limits, preview: int) -> Interface:
    """Return the interface of a scenario; check that its action is possible."""
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
    """Return e**x to the last bit on every machine; C libraries differ."""
    return float(_EXACT.exp(Decimal(x)))


def _log1p(x: float) -> float:
    """Return log(1 + x) to the last bit on every machine."""
    return float(_EXACT.ln(_EXACT.add(1, Decimal(x))))


def _pack_arm(settings: Settings, scenario: Scenario) -> None:
    arm, error = scenario.arm, scenario.parameter_error
    settings["parameters"] = arm.m1, arm.m2, arm.L1, arm.L2
    settings["gravity"], settings["centre"], settings["inertia"] = arm.gravity, arm.centre, arm.inertia
    settings["ratio"] = 1.0
    settings["payload_pick_up"] = settings["payload_drop"] = np.inf
    if error is None:
        return
    settings["ratio"] = error.ratios
    radius = _log1p(error.radius)
    settings["log_radius"] = [radius if name in error.parameters else 0.0 for name in PARAMETERS]
    settings["drawn_together"] = error.sampling == "together"
    payload = error.payload
    if isinstance(payload, Payload):
        settings["payload_mass"] = payload.mass
        settings["payload_pick_up"] = round(payload.pick_up / scenario.physics_dt)
        settings["payload_drop"] = np.inf if payload.drop is None else round(payload.drop / scenario.physics_dt)


def _pack_noise(settings: Settings, scenario: Scenario) -> None:
    settings["senses_acceleration"] = "acceleration" in scenario.sensors
    if scenario.noise is None:
        return
    for sensor, name in enumerate(SENSORS):
        error: SensorError | None = getattr(scenario.noise, name)
        if error is not None:
            settings["noise_std"][sensor] = error.std
            settings["noise_bias"][sensor] = error.bias
            settings["quantization"][sensor] = error.quantization
    settings["noisy"] = any(np.any(settings[name]) for name in ("noise_std", "noise_bias", "quantization"))


def _pack_friction(settings: Settings, scenario: Scenario) -> None:
    settings["v_s"] = 1.0
    friction = scenario.friction
    if friction is None:
        return
    settings["friction_law"] = memory.EXACT_FRICTION if friction.law == "exact" else memory.LITERAL_FRICTION
    if friction.coulomb == (0.0, 0.0) and friction.stiction == (0.0, 0.0):
        settings["friction_law"] = memory.NO_FRICTION  # viscous friction alone is smooth
    for name in ("viscous", "coulomb", "stiction", "v_s"):
        settings[name] = getattr(friction, name)


def _pack_actuator(settings: Settings, scenario: Scenario) -> None:
    actuator, n = scenario.actuator, scenario.substeps
    settings["torque_limit"] = np.inf if actuator.torque_limit is None else actuator.torque_limit
    delay = round(actuator.delay / scenario.physics_dt)
    steps = -(-delay // n)
    _check_size("actuator.delay", actuator.delay, " s", _PAIR * steps)
    # Up to physics step `delay_switch`, the command of `steps` ago acts, then the next one.
    settings["delay_steps"] = steps
    settings["delay_switch"] = delay - (steps - 1) * n if steps else 0
    if actuator.lag > 0:
        settings["lag_start"] = 1.0
        settings["lag_half"] = _exp(-0.5 * scenario.physics_dt / actuator.lag)
        settings["lag_end"] = _exp(-scenario.physics_dt / actuator.lag)
    settings["torque_varies"] = delay > 0 or actuator.lag > 0


def _pack_disturbance(settings: Settings, tables: list[float], scenario: Scenario) -> None:
    disturbance, h, n = scenario.disturbance, scenario.physics_dt, scenario.substeps
    if disturbance is None:
        return
    if isinstance(disturbance, ArrayDisturbance):
        kind, period = memory.ARRAY, round(disturbance.dt / h)
        varies = period % n != 0
        settings["disturbance_table"], settings["disturbance_samples"] = len(tables), len(disturbance.torque)
        tables.extend(value for sample in disturbance.torque for value in sample)
    elif isinstance(disturbance, PiecewiseConstantDisturbance):
        kind, period = memory.PIECEWISE_CONSTANT, round(disturbance.period / h)
        varies = period % n != 0
    elif isinstance(disturbance, PulseDisturbance):
        kind, period = memory.PULSES, round(disturbance.period / h)
        width, start = round(disturbance.width / h), round(disturbance.start / h)
        settings["disturbance_width"], settings["disturbance_start"] = width, start
        varies = any(time % n for time in (period, width, start))
    else:
        assert isinstance(disturbance, SineDisturbance)
        kind, period, varies = memory.SINE, 0, True
        settings["disturbance_rate"] = 2 * np.pi * np.array(disturbance.frequency)
        settings["disturbance_phase_drawn"] = disturbance.phase is None
        settings["disturbance_phase"] = 0.0 if disturbance.phase is None else disturbance.phase
    if not isinstance(disturbance, ArrayDisturbance):
        settings["disturbance_amplitude"] = disturbance.amplitude
    settings["disturbance_kind"], settings["disturbance_period"] = kind, period
    settings["torque_varies"] |= varies


def _pack_reference(settings: Settings, tables: list[float], scenario: Scenario) -> int:
    """Pack the reference; return the number of way-points, levels or phases that a block holds."""
    reference, steps = scenario.reference, scenario.steps
    settings["reference_table"] = len(tables)
    if isinstance(reference, ArrayReference):
        # One row more than the episode. Its last sample is held for previews beyond it.
        _check_size("duration", scenario.duration, " s", 6 * (steps + 2))
        samples = reference.samples(scenario.control_dt * np.arange(steps + 2))
        samples[-1, 2:] = 0.0
        settings["reference_kind"], settings["reference_points"] = memory.SAMPLES, len(samples)
        tables.extend(samples.ravel())
        return 0
    if isinstance(reference, SineReference | FourierReference):
        n = reference.harmonics if isinstance(reference, FourierReference) else 1
        phase = None if isinstance(reference, FourierReference) else reference.phase
        _check_size("reference.harmonics", n, "", _PAIR * n)
        weights = 1.0 / np.arange(1, n + 1)
        amplitudes = np.outer(weights / weights.sum(), reference.amplitude)
        settings["reference_kind"], settings["reference_points"] = memory.HARMONICS, n
        settings["reference_middle"] = reference.centre
        settings["base_rate"] = 2 * np.pi * reference.frequency
        settings["reference_phases_drawn"] = phase is None
        tables.extend(amplitudes.ravel())
        tables.extend((0.0, 0.0) if phase is None else phase)  # type: ignore[arg-type]
        return n
    period = reference.move_time + reference.hold_time if isinstance(reference, MinimumJerk) else reference.period
    settings["point_time"] = period
    settings["reference_low"], settings["reference_high"] = reference.low, reference.high
    # Each segment of filtered steps also holds the filter's state at its start.
    pairs = 3 if isinstance(reference, FilteredSteps) else 1
    if reference.points is None:
        n = int(scenario.duration / period + 1e-9) + 2  # one more than is reached, for a jump at the very end
        _check_size("duration", scenario.duration, " s", pairs * _PAIR * n)
        settings["reference_table"] = -1
    else:
        n = len(reference.points)
        tables.extend(value for point in reference.points for value in point)
    settings["reference_points"] = n
    if isinstance(reference, MinimumJerk):
        settings["reference_kind"], settings["move_time"] = memory.MINIMUM_JERK, reference.move_time
    elif isinstance(reference, Steps):
        settings["reference_kind"] = memory.STEPS
    else:
        settings["reference_kind"], settings["bandwidth"] = memory.FILTERED_STEPS, reference.bandwidth
    return pairs * n


def _pack_observation(settings: Settings, interface: Interface) -> None:
    layout, bounds = interface.layout, interface.layout.bounds[1]
    settings["observation_size"] = layout.size
    rows: list[int] = []
    for slot in layout.slots:
        if slot.name == "preview":
            settings["preview"] = slot.size // 6
        else:
            rows += memory.rows(_FIELDS[slot.name])
    settings["observed"] = len(rows)
    settings["observed_row"][: len(rows)] = rows
    settings["observed_bound"][: len(rows)] = bounds[: len(rows)]


def _pack_reward(settings: Settings, reward: Reward) -> None:
    total = reward.weight_tracking + reward.weight_effort + reward.weight_chatter
    logarithmic = reward.tracking == "log"
    settings["reward_logarithmic"] = logarithmic
    settings["reward_scale"] = 1 / reward.resolution if logarithmic else 1 / reward.worst
    settings["reward_norm"] = 1 / _log1p(reward.worst / reward.resolution)
    settings["weight_tracking"] = reward.weight_tracking / total
    settings["weight_effort"] = reward.weight_effort / total
    settings["weight_chatter"] = reward.weight_chatter / total
