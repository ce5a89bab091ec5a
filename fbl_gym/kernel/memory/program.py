"""A scenario in numbers: its options packed into the settings and tables of `memory.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fbl_gym.exact import log1p
from fbl_gym.interface import ACTIONS, Interface, make_layout
from fbl_gym.kernel.maths.streams import stream_key
from fbl_gym.kernel.memory import layout as memory
from fbl_gym.kernel.memory.layout import FIRST_VARIED, LANES, SETTINGS, VARIED
from fbl_gym.model.arm import Array
from fbl_gym.options import EVENTS, SENSORS, Constraints, Friction, ParameterError, Reward
from fbl_gym.records.checks import check_choice, check_whole
from fbl_gym.records.record import Distribution, scaled
from fbl_gym.scenarios import Scenario

Settings = NDArray[np.void]
"""One record of the type `memory.SETTINGS`, shape ()."""


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
    packer = _Packer(scenario)
    settings, tables, arm = packer.settings, packer.tables, scenario.arm
    settings["autoreset"] = autoreset
    settings["substeps"] = scenario.substeps
    settings["control_dt"], settings["physics_dt"] = scenario.control_dt, scenario.physics_dt
    settings["last_step"] = min(scenario.steps, max_episode_steps or scenario.steps)
    for name in ("initial_error", "initial_velocity"):
        packer.vary(name, getattr(scenario, name), name)
    settings["drawn_per_seed"] = scenario.drawn_per == "seed"
    settings["parameters"], settings["ratio"] = (arm.m1, arm.m2, arm.L1, arm.L2), 1.0
    for name in ("gravity", "centre", "inertia", "rotor"):
        settings[name] = getattr(arm, name)
    settings["real_rotor"] = scenario.rotor
    settings["external_physics"] = scenario.plant is not None
    settings["senses_acceleration"] = "acceleration" in scenario.sensors
    for name in ("payload_pick_up", "payload_drop"):
        packer.vary(name, np.inf, "")
    friction, disturbance, reference = scenario.friction, scenario.disturbance, scenario.reference
    if friction is not None and friction.is_dry:
        settings["friction_law"] = memory.FRICTION_LAWS[friction.law]
    if disturbance is not None:
        settings["disturbance_kind"] = memory.DISTURBANCES[disturbance.kind]
    options = (
        scenario.parameter_error or ParameterError(), scenario.encoder, scenario.noise, friction or Friction(),
        scenario.joint, scenario.link, scenario.actuator, disturbance, scenario.limits, scenario.constraints or Constraints(),
    )  # fmt: skip
    for option in options:
        if option is not None:
            option.pack(packer)
    settings["reference_kind"], settings["reference_table"] = memory.REFERENCES[reference.kind], len(tables)
    settings["waypoints"] = reference.pack(packer)
    reward.pack(settings)
    preview = check_whole("preview", preview, high=100_000)
    past_actions = check_whole("past_actions", past_actions, high=100_000)
    settings["past_actions"] = max(int(settings["past_actions"]), past_actions)
    # The rows of a block after its fields: queue, way-points, actions, readings, events.
    settings["past_row"] = memory.ROWS + 3 * (int(settings["delay_steps"]) + 1) + 2 * int(settings["waypoints"])
    settings["history_row"] = settings["past_row"] + 2 * settings["past_actions"]
    settings["event_row"] = settings["history_row"] + 4 * settings["history"]
    settings["events"], settings["event_table"] = len(scenario.events), len(tables)
    tables.extend(EVENTS.index(type(event)) for event in scenario.events)
    for i, event in enumerate(scenario.events):
        event.pack(packer, int(settings["event_row"]) + memory.EVENT_ROWS * i, f"events.{i}")
    settings["block_size"] = LANES * (settings["event_row"] + memory.EVENT_ROWS * settings["events"])
    interface = _make_interface(scenario, action, settings, preview)
    settings["action_kind"] = ACTIONS.index(action)
    settings["action_limit"] = interface.action_limit
    _pack_observation(settings, interface)
    settings["varied"], settings["draws"], settings["draw_table"] = packer.fixed, len(packer.draws), len(tables)
    tables.extend(number for draw in packer.draws for number in draw)
    return Program(interface, settings, np.array(tables))


class _Packer:
    """The numbers of a scenario that is being packed, to which each option adds its own by `pack`.

    Attributes:
        scenario: the whole one, for its rates and for what options mean to each other.
        settings: a record of the type `memory.SETTINGS`.
        tables: arrays that the scenario contains, one after the other.
        fixed: of the numbers that may vary, in the order of `memory.VARIED`.
        draws: of the others, `memory.DRAW_SIZE` numbers each.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.settings: Settings = np.zeros((), SETTINGS)
        self.tables: list[float] = []
        self.fixed = np.zeros(VARIED.itemsize // 8)
        self.draws: list[tuple[float, ...]] = []

    def vary(self, field: str, value: Any, path: str, *, scale: float = 1.0, first: int = 0) -> None:
        """Set a field of `memory.VARIED`, from its number `first` on, to a scaled value.

        The value is a number, a distribution, or a pair of them. The option's path names the random
        stream.
        """
        self.vary_row(memory.rows(field)[first], value, path, scale)

    def vary_row(self, row: int, value: Any, path: str, scale: float = 1.0) -> None:
        """Set a row of a block, or the rows of both joints, as `vary` does."""
        for joint, number in enumerate(value if isinstance(value, tuple) else (value,)):
            index, number = row + joint - FIRST_VARIED, scaled(number, scale)
            if isinstance(number, Distribution):
                self._draw(row + joint, joint, number, path)
            elif index < len(self.fixed):
                self.fixed[index] = number
            else:  # other rows have no fixed value
                self._draw(row + joint, joint, Distribution(uniform=(number, number)), path)

    def _draw(self, row: int, joint: int, number: Distribution, path: str) -> None:
        values = number.values
        kind, first, second = float(memory.UNIFORM), values[0], values[-1]
        if number.choice is not None:
            kind, first, second = memory.CHOICE, len(self.tables), len(values)
            self.tables.extend(values)
        elif number.log_uniform is not None:
            kind, second = memory.LOG_UNIFORM, log1p(values[1] / values[0] - 1.0)
        self.draws.append((row, joint, kind, first, second, *divmod(int(stream_key(path)), 2**32)))


def _make_interface(scenario: Scenario, action: str, settings: Settings, preview: int) -> Interface:
    """Return the interface of a scenario; check that its action is possible."""
    check_choice("action", action, ACTIONS)
    limits, limit = scenario.limits, scenario.actuator.torque_limit
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
    datasheet = scenario.actuator.datasheet(scenario)
    for option in (scenario.noise, scenario.encoder, scenario.joint):
        datasheet |= {} if option is None else option.datasheet(scenario)
    if scenario.datasheet is not None:
        datasheet = scenario.datasheet.datasheet(datasheet)
    return Interface(
        nominal=scenario.arm, layout=layout, control_dt=scenario.control_dt, action=action, action_limit=bound,
        resolution=tuple(settings["quantization"][0].tolist()), constraints=scenario.constraints, **datasheet,
    )  # fmt: skip


def _pack_observation(settings: Settings, interface: Interface) -> None:
    layout, bounds = interface.layout, interface.layout.bounds[1]
    settings["observation_size"] = layout.size
    rows: list[int] = []
    for slot in layout.slots:
        if slot.name == "preview":
            settings["preview"] = slot.size // 6
        elif slot.name in SENSORS:
            rows += memory.rows("measured")[2 * SENSORS.index(slot.name) :][:2]
        elif slot.name != "previous_actions":
            rows += memory.rows(slot.name)
    settings["observed"] = len(rows)
    settings["observed_row"][: len(rows)] = rows
    settings["observed_bound"][: len(rows)] = bounds[: len(rows)]
