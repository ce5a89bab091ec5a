"""The single environment, `fbl_gym/TwoLinkArm-v0`."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import error, logger

from fbl_gym.arm import ArmParameters, Array
from fbl_gym.batch import ArmBatch, Truth, single
from fbl_gym.checks import Pair, check_whole, unknown
from fbl_gym.interface import Interface, Layout
from fbl_gym.memory import NO_AUTORESET
from fbl_gym.program import Program, make_program
from fbl_gym.records import build
from fbl_gym.reward import Reward
from fbl_gym.scenarios import Scenario, as_scenario

if TYPE_CHECKING:
    from fbl_gym.render import View

MAX_SEED = 2**64 - 1
MIN_RENDER_SIZE = 160
_FIRST = np.zeros(1, dtype=np.int64)
ARGUMENTS = ("scenario", "action", "reward", "preview", "render_mode", "render_size")
_USUAL = frozenset({np.dtype(np.float32), np.dtype(np.float64)})
OF_BATCHES = ("num_envs", "autoreset_mode", "max_episode_steps", "threads")


class TaskProperties:
    """What both environments say of themselves: the scenario, and the interface that policies are given."""

    scenario: Scenario
    interface: Interface

    @property
    def layout(self) -> Layout:
        """Names, slices and units of the observation."""
        return self.interface.layout

    @property
    def nominal(self) -> ArmParameters:
        """The nominal model: what a controller may know of the arm."""
        return self.interface.nominal

    @property
    def control_dt(self) -> float:
        """Time between two decisions [s]."""
        return self.interface.control_dt

    @property
    def torque_limit(self) -> Pair | None:
        """Largest torque of each joint [N m]; None: no limit."""
        return self.interface.torque_limit


def configure(
    scenario: Any,
    action: Any,
    reward: Any,
    preview: Any,
    options: dict[str, Any],
    max_episode_steps: int | None = None,
    autoreset: int = NO_AUTORESET,
) -> tuple[Scenario, Program]:
    """The scenario and the program that an environment's arguments mean."""
    built = as_scenario(scenario)
    fields = [f.name for f in dataclasses.fields(Scenario)]
    for name in options:
        if name in OF_BATCHES:
            raise ValueError(
                f"{name!r} is an option of many arms at once: "
                "gym.make_vec(..., vectorization_mode='vector_entry_point'), or fbl_gym.TwoLinkArmVectorEnv"
            )
        if name not in fields:
            raise unknown("option", name, (*ARGUMENTS, *OF_BATCHES, *fields))
    if options:
        built = built.replace(**options)
    weights = Reward() if reward is None else build("reward", reward, Reward)
    return built, make_program(
        built,
        action=action,
        reward=weights,
        preview=preview,
        max_episode_steps=max_episode_steps,
        autoreset=autoreset,
    )


def check_seed(seed: Any) -> int:
    """`seed` as an int that a stream's key can hold."""
    value = check_whole("seed", seed)
    if value > MAX_SEED:
        raise ValueError(f"seed must be below 2**64, got {value}")
    return value


def check_reset_options(options: dict[str, Any] | None, known: tuple[str, ...]) -> None:
    for name in options or {}:
        if name not in known:
            raise (
                unknown("reset option", name, known)
                if known
                else ValueError(
                    f"unknown reset option {name!r}; this environment has none: its options are given to gym.make"
                )
            )


def frame_rate(scenario: Scenario) -> int:
    """At so many frames per second, a film with one frame for each step runs in real time."""
    return max(1, round(1.0 / scenario.control_dt))


def check_render(render_mode: str | None, has_begun: bool) -> str | None:
    """The mode to draw in; None, with a warning as in Gymnasium's own environments, where none was asked for."""
    if render_mode is None:
        logger.warn('render() draws nothing without a render_mode: gym.make(..., render_mode="rgb_array")')
    elif not has_begun:
        raise error.ResetNeeded("call reset() before the first render()")
    return render_mode


