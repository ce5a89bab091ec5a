"""Code shared by the single and the vector environment: arguments, seeds, rendering, properties."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from gymnasium import error, logger
from gymnasium.envs.registration import EnvSpec

from fbl_gym.arm import ArmParameters, Array
from fbl_gym.batch import ArmBatch
from fbl_gym.checks import Pair, check_choice, check_whole, unknown
from fbl_gym.interface import Interface, Layout
from fbl_gym.memory import NO_AUTORESET
from fbl_gym.program import Program, make_program
from fbl_gym.records import build, declarations
from fbl_gym.reward import Reward
from fbl_gym.scenarios import Scenario, as_scenario

MAX_SEED = 2**64 - 1
MIN_RENDER_SIZE = 160
ARGUMENTS = ("scenario", "action", "reward", "preview", "render_mode", "render_size")
VECTOR_ARGUMENTS = ("num_envs", "autoreset_mode", "max_episode_steps", "threads")


class TaskProperties:
    """Properties shared by the single and the vector environment.

    Attributes:
        scenario: the task.
        interface: all that a policy may know.
    """

    scenario: Scenario
    interface: Interface
    metadata: dict[str, Any]
    _spec: EnvSpec | None = None

    def _prepare(self, program: Program, render_mode: str | None, render_size: int, **metadata: Any) -> None:
        """Set all that both environments have, before the first reset."""
        if render_mode is not None:
            check_choice("render_mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.render_size = check_whole("render_size", render_size, low=MIN_RENDER_SIZE)
        # A film with one frame per step then runs in real time.
        frame_rate = max(1, round(1.0 / self.scenario.control_dt))
        self.metadata = {**self.metadata, "render_fps": frame_rate, **metadata}
        self.interface = program.interface
        self._size = program.interface.layout.size
        self._seeded = False

    @property
    def spec(self) -> EnvSpec | None:
        """Return the spec that `gym.make` sets. Its options are plain data, which survive JSON."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec.kwargs = _plain(spec.kwargs)
        self._spec = spec

    @property
    def layout(self) -> Layout:
        """Return the names, slices and units of the observation."""
        return self.interface.layout

    @property
    def nominal(self) -> ArmParameters:
        """Return the nominal model, which a policy may know."""
        return self.interface.nominal

    @property
    def control_dt(self) -> float:
        """Return the time between two decisions [s]."""
        return self.interface.control_dt

    @property
    def torque_limit(self) -> Pair | None:
        """Return the largest torque of each joint [N m]; None: no limit."""
        return self.interface.torque_limit


def _plain(value: Any) -> Any:
    """Return a value with each array in it as a list."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    return type(value)(map(_plain, value)) if type(value) in (list, tuple) else value


def configure(
    scenario: Any,
    action: Any,
    reward: Any,
    preview: Any,
    options: dict[str, Any],
    max_episode_steps: int | None = None,
    autoreset: int = NO_AUTORESET,
) -> tuple[Scenario, Program]:
    """Return the scenario and the program of an environment's arguments."""
    built = as_scenario(scenario)
    for name in options:
        _check_option(name)
    if options:
        built = built.replace(**options)
    program = make_program(
        built,
        action=action,
        reward=Reward() if reward is None else build("reward", reward, Reward),
        preview=preview,
        max_episode_steps=max_episode_steps,
        autoreset=autoreset,
    )
    return built, program


def make_batch(scenario: Scenario, program: Program, lanes: int, threads: int = 1) -> ArmBatch:
    """Return a batch of arms on the scenario's plant."""
    if scenario.plant is None:
        return ArmBatch(program, lanes, threads)
    try:
        from fbl_gym.mujoco_batch import MuJoCoBatch
    except ImportError:
        raise error.DependencyNotInstalled("plant='mujoco' needs MuJoCo: pip install 'fbl-gym[mujoco]'") from None
    return MuJoCoBatch(scenario, program, lanes)


def _check_option(name: str) -> None:
    """Refuse a name that is no field of `Scenario`."""
    fields = [field.name for field in dataclasses.fields(Scenario)]
    if name in fields:
        return
    if name in VECTOR_ARGUMENTS:
        raise ValueError(
            f"{name!r} is an option of the vector environment: "
            "gym.make_vec(..., vectorization_mode='vector_entry_point'), or fbl_gym.TwoLinkArmVectorEnv"
        )
    paths = option_paths(Scenario, name) + [f"reward={path}" for path in _paths_in((Reward,), name)]
    if paths:
        raise ValueError(f"unknown option {name!r}; did you mean {' or '.join(dict.fromkeys(paths))}?")
    raise unknown("option", name, (*ARGUMENTS, *VECTOR_ARGUMENTS, *fields))


def option_paths(cls: type, name: str) -> list[str]:
    """Return the ways to give a field of an option, such as "friction={'viscous': ...}"."""
    return [f"{field}={path}" for field, d in declarations(cls).items() for path in _paths_in(d.classes, name)]


def _paths_in(classes: tuple[type, ...], name: str) -> list[str]:
    """Return the dicts of some records that give a field, such as "{'viscous': ...}"."""
    paths = []
    for cls in classes:
        by_kind = f"'kind': {cls.kind!r}, " if hasattr(cls, "kind") else ""
        for field, declaration in declarations(cls).items():
            inner = ["..."] if field == name else _paths_in(declaration.classes, name)
            paths += [f"{{{by_kind}{field!r}: {value}}}" for value in inner]
    return paths


def check_seed(seed: Any) -> int:
    """Return a seed as an int that fits the key of a random stream."""
    value = check_whole("seed", seed)
    if value > MAX_SEED:
        raise ValueError(f"seed must be below 2**64, got {value}")
    return value


def check_reset_options(options: dict[str, Any] | None, known: tuple[str, ...]) -> None:
    """Refuse options of `reset` that are not known."""
    for name in options or {}:
        if not known:
            raise ValueError(f"unknown reset option {name!r}; this environment has none: give options to gym.make")
        check_choice("reset option", name, known)


def check_begun(name: str, has_begun: bool) -> None:
    """Refuse to read a property before the first reset."""
    if not has_begun:
        raise error.ResetNeeded(f"call reset() before reading {name}: no episode has begun")


def check_render(render_mode: str | None, has_begun: bool) -> str | None:
    """Return the render mode; warn if it is None, as Gymnasium's environments do."""
    if render_mode is None:
        logger.warn('render() draws nothing without a render_mode: gym.make(..., render_mode="rgb_array")')
    elif not has_begun:
        raise error.ResetNeeded("call reset() before the first render()")
    return render_mode


def as_actions(action: Any, shape: tuple[int, ...]) -> Array:
    """Return actions as an array of real numbers; refuse another shape."""
    try:
        array = np.asarray(action)
    except ValueError:
        array = np.empty(0, dtype=object)  # rows of different lengths
    if array.dtype.kind not in "fiu":
        raise ValueError(f"action must be numbers of shape {shape}, got {action!r}")
    if array.shape != shape:
        raise ValueError(f"action must have shape {shape}, got shape {array.shape}")
    return array
