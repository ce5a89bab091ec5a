"""A scenario in numbers: its options packed into the settings and tables of `memory.py`."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from decimal import Context, Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fbl_gym import memory
from fbl_gym.arm import Array, inertia_matrix
from fbl_gym.checks import Pair, check_choice, check_number, check_whole
from fbl_gym.events import EVENTS, DriveChange
from fbl_gym.interface import ACTIONS, Constraints, Interface, make_layout
from fbl_gym.memory import FIRST_VARIED, LANES, SETTINGS, VARIED
from fbl_gym.records import Distribution, ends, scaled
from fbl_gym.references import (
    ArrayReference,
    FilteredSteps,
    FourierReference,
    MinimumJerk,
    SineReference,
)
from fbl_gym.reward import Reward
from fbl_gym.scenarios import Scenario
from fbl_gym.scenarios.scenario import MAX_STEPS
from fbl_gym.streams import stream_key
from fbl_gym.uncertainty import (
    PARAMETERS,
    SENSORS,
    ArrayDisturbance,
    ParameterError,
    Payload,
    SensorError,
    SineDisturbance,
)

Settings = NDArray[np.void]
"""One record of the type `memory.SETTINGS`, shape ()."""

MAX_NUMBERS = 2**27
"""Largest count of numbers that a single option may add to a block of lanes: 1 GiB."""

MAX_BATCH_NUMBERS = 2**31
"""Largest count of numbers in a batch: 16 GiB."""

MAX_DECAY = 1.0
"""Product of physics_dt and the rate of decay by viscous friction, up to which Runge-Kutta is used;
it is stable up to 2.78."""

_PAIR = 2 * LANES  # numbers of a pair of rows: both joints of a block


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
    past_actions: int = 0,
    max_episode_steps: int | None = None,
    autoreset: int = memory.NO_AUTORESET,
) -> Program:
    """Pack a scenario and the options of an environment into numbers.

    Args:
        scenario: the task.
        action: kind of action, one of `ACTIONS`.
        reward: weights of the reward.
        preview: number of reference samples ahead in the observation.
        past_actions: least number of previous actions in the observation.
        max_episode_steps: shortens the episode; None leaves its length to the scenario.
        autoreset: `memory.NO_AUTORESET`, `NEXT_STEP` or `SAME_STEP`.
    """
    settings = np.zeros((), SETTINGS)
    tables: list[float] = []
    numbers = _Numbers(tables)
    settings["autoreset"] = autoreset
    settings["substeps"] = scenario.substeps
    settings["control_dt"], settings["physics_dt"] = scenario.control_dt, scenario.physics_dt
    steps = scenario.steps
    settings["last_step"] = steps if max_episode_steps is None else min(steps, max_episode_steps)
    for name in ("initial_error", "initial_velocity"):
        numbers.set(name, getattr(scenario, name), name)
    settings["drawn_per_seed"] = scenario.drawn_per == "seed"
    _pack_arm(settings, numbers, scenario)
    _pack_noise(settings, numbers, scenario)
    _pack_friction(settings, numbers, scenario)
    _pack_joint(settings, numbers, scenario)
    _pack_actuator(settings, numbers, scenario)
    _pack_disturbance(settings, numbers, tables, scenario)
    waypoints = _pack_reference(settings, tables, scenario)
    settings["waypoints"] = waypoints
    past_row = memory.ROWS + 2 * (int(settings["delay_steps"]) + 1 + waypoints)
    settings["past_row"] = past_row
    past_actions = check_whole("past_actions", past_actions)
    _check_size("past_actions", past_actions, "", 2 * LANES * past_actions)
    settings["past_actions"] = max(int(settings["past_actions"]), past_actions)
    settings["history_row"] = past_row + 2 * settings["past_actions"]
    settings["block_size"] = LANES * (settings["history_row"] + 4 * settings["history"])
    _pack_events(settings, numbers, tables, scenario)
    preview = check_whole("preview", preview)
    _check_size("preview", preview, "", 6 * LANES * preview)
    limits = scenario.limits
    settings["max_position"], settings["max_velocity"] = limits.position, limits.velocity
    settings["max_acceleration"] = limits.acceleration
    settings["max_error"] = np.inf if limits.error is None else limits.error
    settings["error_steps"] = np.ceil(limits.error_time / scenario.control_dt - 1e-9)
    constraints = scenario.constraints or Constraints()
    settings["constraint_low"], settings["constraint_high"], settings["constraint_velocity"] = constraints.bounds
    settings["violation_ends"] = constraints.violation == "end"
    interface = _make_interface(scenario, action, settings, preview)
    settings["action_kind"] = ACTIONS.index(action)
    settings["action_limit"] = interface.action_limit
    _pack_observation(settings, interface)
    _pack_reward(settings, reward)
    settings["varied"], settings["draws"], settings["draw_table"] = numbers.fixed, len(numbers.draws), len(tables)
    tables.extend(number for draw in numbers.draws for number in draw)
    return Program(interface, settings, np.array(tables))


class _Numbers:
    """The numbers that may vary: fixed values, and the draws of the others.

    Attributes:
        fixed: in the order of `memory.VARIED`.
        draws: `memory.DRAW_SIZE` numbers each.
    """

    def __init__(self, tables: list[float]) -> None:
        self.fixed = np.zeros(VARIED.itemsize // 8)
        self.draws: list[tuple[float, ...]] = []
        self._tables = tables

    def set(self, field: str, value: Any, path: str, *, scale: float = 1.0, first: int = 0) -> None:
        """Set a field of `memory.VARIED`, from its number `first` on, to `scale` times a value.

        The value is a number, a distribution, or a pair of them. The option's path names the random
        stream.
        """
        self.set_row(memory.rows(field)[first], value, path, scale)

    def set_row(self, row: int, value: Any, path: str, scale: float = 1.0) -> None:
        """Set a row of a block, or the rows of both joints, as `set` does."""
        for joint, each in enumerate(value if isinstance(value, tuple) else (value,)):
            place, each = row + joint - FIRST_VARIED, scaled(each, scale)
            if not isinstance(each, Distribution):
                if place < len(self.fixed):
                    self.fixed[place] = each
                    continue
                each = Distribution(uniform=(each, each))  # other rows have no fixed value
            self._draw(row + joint, joint, each, path)

    def _draw(self, row: int, joint: int, each: Distribution, path: str) -> None:
        values = each.values
        numbers: tuple[float, float]
        if each.choice is not None:
            kind, numbers = memory.CHOICE, (len(self._tables), len(values))
            self._tables.extend(values)
        elif each.log_uniform is not None:
            kind, numbers = memory.LOG_UNIFORM, (values[0], _log1p(values[1] / values[0] - 1.0))
        else:
            kind, numbers = memory.UNIFORM, (values[0], values[1])
        self.draws.append((row, joint, kind, *numbers, *divmod(int(stream_key(path)), 2**32)))


def _check_size(option: str, value: float, unit: str, numbers: int) -> None:
    """Raise an error if an option adds too many numbers to a block."""
    if numbers > MAX_NUMBERS:
        raise ValueError(
            f"{option} must be at most some {MAX_NUMBERS / (numbers / value):.3g}{unit} here, which take "
            f"{MAX_NUMBERS / 2**27:g} GiB for {LANES} arms, got {value!r}{unit}"
        )


def _make_interface(scenario: Scenario, action: str, settings: Settings, preview: int) -> Interface:
    """Return the interface of a scenario; check that its action is possible."""
    check_choice("action", action, ACTIONS)
    limits = scenario.limits
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
    layout = make_layout(scenario.sensors, limits, bound, unit, int(settings["past_actions"]), preview)
    known = Interface(scenario.arm, layout, scenario.control_dt, limit, action, bound)  # type: ignore[arg-type]
    return dataclasses.replace(known, **_datasheet(settings, scenario))


def _datasheet(settings: Settings, scenario: Scenario) -> dict[str, Any]:
    """Return the fields of `Interface` that the datasheets of arm, drives and sensors state."""
    actuator, joint, dt = scenario.actuator, scenario.joint, scenario.control_dt
    rate = actuator.rate_limit
    errors = [getattr(scenario.noise, name, None) or SensorError() for name in SENSORS]
    springs: dict[str, Any] = {}
    if joint is not None:
        stiffness, damping = ([ends(each) for each in both] for both in (joint.stiffness, joint.damping))  # type: ignore[union-attr]
        springs = {
            "stiffness": tuple(zip(*stiffness, strict=True)),
            "damping": tuple(zip(*damping, strict=True)),
            "rotor_inertia": scenario.rotor,
            "backlash": tuple(ends(each)[1] for each in joint.backlash),  # type: ignore[union-attr]
            "encoder": joint.encoder,
        }
    return springs | {
        "constraints": scenario.constraints,
        "delay": tuple(
            x + round(n) * dt for x, n in zip(ends(actuator.delay), ends(actuator.delay_samples), strict=True)
        ),
        "lag": ends(actuator.lag),
        "rate_limit": None if rate is None else tuple(ends(each)[0] for each in rate),  # type: ignore[union-attr]
        "latency": 0.0 if scenario.encoder is None else scenario.encoder.latency * dt,
        "resolution": tuple(settings["quantization"][0].tolist()),
        "noise_std": tuple(tuple(ends(each)[1] for each in error.std_at(dt)) for error in errors),
    }


_EXACT = Context(prec=50)


def _exp(x: float) -> float:
    """Return e**x to the last bit on every machine; C libraries differ."""
    return float(_EXACT.exp(Decimal(x)))


def _log1p(x: float) -> float:
    """Return log(1 + x) to the last bit on every machine."""
    return float(_EXACT.ln(_EXACT.add(1, Decimal(x))))


def _pack_arm(settings: Settings, numbers: _Numbers, scenario: Scenario) -> None:
    arm, error = scenario.arm, scenario.parameter_error
    settings["parameters"] = arm.m1, arm.m2, arm.L1, arm.L2
    for name in ("gravity", "centre", "inertia", "rotor"):
        settings[name] = getattr(arm, name)
    settings["ratio"] = 1.0
    numbers.set("payload_pick_up", np.inf, "")
    numbers.set("payload_drop", np.inf, "")
    if error is None:
        return
    settings["ratio"] = error.ratios
    radius = _log1p(error.radius)
    settings["log_radius"] = [radius if name in error.parameters else 0.0 for name in PARAMETERS]
    settings["drawn_together"] = error.sampling == "together"
    payload = error.payload
    if isinstance(payload, Payload):
        settings["has_payload"] = ends(payload.mass)[1] > 0
        path, scale = "parameter_error.payload.", 1 / scenario.physics_dt
        numbers.set("payload_mass", payload.mass, path + "mass")
        numbers.set("payload_pick_up", payload.pick_up, path + "pick_up", scale=scale)
        if payload.drop is not None:
            numbers.set("payload_drop", payload.drop, path + "drop", scale=scale)


def _pack_noise(settings: Settings, numbers: _Numbers, scenario: Scenario) -> None:
    settings["senses_acceleration"] = "acceleration" in scenario.sensors
    _pack_encoder(settings, scenario)
    if scenario.noise is None:
        return
    for sensor, name in enumerate(SENSORS):
        error: SensorError | None = getattr(scenario.noise, name)
        if error is not None:
            numbers.set("noise_bias", error.bias, f"noise.{name}.bias", first=2 * sensor)
            size = "sigma" if error.density == (0.0, 0.0) else "density"
            std = error.std_at(scenario.control_dt)
            numbers.set("noise_std", std, f"noise.{name}.{size}", first=2 * sensor)
            settings["quantization"][sensor] += error.quantization
            settings["has_noise"][sensor] = ends(std) != (0.0, 0.0)
            settings["noisy"] |= bool(settings["has_noise"][sensor]) or ends(error.bias) != (0.0, 0.0)
    settings["noisy"] |= np.any(settings["quantization"])


def _pack_encoder(settings: Settings, scenario: Scenario) -> None:
    encoder = scenario.encoder
    if encoder is None:
        return
    if encoder.counts is not None:
        settings["quantization"][0] = 2 * np.pi / np.array(encoder.counts)
        settings["noisy"] = True
    settings["latency"], settings["difference"] = encoder.latency, encoder.difference or 0
    if encoder.latency or encoder.difference:
        settings["history"] = 1 + max(encoder.latency, encoder.difference or 1)
    settings["low_pass"] = 1.0
    if encoder.low_pass is not None:
        settings["low_pass"] = 1.0 - _exp(-2 * math.pi * encoder.low_pass * scenario.control_dt)


def _pack_friction(settings: Settings, numbers: _Numbers, scenario: Scenario) -> None:
    numbers.set("v_s", (1.0, 1.0), "")
    friction = scenario.friction
    if friction is None:
        return
    settings["friction_law"] = memory.FRICTION_LAWS[friction.law]
    if friction.coulomb == (0.0, 0.0) and friction.stiction == (0.0, 0.0):
        settings["friction_law"] = memory.NO_FRICTION  # viscous friction alone is smooth
    for name in ("viscous", "coulomb", "stiction"):
        numbers.set(name, getattr(friction, name), f"friction.{name}")
    if friction.stribeck_velocity is None:
        numbers.set("v_s", friction.v_s, "friction.v_s")
    else:
        numbers.set("v_s", friction.stribeck_velocity, "friction.stribeck_velocity")
        settings["stribeck_squared"] = True
    if scenario.physics_dt * _fastest_decay(scenario, scenario.most_viscous) > MAX_DECAY:
        settings["euler_steps"] = 4


def _fastest_decay(scenario: Scenario, viscous: Pair) -> float:
    """Return the largest rate at which viscous friction slows any real arm [1/s]."""
    arm, error = scenario.arm, scenario.parameter_error or ParameterError()
    least = {
        name: ratio / (1 + error.radius if name in error.parameters else 1)
        for name, ratio in zip(PARAMETERS, error.ratios, strict=True)
    }
    light = dataclasses.replace(arm, **{name: getattr(arm, name) * ratio for name, ratio in least.items()})
    angles = np.column_stack([np.zeros(9), np.linspace(0, np.pi, 9)])
    rates = np.linalg.solve(inertia_matrix(light, angles), np.diag(viscous))
    return float(np.linalg.eigvals(rates).real.max())


def _pack_joint(settings: Settings, numbers: _Numbers, scenario: Scenario) -> None:
    joint = scenario.joint
    if joint is None:
        return
    settings["elastic"], settings["encoder_on_motor"] = True, joint.encoder == "motor"
    settings["motor_inertia"] = scenario.rotor
    numbers.set("stiffness", joint.stiffness, "joint.stiffness")
    numbers.set("damping", joint.damping, "joint.damping")
    numbers.set("half_backlash", joint.backlash, "joint.backlash", scale=0.5)


def _pack_actuator(settings: Settings, numbers: _Numbers, scenario: Scenario) -> None:
    actuator = scenario.actuator
    settings["torque_limit"] = np.inf if actuator.torque_limit is None else actuator.torque_limit
    scale, samples = 1 / scenario.physics_dt, round(ends(actuator.delay_samples)[1])
    longest = check_number("actuator.delay", ends(actuator.delay)[1], high=MAX_STEPS * scenario.physics_dt)
    delay = samples * scenario.substeps + round(longest * scale)
    steps = -(-delay // scenario.substeps)
    _check_size("actuator.delay", longest, " s", 2 * _PAIR * (steps - samples))
    _check_size("actuator.delay_samples", samples, "", 2 * _PAIR * samples)
    settings["delay_steps"] = steps
    # The state has the actions on their way, and the one that a slow drive still follows.
    slow = ends(actuator.lag)[1] > 0 or actuator.rate_limit is not None
    settings["past_actions"] = delay // scenario.substeps + 1 if slow else steps
    rate = (np.inf, np.inf) if actuator.rate_limit is None else actuator.rate_limit
    numbers.set("rate_limit", rate, "actuator.rate_limit", scale=scenario.physics_dt)
    numbers.set("gain", actuator.gain, "actuator.gain")
    numbers.set("delay", actuator.delay, "actuator.delay", scale=scale)
    numbers.set("delay_samples", actuator.delay_samples, "actuator.delay_samples")
    numbers.set("lag", actuator.lag, "actuator.lag", scale=scale)
    settings["torque_varies"] = steps > 0 or slow


_TIMES = ("dt", "period", "width", "start")
"""Times of disturbances, which are counted in physics steps."""


def _pack_disturbance(settings: Settings, numbers: _Numbers, tables: list[float], scenario: Scenario) -> None:
    disturbance, h, n = scenario.disturbance, scenario.physics_dt, scenario.substeps
    if disturbance is None:
        return
    times = {name: round(vars(disturbance)[name] / h) for name in _TIMES if name in vars(disturbance)}
    settings["disturbance_kind"] = memory.DISTURBANCES[disturbance.kind]
    for name, time in times.items():
        settings["disturbance_period" if name == "dt" else f"disturbance_{name}"] = time
    settings["torque_varies"] |= any(time % n for time in times.values())
    if isinstance(disturbance, ArrayDisturbance):
        settings["disturbance_table"], settings["disturbance_samples"] = len(tables), len(disturbance.torque)
        tables.extend(value for sample in disturbance.torque for value in sample)
        return
    numbers.set("disturbance_amplitude", disturbance.amplitude, "disturbance.amplitude")
    if isinstance(disturbance, SineDisturbance):
        numbers.set("disturbance_rate", disturbance.frequency, "disturbance.frequency", scale=2 * np.pi)
        settings["disturbance_phase_drawn"] = disturbance.phase is None
        settings["disturbance_phase"] = 0.0 if disturbance.phase is None else disturbance.phase
        settings["torque_varies"] = True


def _pack_events(settings: Settings, numbers: _Numbers, tables: list[float], scenario: Scenario) -> None:
    """Pack the events; their rows come last in a block."""
    settings["events"], settings["event_table"] = len(scenario.events), len(tables)
    tables.extend(EVENTS.index(type(event)) for event in scenario.events)
    first = int(settings["block_size"]) // LANES
    settings["event_row"] = first
    for i, event in enumerate(scenario.events):
        for name, value in vars(event).items():
            if name == "time":
                numbers.set_row(first, value, f"events.{i}.time", 1 / scenario.physics_dt)
            elif name != "kind":
                numbers.set_row(first + 1, value, f"events.{i}.{name}")
        first += memory.EVENT_ROWS
    settings["block_size"] = first * LANES
    settings["torque_varies"] |= any(isinstance(event, DriveChange) for event in scenario.events)


def _pack_reference(settings: Settings, tables: list[float], scenario: Scenario) -> int:
    """Pack the reference; return the number of way-points, levels or phases that a block holds."""
    reference, steps = scenario.reference, scenario.steps
    settings["reference_kind"], settings["reference_table"] = memory.REFERENCES[reference.kind], len(tables)
    if isinstance(reference, ArrayReference):
        # One row more than the episode. Its last sample is held for previews beyond it.
        _check_size("duration", scenario.duration, " s", 6 * (steps + 2))
        samples = reference.samples(scenario.control_dt * np.arange(steps + 2))
        samples[-1, 2:] = 0.0
        settings["reference_points"] = len(samples)
        tables.extend(samples.ravel())
        return 0
    if isinstance(reference, SineReference | FourierReference):
        n = reference.harmonics if isinstance(reference, FourierReference) else 1
        phase = None if isinstance(reference, FourierReference) else reference.phase
        _check_size("reference.harmonics", n, "", _PAIR * n)
        weights = 1.0 / np.arange(1, n + 1)
        amplitudes = np.outer(weights / weights.sum(), reference.amplitude)
        settings["reference_points"], settings["reference_middle"] = n, reference.centre
        settings["base_rate"] = 2 * np.pi * reference.frequency
        settings["reference_phases_drawn"] = phase is None
        tables.extend(amplitudes.ravel())
        tables.extend((0.0, 0.0) if phase is None else phase)  # type: ignore[arg-type]
        return n
    if isinstance(reference, MinimumJerk):
        period, settings["move_time"] = reference.move_time + reference.hold_time, reference.move_time
    else:
        period, settings["bandwidth"] = reference.period, getattr(reference, "bandwidth", 0.0)
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
    return pairs * n


def _pack_observation(settings: Settings, interface: Interface) -> None:
    layout, bounds = interface.layout, interface.layout.bounds[1]
    settings["observation_size"] = layout.size
    rows: list[int] = []
    for slot in layout.slots:
        if slot.name == "preview":
            settings["preview"] = slot.size // 6
        elif slot.name != "previous_actions":
            rows += memory.rows(f"measured_{slot.name}" if slot.name in SENSORS else slot.name)
    settings["observed"] = len(rows)
    settings["observed_row"][: len(rows)] = rows
    settings["observed_bound"][: len(rows)] = bounds[: len(rows)]


def _pack_reward(settings: Settings, reward: Reward) -> None:
    total = reward.weight_tracking + reward.weight_effort + reward.weight_chatter
    logarithmic = reward.tracking == "log"
    settings["reward_logarithmic"] = logarithmic
    settings["reward_scale"] = 1 / reward.resolution if logarithmic else 1 / reward.worst
    settings["reward_norm"] = 1 / _log1p(reward.worst / reward.resolution) if logarithmic else 0.0
    for name in ("weight_tracking", "weight_effort", "weight_chatter"):
        settings[name] = getattr(reward, name) / total
