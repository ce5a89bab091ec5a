"""A batch of arms: the memory that the kernel works on, and the operations on it.

Both environments are a thin layer over this module; the single one is a batch of one lane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fbl_gym.kernel.memory import layout as memory
from fbl_gym.kernel.memory.layout import BLOCK, INSTANT, LANES, SETTINGS, SETTINGS_SIZE
from fbl_gym.kernel.memory.program import Program
from fbl_gym.kernel.step import api
from fbl_gym.kernel.step.pool import POOL
from fbl_gym.model.arm import Array

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Truth:
    """The real arm at this instant, which no policy may know. For plots, checks and the oracle.

    Fields are [2] for a single environment and [lanes x 2] for a batch, unless stated otherwise. If
    a disturbance's level or the payload changes at this instant, they still have their old value.

    Attributes:
        time: since the episode's start [s]; a number, or [lanes].
        position: [rad].
        velocity: [rad/s].
        acceleration: [rad/s^2].
        motor_position: behind the gear [rad]; with rigid joints the position.
        motor_velocity: [rad/s]; likewise.
        stiffness: of elastic joints [N m/rad]; zero for rigid ones.
        damping: of elastic joints [N m s/rad].
        backlash: width of their gaps [rad].
        bend: angle of the hinge of each link that bends [rad].
        bend_velocity: [rad/s].
        bend_rate: natural frequency of these hinges, not the rate of their bend [rad/s].
        segment_inertia: J of their segments with the payload carried now, see `model/chain.py`, [4]
            or [lanes x 4] kg m^2.
        segment_moment: f likewise [kg m].
        reference: reference position now [rad].
        reference_velocity: [rad/s].
        reference_acceleration: [rad/s^2].
        commands: torque commands [N m], the last first, [n x 2] or [lanes x n x 2]: as many as the
            longest delay holds back, and one more.
        applied_torque: torque of the drives [N m], after limit, delay, lag, gain and ripple.
        friction_torque: F of equation (1) [N m]; of a joint that sticks, the torque that holds it.
        disturbance: tau_d of equation (1) [N m].
        masses: of the links [kg], without the payload.
        lengths: of the links [m].
        lumped: the five lumped parameters with the payload carried now, [5] or [lanes x 5];
            see `arm.py`.
        rotor: inertia of the rotors, reflected to the joints [kg m^2].
        payload: mass carried at the tip [kg]; a number, or [lanes].
        viscous: coefficient of viscous friction [N m s/rad].
        coulomb: Coulomb friction [N m].
        stiction: friction that fades as the joint moves [N m].
        load_friction: Coulomb friction for each N m of the drive's torque.
        v_s: scale of the squared velocity at which it fades [(rad/s)^2].
        gain: real / nominal torque of the drives.
        delay: from command to torque, with the computation's, without jitter [s]; a number, or
            [lanes].
        lag: time constant of the drives [s]; a number, or [lanes].
        rate_limit: of the torque [N m/s], infinite without one.
        event_times: times of this episode's events [s], [events] or [lanes x events].
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    motor_position: Array
    motor_velocity: Array
    stiffness: Array
    damping: Array
    backlash: Array
    bend: Array
    bend_velocity: Array
    bend_rate: Array
    segment_inertia: Array
    segment_moment: Array
    reference: Array
    reference_velocity: Array
    reference_acceleration: Array
    commands: Array
    applied_torque: Array
    friction_torque: Array
    disturbance: Array
    masses: Array
    lengths: Array
    lumped: Array
    rotor: Array
    payload: Array
    viscous: Array
    coulomb: Array
    stiction: Array
    load_friction: Array
    v_s: Array
    gain: Array
    delay: Array
    lag: Array
    rate_limit: Array
    event_times: Array

    def of_lanes(self, lanes: Any) -> Truth:
        """Return the truth of one lane of a batch, or of some; None: of a batch of this one arm."""
        return Truth(**{name: np.asarray(values)[lanes] for name, values in vars(self).items()})


#: Numbers in a line of the processor's cache, at which the blocks begin.
_LINE = 8


def _aligned(size: int) -> Array:
    """Return zeros that begin at a line of the processor's cache, [size]."""
    zeros = np.zeros(size + _LINE)
    begin = -zeros.ctypes.data // zeros.itemsize % _LINE
    return zeros[begin : begin + size]