class TwoLinkArmEnv(TaskProperties, gym.Env[Any, Any]):
    """An uncertain two-link arm that is to follow a reference.

    ## Description

    Two links turn in a vertical plane, moved by a torque at each joint. The arm obeys equations (1)-(4) of Wang, Wang and
    Brdys (Cogent Engineering 3:1173529, 2016),

        M(q) a + C(q, v) v + G(q) + F(v) + tau_d = tau

    with theta1 measured from the horizontal and theta2 from the first link. What a policy knows is a nominal model; the
    real arm may differ from it in every way that the options below name.

    ## Action space

    `Box([-1, -1], [1, 1], (2,), float32)`: the torque of joints 1 and 2 as a fraction of their limits (2,000 and 800 N m by
    default). With `action="torque"` it is the torque in N m; with `action="acceleration"` it is an acceleration in rad/s^2
    (within +-100) that goes through the nominal feedback linearisation mapping at the measured state. The torque is held for
    `control_dt`. An action of dtype float64 is used at its full precision. A value outside the box acts as the nearest
    inside; NaN or infinity is an error, and nothing moves.

    ## Observation space

    `Box((12,), float64)` with all sensors. `env.unwrapped.layout` gives the slices by name.

    | index | name | unit | bound |
    |---|---|---|---|
    | 0, 1 | position: measured joint angles | rad | 8 pi |
    | 2, 3 | velocity: measured | rad/s | 200 |
    | 4, 5 | acceleration: measured at the end of the interval, under the torque held | rad/s^2 | 1e5 |
    | 6, 7 | reference_position | rad | 8 pi |
    | 8, 9 | reference_velocity | rad/s | 200 |
    | 10, 11 | reference_acceleration | rad/s^2 | 1e5 |
    | then | previous_action, only with an actuator delay or lag | as the action | as the action |
    | then | preview, only with `preview=n`: 6 entries for each of the next n samples | as the reference | as above |

    A sensor that is left out (`sensors=("position",)`) leaves its slot out. Readings saturate at the bounds.

    ## Reward

    Between 0 and 1, 1 for perfect tracking without effort or chatter: see `fbl_gym.reward`. `reward={"tracking": "l1", ...}`
    changes its form, scales and weights.

    ## Start, end

    The arm starts on its reference (plus `initial_error`), under the torque that would hold the nominal arm still. The
    episode is truncated after `duration` (10 s), and terminated, with reward 0, when a joint is more than 4 pi from where it
    started or faster than 100 rad/s (`limits`).

    ## Arguments

    * `scenario`: a name (`fbl_gym.scenarios.names()`), a `Scenario`, or its dict; None: the nominal arm.
    * `**options`: fields of `Scenario` that replace the scenario's: `arm`, `parameter_error`, `noise`, `friction`,
      `disturbance`, `actuator`, `sensors`, `reference`, `control_dt`, `physics_dt`, `duration`, `initial_error`, `limits`.
      Each is a record or the plain data that makes one; None switches the option off.
    * `action`: "normalized", "torque" or "acceleration".
    * `reward`: a `Reward` or a dict of its fields.
    * `preview`: how many coming samples of the reference are observed.
    * `render_mode`: "human", a window in real time, or "rgb_array", a frame for each `render()`; both need pygame
      (`pip install 'fbl-gym[render]'`).
    * `render_size`: of the square frame [pixels]; 480.

    ## Determinism

    An episode is a function of (scenario, seed, actions). `reset(seed=s)` starts the first episode of seed s, `reset()` the
    next one of the same seed. Every random number comes from a named stream, so one option does not shift another.

    ## Version history

    * v0: first release.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 100}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self,
        scenario: Scenario | str | dict[str, Any] | None = None,
        *,
        action: str = "normalized",
        reward: Reward | dict[str, Any] | None = None,
        preview: int = 0,
        render_mode: str | None = None,
        render_size: int = 480,
        **options: Any,
    ) -> None:
        self.scenario, program = configure(scenario, action, reward, preview, options)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise unknown("render_mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.render_size = check_whole("render_size", render_size, low=MIN_RENDER_SIZE)
        self.metadata = {**self.metadata, "render_fps": frame_rate(self.scenario)}
        self.interface = program.interface
        self.observation_space = program.interface.observation_space
        self.action_space = program.interface.action_space
        self._view: View | None = None
        self._batch = ArmBatch(program, 1)
        self._seeded = False
        self._size = program.interface.layout.size

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode: the first of `seed`, or the next one of the seed given before.

        Args:
            seed: 0 to 2**64 - 1; None goes on with the seed given before, or draws one from the operating system's entropy.
            options: none are known; what the environment offers is given to `gym.make`.

        Returns:
            The first observation, [size], and an empty info.
        """
        check_reset_options(options, ())
        if seed is not None:
            seed = check_seed(seed)
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            own = self.np_random.integers(MAX_SEED, dtype=np.uint64) if seed is None else np.uint64(seed)
            self._batch.seed(_FIRST, own)
            self._seeded = True
        else:
            self._batch.next_episode(_FIRST)
        observation = np.empty(self._size)
        self._batch.reset(_FIRST, observation)
        if self.render_mode == "human":
            self.render()
        return observation, {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold an action for `control_dt`.

        Args:
            action: [2], in the action's unit.

        Returns:
            Observation [size], reward, terminated, truncated, and an empty info.

        Raises:
            ValueError: if the action has another shape, or is not finite. The environment has not moved then.
            gymnasium.error.ResetNeeded: before the first `reset`, and after an episode's end.
        """
        if type(action) is not np.ndarray or action.dtype not in _USUAL or action.shape != (2,):  # hardly ever
            action = as_actions(action, (2,))
        observation = np.empty(self._size)
        refused, reward, terminated, truncated = self._batch.step(action, observation)
        if refused >= 0:
            if refused == 0:
                raise ValueError(f"action must be finite, got {action!r}")
            raise error.ResetNeeded("the episode has ended, or none has begun: call reset() before step()")
        if self.render_mode == "human":
            self.render()
        return observation, reward, terminated, truncated, {}

    @property
    def truth(self) -> Truth:
        """The true parameters and signals now, made when asked for. A policy must not look."""
        return single(self._batch.truth())

    def render(self) -> Any:
        """The frame of this instant, [size x size x 3]; None in mode "human", where `reset` and `step` show it themselves.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
            gymnasium.error.DependencyNotInstalled: without pygame.
        """
        if check_render(self.render_mode, self._seeded) is None:
            return None
        if self._view is None:
            from fbl_gym.render import View

            self._view = View(self.scenario, self.render_size)
        return self._view.show(self.truth) if self.render_mode == "human" else self._view.frame(self.truth)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._view is not None:
            self._view.close()
            self._view = None


def as_actions(action: Any, shape: tuple[int, ...]) -> Array:
    """`action` as an array of real numbers; an action of another shape is an error."""
    try:
        array = np.asarray(action)
    except ValueError:
        array = np.empty(0, dtype=object)  # rows of different lengths
    if array.dtype.kind not in "fiu":
        raise ValueError(f"action must be numbers of shape {shape}, got {action!r}")
    if array.shape != shape:
        raise ValueError(f"action must have shape {shape}, got shape {array.shape}")
    return array
