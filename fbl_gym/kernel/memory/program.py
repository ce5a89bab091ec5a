"""A scenario in numbers: its options packed into the settings and tables of `layout.py`."""

from __future__ import annotations

from collections.abc import Iterable
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
from fbl_gym.options import EVENTS, SENSORS, Event, Reward
from fbl_gym.records.checks import check_choice, check_whole
from fbl_gym.records.record import Distribution, Option, declarations
from fbl_gym.scenarios import Scenario

#: One record of the type `memory.SETTINGS`, shape ().
Settings = NDArray[np.void]


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
    scenario: Scenario, *, action: str, reward: Reward, preview: int, past_actions: int = 0,
    max_episode_steps: int | None = None, autoreset: int = memory.NO_AUTORESET,
) -> Program:  # fmt: skip
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
    settings = packer.settings
    packer.add(scenario)
    packer.add(reward, "reward.")
    least = check_whole("past_actions", past_actions, high=100_000)
    settings["past_actions"] = max(int(settings["past_actions"]), least)
    settings["events"] = len(scenario.events)
    _lay_rows(settings)
    for i, event in enumerate(scenario.events):
        packer.add_event(event, int(settings["event_row"]) + memory.EVENT_ROWS * i, f"events.{i}.")
    settings["event_table"] = packer.table(EVENTS.index(type(event)) for event in scenario.events)
    settings["varied"], settings["draws"] = packer.fixed, len(packer.draws)
    settings["draw_table"] = packer.table(number for draw in packer.draws for number in draw)
    settings["preview"] = check_whole("preview", preview, high=100_000)
    interface = _make_interface(scenario, action, settings)
    settings["action_kind"], settings["action_limit"] = ACTIONS.index(action), interface.action_limit
    settings["last_step"] = min(scenario.steps, max_episode_steps or scenario.steps)
    settings["autoreset"] = autoreset
    _pack_observation(settings, interface)
    return Program(interface, settings, np.array(packer.tables))


def _lay_rows(settings: Settings) -> None:
    """Set the first row of each kind that a block has after its fields, and the block's size."""
    row = memory.ROWS
    for name, count in (
        ("queue_row", 3 * (settings["delay_steps"] + 1)),
        ("waypoint_row", 2 * settings["waypoints"]),
        ("past_row", 2 * settings["past_actions"]),
        ("history_row", 4 * settings["history"]),
        ("event_row", memory.EVENT_ROWS * settings["events"]),
    ):
        settings[name] = row
        row += int(count)
    settings["block_size"] = LANES * row


class _Packer:
    """The numbers of a scenario that is being packed.

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

    def add(self, option: Option, path: str = "") -> None:
        """Pack the declared fields of an option, the options in it, and what they derive.

        `path` is the text before each field's name; both name the field's random stream.
        """
        for name, field in declarations(type(option)).items():  # type: ignore[arg-type]
            value = field.none if getattr(option, name) is None else getattr(option, name)
            if isinstance(value, Option):
                self.add(value, f"{path}{name}.")
            elif field.kernel and value is not None and field.varies:
                self.vary(field.kernel, field.number(value, self.scenario), path + name)
            elif field.kernel and value is not None:
                self.settings[field.kernel] = field.number(value, self.scenario)
        option.pack(self)

    def add_event(self, event: Event, row: int, path: str) -> None:
        """Pack an event: its time into a row of a block, and its size into the next one or two."""
        for name, field in declarations(type(event)).items():  # type: ignore[arg-type]
            if name != "kind":
                number = field.number(getattr(event, name), self.scenario)
                self._vary_rows(row + (name != "time"), number, path + name)
        event.pack(self)

    def table(self, values: Iterable[float]) -> int:
        """Add numbers to the tables, and return the index of the first one."""
        first = len(self.tables)
        self.tables.extend(values)
        return first

    def vary(self, field: str, value: Any, path: str, *, first: int = 0) -> None:
        """Set a field of `memory.VARIED`, from its number `first` on.

        The value is a number, a distribution, or a pair of them. The option's path names the random
        stream.
        """
        self._vary_rows(memory.rows(field)[first], value, path)

    def _vary_rows(self, row: int, value: Any, path: str) -> None:
        """Set a row of a block, or the rows of both joints, as `vary` does."""
        for joint, number in enumerate(value if isinstance(value, tuple) else (value,)):
            index = row + joint - FIRST_VARIED
            if isinstance(number, Distribution) or index >= len(self.fixed):  # other rows have no fixed value
                self._draw(row + joint, joint, number, path)
            else:
                self.fixed[index] = number

    def _draw(self, row: int, joint: int, number: Any, path: str) -> None:
        distribution = number if isinstance(number, Distribution) else Distribution(uniform=(number, number))
        values = distribution.values
        kind, first, second = float(memory.UNIFORM), values[0], values[-1]
        if distribution.choice is not None:
            kind, first, second = memory.CHOICE, self.table(values), len(values)
        elif distribution.log_uniform is not None:
            kind, second = memory.LOG_UNIFORM, log1p(values[1] / values[0] - 1.0)
        self.draws.append((row, joint, kind, first, second, *divmod(int(stream_key(path)), 2**32)))


def _make_interface(scenario: Scenario, action: str, settings: Settings) -> Interface:
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
    layout = make_layout(scenario.sensors, limits, bound, unit, int(settings["past_actions"]), int(settings["preview"]))
    datasheet: dict[str, Any] = {}
    for option in scenario.options:
        datasheet |= option.facts(scenario)
    if scenario.datasheet is not None:
        datasheet = scenario.datasheet.stated(datasheet)
    return Interface(
        nominal=scenario.arm, layout=layout, control_dt=scenario.control_dt, action=action, action_limit=bound,
        resolution=tuple(settings["quantization"][0].tolist()), constraints=scenario.constraints, **datasheet,
    )  # fmt: skip


def _pack_observation(settings: Settings, interface: Interface) -> None:
    layout, measured = interface.layout, dict(zip(SENSORS, np.reshape(memory.rows("measured"), (3, 2)), strict=True))
    names = [slot.name for slot in layout.slots if slot.name not in ("previous_actions", "preview")]
    rows = np.concatenate([measured.get(name, memory.rows(name)) for name in names])
    settings["observation_size"], settings["observed"] = layout.size, len(rows)
    settings["observed_row"][: len(rows)], settings["observed_bound"][: len(rows)] = rows, layout.bounds[1][: len(rows)]
