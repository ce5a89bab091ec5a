"""The adapter between environment and agent: the agent's observation, and its action's torque."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

import controllers
from controllers.base import State, TorqueLaw
from controllers.name import PolicyName
from controllers.parts import PARTS
from fbl_gym.envs.error_scales import ErrorScales, drive_numbers
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array, inertia_matrix
from fbl_gym.options import SENSORS
from fbl_gym.records.checks import Pair, check_choice, check_choices, check_flag, check_number
from fbl_gym.records.record import Record, choice, choices, declared, number, pair, whole

ACTIONS = ("torque", "residual", "blend")
PREVIEWED = 5  # coming samples of the reference that an agent with preview observes
LEAST_SQUARE = 1e-6  # square of a scaled error that an agent with memory cannot tell from zero
GATE = 0.1  # share of a torque limit within which a residual fades, so that the law alone brakes there


def _check_law(name: str, value: Any) -> str:
    if value:
        law = PolicyName.parse(str(value))
        check_choice(name, law.source, controllers.names())
        check_choices("parts", law.parts, PARTS)
    return str(value)


def _check_scales(name: str, value: Any) -> tuple[float, ...]:
    return tuple(check_number(f"{name}[{i}]", scale, above=0) for i, scale in enumerate(value))


@dataclass(frozen=True)
class AdapterSettings(Record):
    """The settings of an agent's adapter, as plain data.

    The agent observes tracking errors at a fixed scale, as of `envs.error_scales.ErrorScales`.
    Steps before the episode are zeros in its history.

    Args:
        action: meaning of the action, which lies in [-1, 1] per joint.
            "torque": the torque is the action times the drives' torque limits.
            "residual": `residual` times the action, times the nominal inertia, is added to the
            torque of `base`. It fades where that torque is within `GATE` of a limit.
            "blend": the torque of each joint is between those of `second` (-1) and `base` (1).
        residual: largest residual acceleration of both joints.
        base: name of the law under the agent, which may have parts and gains. With @tuned, it has
            the gains for the class of each robot.
        second: name of a blend's other law; empty for other actions.
        history: number of earlier steps whose errors and actions the agent observes, latest first.
        reach: age of the oldest of these steps, which then lie ever further apart; 0: all follow
            one another.
        fine: None, or scales s of the errors of position [rad] and velocity [rad/s], of which the
            agent then observes asinh(e / s).
        integral: time constant of the running mean e of the position error, of which the agent
            observes asinh(e / s), where s is the scale of that error; 0: none.
        memory: time constant of running mean squares that the agent observes, as logarithms; they
            are of the errors of its sensors, of the difference between a blend's torques over the
            inertia of the stretched arm, and of the change of both over one step. 0: none.
        drive: True if the agent observes the delay and lag that the drive's datasheet states, and
            the class of the robot.
        arm: True if the agent observes the nominal arm, the springs and the errors of the sensors
            that the datasheet states.
        period: time between two decisions of the agent; 0: each step. The law under it decides at
            each step.
        preview: how far ahead the agent observes the reference, at `PREVIEWED` samples, each less
            the present one; 0: not at all.
        sensors: the sensors that the agent observes, which the environment must have.
        scales: of the errors of position [rad], velocity [rad/s] and acceleration [rad/s^2].
    """

    action: str = choice("torque", ACTIONS)
    residual: float = number(20.0, unit="rad/s^2", above=0)
    base: str = declared("computed-torque@frequency=15", _check_law, "name of a law")
    second: str = declared("", _check_law, "name of a law")
    history: int = whole(0)
    reach: float = number(0.0, unit="s", low=0, high=1)
    fine: Pair | None = pair(None, above=0)
    integral: float = number(0.0, unit="s", low=0)
    memory: float = number(0.0, unit="s", low=0)
    drive: bool = declared(False, check_flag, "True or False")
    arm: bool = declared(False, check_flag, "True or False")
    period: float = number(0.0, unit="s", low=0)
    preview: float = number(0.0, unit="s", low=0, high=100)
    sensors: tuple[str, ...] = choices(SENSORS, SENSORS)
    scales: tuple[float, float, float] = declared((0.1, 1.0, 10.0), _check_scales, "three numbers greater than 0")

    def validate(self) -> None:
        """Refuse a blend without two laws, a second law without a blend, and a missing position."""
        if (self.action == "blend") != bool(self.second) or self.second == self.base:
            raise ValueError(f"second must be a law for a blend alone, and another than base, got {self.second!r}")
        if "position" not in self.sensors:
            raise ValueError(f"sensors must include 'position', got {self.sensors}")

    def previewed(self, control_dt: float) -> int:
        """Return the number of coming samples of the reference that the environment must have."""
        return math.ceil(self.preview / control_dt - 1e-9)

    @property
    def uses(self) -> tuple[str, ...]:
        """Return the laws under the agent, which its numbers depend on."""
        return {"residual": (self.base,), "blend": (self.base, self.second)}.get(self.action, ())


class AdapterState(NamedTuple):
    """State of an `AgentAdapter`."""

    history: Array  # of errors and actions [n x ...]
    mean: Array  # running mean of the position error [n x 2]
    laws: tuple[State, ...]  # of the laws under the agent
    signals: Array  # errors, and a blend's difference of torques, at the last step [n x ...]
    squares: Array  # running means of the squares of the signals and of their change [n x ...]
    action: Array  # of the agent's last decision [n x 2]
    age: Array  # of the episode, in steps [n]


class AgentAdapter:
    """An adapter between one environment and an agent.

    `size` is that of the agent's observation. The agent observes only its sensors and the
    reference. The laws under it are told the torque that is sent: their observers and predictors
    would else take the agent, or the other law, for a disturbance.
    """

    def __init__(self, settings: AdapterSettings, interface: Interface) -> None:
        self.settings, self.interface = settings, interface
        sensors, present = settings.sensors, [name for name in SENSORS if name in interface.layout]
        if not set(sensors) <= set(present):
            raise ValueError(f"not applicable: the agent has sensors of {', '.join(sensors)}, got {', '.join(present)}")
        if settings.action == "torque" and interface.torque_limit is None:
            raise ValueError("not applicable: the agent's actions are shares of torque limits, and there are none")
        self._errors = ErrorScales(interface, settings.sensors, settings.scales, settings.fine)
        self._step_size = self._errors.size + 2  # the errors and the action of one earlier step
        drive, arm = drive_numbers(interface) if settings.drive else (), _arm(interface) if settings.arm else ()
        self._sheet, dt = np.array([*drive, *arm]), interface.control_dt
        self.hold = max(1, round(settings.period / dt))
        ahead, reference = settings.previewed(dt), interface.layout.reference.reshape(-1, 6)
        if ahead >= len(reference):
            raise ValueError(f"not applicable: the agent needs preview={ahead}, got preview={len(reference) - 1}")
        samples = np.ceil(ahead * np.arange(1, PREVIEWED + 1) / PREVIEWED).astype(int) if ahead else reference[:0, 0]
        self._ahead, self._now = (np.ravel(reference[each]) for each in (samples, 0 * samples))
        self._ahead_scale = np.resize(np.repeat(settings.scales, 2), self._ahead.size)
        self._remembered = 2 * len(settings.sensors) * (settings.memory > 0)
        self._signals = self._remembered + 2 * (settings.memory > 0 and settings.action == "blend")
        self._weight, self._mean_weight = (dt / max(time, dt) for time in (settings.memory, settings.integral))
        oldest = max(settings.history, round(settings.reach / (dt * self.hold)))
        ages = np.round(np.geomspace(1, max(1, oldest), settings.history)).astype(int)
        ages = np.maximum(ages, np.arange(1, settings.history + 1))
        self._past = (self._step_size * (ages[:, None] - 1) + np.arange(self._step_size)).ravel()
        self._history = self._step_size * int(ages.max(initial=0))
        self._means, self._finest = 2 * (settings.integral > 0), (settings.fine or settings.scales)[0]
        more = self._past, self._sheet, self._ahead
        self.size = self._errors.size + self._means + 2 * self._signals + sum(map(len, more))
        self._laws: list[Any] = [controllers.make(name, interface) for name in settings.uses]
        for name, law in zip(settings.uses, self._laws, strict=True):
            if not isinstance(law, TorqueLaw):
                raise ValueError(f"base must be a law that computes a torque, got {name!r}")

    def initial(self, observation: Array) -> State:
        """Return the state at the start of an episode."""
        n = len(observation)
        history, mean, signals, action = (np.zeros((n, m)) for m in (self._history, self._means, self._signals, 2))
        signals[:, : self._remembered] = self._errors(observation)[:, : self._remembered]
        laws = tuple(law.initial(observation) for law in self._laws)
        return AdapterState(history, mean, laws, signals, np.tile(signals**2, 2), action, np.zeros(n, dtype=int))

    def decides(self, state: State) -> Array:
        """Return True for the lanes [n] in which the agent decides now."""
        return state.age % self.hold == 0

    def observe(self, observation: Array, state: State) -> Array:
        """Return the agent's observation [n x size] from the environment's."""
        sheet = np.broadcast_to(self._sheet, (len(observation), len(self._sheet)))
        squares = 0.25 * np.log(state.squares + LEAST_SQUARE)
        ahead = np.clip((observation[:, self._ahead] - observation[:, self._now]) / self._ahead_scale, -10.0, 10.0)
        mean, history = np.arcsinh(state.mean / self._finest), state.history[:, self._past]
        return np.concatenate([self._errors(observation), history, mean, squares, sheet, ahead], axis=-1)

    def torque(self, action: Array, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state.

        Args:
            action: of the agent [n x 2], which counts in the lanes of `decides`.
            observation: of the environment [n x size].
            state: of the adapter.
        """
        decides = self.decides(state)[:, None]
        action = np.where(decides, np.clip(np.asarray(action, dtype=float), -1.0, 1.0), state.action)
        errors, layout = self._errors(observation), self.interface.layout
        later = np.concatenate([errors, action, state.history], axis=-1)[:, : self._history]
        history = np.where(decides, later, state.history)
        error = observation[:, layout["reference_position"]] - observation[:, layout["position"]]
        mean = state.mean + self._mean_weight * (error[:, : self._means] - state.mean)
        decided = [law.decide(observation, each) for law, each in zip(self._laws, state.laws, strict=True)]
        torques = [self.interface.saturate(each) for each, _ in decided]
        torque = self._torque(action, observation, torques)
        laws = tuple(law.settle(draft, torque) for law, (_, draft) in zip(self._laws, decided, strict=True))
        signals = errors[:, : self._remembered]
        if self._signals > self._remembered:
            apart = (torques[0] - torques[1]) / (self._laws[0].stretched * self.settings.scales[2])
            signals = np.concatenate([signals, apart], axis=-1)
        squares = np.concatenate([signals, signals - state.signals], axis=-1) ** 2
        squares = state.squares + self._weight * (squares - state.squares)
        return torque, AdapterState(history, mean, laws, signals, squares, action, state.age + 1)

    def _torque(self, action: Array, observation: Array, torques: list[Array]) -> Array:
        """Return the torque [n x 2] N m of an action over those of the laws, within limits."""
        if not torques:
            return np.array(self.interface.torque_limit) * action
        torque, *second = torques
        if second:
            return second[0] + 0.5 * (1.0 + action) * (torque - second[0])
        inertia = inertia_matrix(self.interface.nominal, observation[:, self.interface.layout["position"]])
        residual = self.settings.residual * (inertia * action[:, None]).sum(axis=-1)
        residual *= np.clip((1.0 - np.abs(torque) / self.interface.torque_scale) / GATE, 0.0, 1.0)
        return self.interface.saturate(torque + residual)


def _arm(interface: Interface) -> tuple[float, ...]:
    """Return what the datasheet states of arm, springs and sensors, as numbers of order one.

    Torques are shares of their limits: those of gravity, of accelerations of 10 rad/s^2, and the
    one that twists a spring by 10 mrad.
    """
    nominal, limit = interface.nominal, interface.torque_scale
    weight = np.array(nominal.lumped) * (10.0, 10.0, 10.0, 1.0, 1.0) / limit[[0, 0, 1, 0, 1]]
    rotor = 10.0 * np.array(nominal.rotor or (0.0, 0.0)) / limit
    strength = np.where(np.isfinite(limit), limit, 0.0)
    twist = np.zeros((2, 2)) if interface.stiffness is None else 100.0 * strength / np.array(interface.stiffness)
    readings = 1e3 * np.array([*interface.noise_std[0], *interface.resolution])
    return (*weight, *rotor, *twist.ravel(), *(100.0 * np.array(interface.backlash)), *readings)