class ArmBatch:
    """A batch of arms of one scenario, each lane with its own seed and episode.

    Args:
        program: the scenario in numbers.
        lanes: number of arms, one or more.
        threads: number of threads, one or more.
    """

    def __init__(self, program: Program, lanes: int, threads: int = 1) -> None:
        settings = program.settings
        blocks, size = -(-lanes // LANES), program.interface.layout.size
        finals = lanes * size if settings["autoreset"] == memory.SAME_STEP else 0
        sizes = {
            "settings": SETTINGS_SIZE,
            "tables": len(program.tables),
            "actions": 2 * lanes,
            "rewards": lanes,
            "flags": -(-2 * lanes // 8),
            "final_observations": finals,
        }
        sizes["padding"] = -sum(sizes.values()) % _LINE
        sizes["blocks"] = blocks * int(settings["block_size"])
        ends = np.cumsum(list(sizes.values())).tolist()
        self._parts = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}
        self._actions = self._parts["actions"]
        self._first_action = self._actions.start
        self.lanes, self.threads, self._size = lanes, threads, size
        self._class = api.step_number(settings)
        self._memory = _aligned(ends[-1])
        self._memory[self._parts["tables"]] = program.tables
        self.settings[...] = settings
        self.settings["lanes"] = lanes
        for name in ("actions", "rewards", "flags", "final_observations", "blocks"):
            self.settings[name] = self._parts[name].start
        self._blocks["given_position"] = self._blocks["given_velocity"] = np.nan
        self._start()

    def _start(self) -> None:
        """Give the last block's spare lanes an episode, which keeps their numbers finite."""
        self._blocks["status"] = memory.RESTART
        self.sense(self.observations())
        # Before its first step, a lane must be reset.
        self._blocks["status"] = memory.ENDED

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._memory = _aligned(len(state["_memory"]))
        self._memory[:] = state["_memory"]

    # The views below are new each time: a stored view would not follow a copy of the batch.

    @property
    def settings(self) -> NDArray[np.void]:
        """The settings, one record of shape ()."""
        return self._memory[self._parts["settings"]].view(SETTINGS).reshape(())

    @property
    def _blocks(self) -> NDArray[np.void]:
        """The fields of the blocks, records of shape [blocks]."""
        rows, start = self._rows, self._parts["blocks"].start
        return np.ndarray(len(rows), BLOCK, self._memory, rows.itemsize * start, rows.strides[:1])

    @property
    def _rows(self) -> Array:
        """The same memory as rows, [blocks x rows x lanes of a block]."""
        return self._memory[self._parts["blocks"]].reshape(-(-self.lanes // LANES), -1, LANES)

    def seed(self, lanes: NDArray[np.int64], seeds: Any, episodes: Any = 0) -> None:
        """Give lanes their seeds and the numbers of their next episodes; 0 is a seed's first."""
        self._blocks["seed"][lanes // LANES, lanes % LANES] = seeds
        self._blocks["episode"][lanes // LANES, lanes % LANES] = episodes

    def next_episode(self, lanes: NDArray[np.int64]) -> None:
        """Let the next episode of these lanes be another one of the same seed."""
        self._blocks["episode"][lanes // LANES, lanes % LANES] += np.uint64(1)

    def observations(self) -> Array:
        """Return an array for observations, [lanes x size]."""
        return np.empty((self.lanes, self._size))

    def field(self, name: str) -> Array:
        """Return a field of the blocks now, [lanes] or [lanes x ...]."""
        return self._of_lanes(self._blocks[name])

    def _of_lanes(self, rows: Array) -> Array:
        """Return a field of the blocks, [lanes] or [lanes x ...]."""
        rows = rows.transpose(0, rows.ndim - 1, *range(1, rows.ndim - 1))  # [blocks x lanes of a block x ...]
        return rows.reshape(-1, *rows.shape[2:])[: self.lanes].copy()

    def give(self, lanes: NDArray[np.int64], start: dict[str, Array]) -> None:
        """Let the next episode of some lanes begin where it is given.

        Args:
            lanes: [n].
            start: `position` and `velocity` [n x 2], and `reference`, the way-points [n x m x 2];
                any of them.
        """
        block, lane = lanes // LANES, lanes % LANES
        for name in start.keys() & {"position", "velocity"}:
            self._blocks[f"given_{name}"][block, :, lane] = start[name]
        if "reference" in start:
            first = int(self.settings["waypoint_row"])
            points = start["reference"].reshape(len(lanes), -1)
            self._rows[block, first : first + points.shape[1], lane] = points
            self._blocks["given_reference"][block, lane] = 1.0

    def state(self) -> Any:
        """Return a copy of all that a step depends on, for `restore`."""
        return self._memory.copy()

    def restore(self, state: Any) -> bool:
        """Go on from what `state` of a batch like this one returned; False: it is not like this."""
        if not isinstance(state, np.ndarray) or state.shape != self._memory.shape or state.dtype != float:
            return False
        first = slice(0, self._first_action)
        if state[first].tobytes() != self._memory[first].tobytes():
            return False
        self._memory[:] = state
        return True

    def reset(self, lanes: NDArray[np.int64], out: Array) -> None:
        """Start an episode in some lanes; write all observations to `out` [lanes x size]."""
        self._blocks["status"][lanes // LANES, lanes % LANES] = memory.RESTART
        self.sense(out)

    def sense(self, out: Array) -> None:
        """Take readings without motion; write all observations to `out` [lanes x size]."""
        POOL.step(self._class, self._memory, out.reshape(-1), False, self.threads)

    def index(self, *names: str) -> NDArray[np.int64]:
        """Return the places of fields of the first lane, for `read` and `write`."""
        return self._parts["blocks"].start + LANES * np.concatenate([memory.rows(name) for name in names])

    def read(self, index: NDArray[np.int64]) -> Array:
        """Return the numbers at places that `index` returned."""
        return self._memory[index]

    def write(self, index: NDArray[np.int64], values: Array) -> None:
        """Set the numbers at places that `index` returned."""
        self._memory[index] = values

    def pass_step(self, actions: Array) -> None:
        """Let a control step pass without motion: only torque commands and clock go on.

        Args:
            actions: [lanes x 2], finite; they are not checked.
        """
        self._memory[self._actions] = actions.reshape(-1)
        api.load(self._memory, 0)
        self._blocks["step"] += np.uint64(1)

    def step(self, actions: Array, out: Array) -> int:
        """Advance every lane by one control step, unless an action or a lane is refused.

        Args:
            actions: [lanes x 2].
            out: takes the observations [lanes x size].

        Returns:
            The result of `api.check`.
        """
        self._memory[self._actions] = actions.reshape(-1)
        return POOL.step(self._class, self._memory, out.reshape(-1), True, self.threads)

    def step_one(self, action1: float, action2: float, out: Array) -> tuple[int, float, bool, bool]:
        """Advance a batch of one lane, as `step` does, faster.

        Returns:
            The result of `api.check`; then reward, terminated and truncated.
        """
        numbers, first = self._memory, self._first_action
        numbers[first] = action1
        numbers[first + 1] = action2
        return api.STEPS[self._class](numbers, out, True, 0, 0)

    @property
    def outcomes(self) -> tuple[Array, Flags, Flags]:
        """Rewards, terminated and truncated of the last step, [lanes] each."""
        n = self.lanes
        flags = self._memory[self._parts["flags"]].view(np.bool_)
        return self._memory[self._parts["rewards"]].copy(), flags[:n].copy(), flags[n : 2 * n].copy()

    @property
    def final_observations(self) -> Array:
        """With SAME_STEP, final observations of the last step [lanes x size]."""
        return self._memory[self._parts["final_observations"]].reshape(self.lanes, -1)

    def true_signals(self) -> dict[str, Array]:
        """Return the fields of the truth that a recording needs, and the last `command` alone."""
        numbers = self._rows[:, _RECORDED_ROWS].swapaxes(1, 2).reshape(-1, len(_RECORDED_ROWS))[: self.lanes]
        return {name: numbers[:, columns] for name, columns in _RECORDED.items()}

    def truth(self) -> Truth:
        """Return the truth at this instant."""
        instants = np.empty(self.lanes, INSTANT)
        api.inspect(self._memory, instants)
        settings, parameters, rows, blocks = self.settings, self.field("parameters"), self._rows, self._blocks
        fields = {name: instants[name].copy() for name in INSTANT.names or ()}
        fields |= {"masses": parameters[:, :2], "lengths": parameters[:, 2:]}
        fields["rotor"] = settings["real_rotor"] * self.field("rotor_ratio")
        fields |= {name: self._of_lanes(blocks[_RENAMED.get(name, name)]) for name in _STORED}
        h = settings["physics_dt"]
        for name, unit in (("delay", h), ("lag", h), ("rate_limit", 1 / h)):  # a block counts physics steps
            fields[name] *= unit
        if not settings["elastic"]:
            fields |= {"motor_position": fields["position"].copy(), "motor_velocity": fields["velocity"].copy()}
        commands = rows[:, settings["queue_row"] : settings["waypoint_row"]].swapaxes(1, 2)
        commands = commands.reshape(-1, int(settings["delay_steps"]) + 1, 3)[: self.lanes, :, :2]
        times = rows[:, settings["event_row"] :: memory.EVENT_ROWS][:, : settings["events"]].swapaxes(1, 2)
        times = times.reshape(len(rows) * LANES, times.shape[2])[: self.lanes] * settings["physics_dt"]
        return Truth(**fields, commands=commands.copy(), event_times=times)


#: Fields of a block that `Truth` names otherwise.
_RENAMED = {"applied_torque": "torque", "reference": "reference_position"}

_PAIRS = ("position", "velocity", "reference", "command", "applied_torque", "disturbance")
#: Columns of each recorded field.
_RECORDED: dict[str, Any] = {name: slice(2 * i, 2 * i + 2) for i, name in enumerate(_PAIRS)} | {"payload": 12}

_RECORDED_ROWS = np.concatenate([memory.rows(_RENAMED.get(name, name)) for name in (*_PAIRS, "payload")])

#: Fields of `Truth` that a block has. Its acceleration is there for a sensor only.
_STORED = [
    name for name in Truth.__annotations__ if _RENAMED.get(name, name) in (BLOCK.names or ()) and name != "acceleration"
]
