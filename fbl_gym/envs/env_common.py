"""Code shared by the single and the vector environment: arguments, seeds, rendering, properties."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import error, logger
from gymnasium.envs.registration import EnvSpec

from fbl_gym.interface import Interface, Layout
from fbl_gym.kernel.batch import ArmBatch
from fbl_gym.kernel.cuda import CudaBatch
from fbl_gym.kernel.memory.layout import BLOCK, VARIED
from fbl_gym.kernel.memory.program import Program, make_program
from fbl_gym.kernel.step.pool import threads_for
from fbl_gym.model.arm import Array
from fbl_gym.options import Reward
from fbl_gym.records.checks import as_printed, check_choice, check_flag, check_whole, nearest
from fbl_gym.records.record import build, naming
from fbl_gym.scenarios import Scenario, as_scenario

#: Largest key of a random stream.
MAX_SEED = 2**64 - 1

#: Fields of a block with all numbers that an episode draws for its arm.
CONTEXT = ("parameters", *(VARIED.names or ()))
ARGUMENTS = ("scenario", "action", "reward", "preview", "past_actions", "info", "context", "render_mode", "render_size")


class TaskProperties:
    """Properties shared by the single and the vector environment.

    Attributes:
        scenario: the task.
        interface: all that a policy may know.
        layout: names, slices and units of the observation.
    """

    scenario: Scenario
    interface: Interface
    layout: Layout
    observation_space: Any
    action_space: Any
    metadata: dict[str, Any]
    device, _lanes = "cpu", 1
    _threads: int | None = 1
    #: Arguments of `make_program` on the episodes of a batch.
    _episodes: Mapping[str, Any] = {}
    _spec: EnvSpec | None = None

    def __init__(
        self, scenario: Scenario | str | dict[str, Any] | None = None, *, action: str = "normalized",
        reward: Reward | dict[str, Any] | None = None, preview: int = 0, past_actions: int = 0, info: bool = False,
        context: bool = False, render_mode: str | None = None, render_size: int = 480, **options: Any,
    ) -> None:  # fmt: skip
        known = [field.name for field in dataclasses.fields(Scenario)]
        for name in options:
            if name not in known:  # in Python's words: TorchRL tries some options, and goes on after this error alone
                advice = nearest(name, (*ARGUMENTS, *known))
                raise TypeError(f"{type(self).__name__}.__init__() got an unexpected keyword argument {name!r}{advice}")
        self._reward = Reward() if reward is None else build("reward", reward, Reward)
        task = {"reward": self._reward, "action": action, "preview": preview, "past_actions": past_actions}
        self.scenario, program = configure(scenario, options, **task, **self._episodes)
        if render_mode is not None:
            check_choice("render_mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self._info, self._has_context = check_flag("info", info), check_flag("context", context)
        self.render_size = check_whole("render_size", render_size, low=160)
        # A film with one frame per step then runs in real time.
        self.metadata = {**self.metadata, "render_fps": max(1, round(1.0 / self.scenario.control_dt))}
        self.interface, self.layout = program.interface, program.interface.layout
        self.observation_space, self.action_space = self.interface.observation_space, self.interface.action_space
        self._size, self._steps = self.layout.size, int(program.settings["last_step"])
        self._batch: Any = make_batch(self.scenario, program, self._lanes, self._threads, self.device)
        self._begun = False
        self._views: list[Any] = []  # of `render.View`
        self._reports = info or self.scenario.constraints is not None or render_mode == "human"

    def _context(self) -> dict[str, Array]:
        """Return the context of each lane for an info, if it is asked for."""
        if not self._has_context:
            return {}
        numbers = [self._batch.field(name).reshape(self._batch.lanes, -1) for name in CONTEXT]
        return {"context": np.nan_to_num(np.concatenate(numbers, axis=1), posinf=0.0)}  # no rate limit is infinite

    @property
    def context_names(self) -> tuple[str, ...]:
        """Return the name of each number of a context, such as "viscous[1]"."""
        sizes = {name: BLOCK[name].itemsize // BLOCK["step"].itemsize for name in CONTEXT}
        return tuple(f"{name}[{i}]" for name, size in sizes.items() for i in range(size))

    def _expect_begun(self, doing: str) -> None:
        """Refuse to do something before the first reset."""
        if not self._begun:
            raise error.ResetNeeded(f"call reset() before {doing}: no episode has begun")

    def state(self) -> Any:
        """Return a copy of the state of all arms, with their drives, sensors and episodes.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
        """
        self._expect_begun("reading state()")
        return self._batch.state()

    def set_state(self, state: Any) -> None:
        """Go on from a state as the environment did after `state()`, bit for bit.

        Args:
            state: that `state()` of an environment with the same arguments returned.

        Raises:
            ValueError: it is of an environment with other arguments or another number of arms.
        """
        if not self._batch.restore(state):
            raise ValueError("state must be that of an environment with the same arguments and number of arms")
        self._begun = True

    def starts_of(self, options: dict[str, Any] | None) -> dict[str, Array]:
        """Return where the options of `reset` let the next episode start, for all lanes."""
        given = {name: options[name] for name in START if options and options.get(name) is not None}
        if "reference" in given and self.scenario.reference.kind not in ("minimum-jerk", "steps", "filtered-steps"):
            raise ValueError(
                "reset option reference must be left out: it gives the way-points of minimum-jerk, steps and "
                f"filtered-steps, and this reference is {self.scenario.reference.kind}"
            )
        return {name: self._as_start(name, value) for name, value in given.items()}

    def _as_start(self, name: str, value: Any) -> Array:
        """Return an option of `reset` for all lanes, [lanes x 2] or [lanes x points x 2]."""
        array, shape, n = np.asarray(value), [2], self._batch.lanes
        if name == "reference":
            shape = [int(self._batch.settings["reference_points"]), 2]
            array = array[None] if array.shape == (2,) else array
            if array.ndim > 1 and 0 < (points := array.shape[-2]) < shape[0]:  # the arm stays at the last one
                array = np.concatenate([array, np.repeat(array[..., -1:, :], shape[0] - points, axis=-2)], axis=-2)
        fits = array.shape in ((*shape,), (n, *shape))
        if not fits or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            most = " or fewer way-points" if len(shape) > 1 else ""
            given = f"shape {array.shape}" if array.size > 8 else repr(value)
            raise ValueError(f"reset option {name} must be finite numbers of shape {(*shape,)}{most}, got {given}")
        return np.broadcast_to(array, (n, *shape))

    def _shown_views(self) -> list[Any]:
        """Return the view of each lane; without a render mode none, and warn as Gymnasium does."""
        if self.render_mode is None:
            logger.warn('render() draws nothing without a render_mode: gym.make(..., render_mode="rgb_array")')
            return []
        self._expect_begun("the first render()")
        if not self._views:
            from fbl_gym.view.render import View

            self._views = [View(self.scenario, self.render_size) for _ in range(self._batch.lanes)]
        return self._views

    def _measures(self) -> dict[str, Array]:
        """Return the quantities of the last step that go into its info, of each lane."""
        costs = {} if self.scenario.constraints is None else {"cost": self._batch.field("cost")}
        if not self._info:
            return costs
        error, command = np.split(self._batch.field("judged"), 2, axis=-1)
        use = np.abs(command) / self.interface.torque_scale
        losses = self._reward.losses(error, use, self._batch.field("chatter") / 4)
        return {"tracking_error": error, **losses, "saturation": (use >= 1.0).mean(axis=-1), **costs}

    @property
    def spec(self) -> EnvSpec | None:
        """Return the spec that `gym.make` sets. Its options are plain data, which survive JSON.

        Its `max_episode_steps` is the length of an episode, which the environment itself ends; that
        of `gym.make` may shorten it. `gym.make(spec, duration=...)` keeps the spec's number: give a
        larger one beside a longer duration.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec.kwargs = _plain(spec.kwargs)
            spec.__class__, spec.max_episode_steps = _Spec, self._steps
        self._spec = spec


class _Spec(EnvSpec):
    """A spec whose `max_episode_steps` may be lowered only: no wrapper lengthens an episode."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "max_episode_steps" and value is not None:
            value = min(value, self.max_episode_steps or value)
        super().__setattr__(name, value)


def _plain(value: Any) -> Any:
    """Return a value with each array in it as a list."""
    if isinstance(value, np.ndarray) and value.ndim:
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return as_printed(value[()]) if value.dtype.kind == "f" else value.tolist()  # type: ignore[index]
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    return type(value)(map(_plain, value)) if type(value) in (list, tuple) else value


def configure(scenario: Any, options: dict[str, Any], **task: Any) -> tuple[Scenario, Program]:
    """Return the scenario and the program of an environment; `task` is of `make_program`."""
    built = as_scenario(scenario)
    with naming(options):
        if options:
            built = built.replace(**options)
        return built, make_program(built, **task)


def make_batch(scenario: Scenario, program: Program, lanes: int, threads: int | None, device: str) -> ArmBatch:
    """Return a batch of arms on the scenario's plant and a device."""
    if threads is not None:
        check_whole("threads", threads, low=1, high=1024)
    if device == "cuda":
        if scenario.plant is not None:
            raise ValueError("device must be 'cpu' with plant='mujoco', which no GPU computes, got 'cuda'")
        if threads is not None:
            raise ValueError(f"threads must be None with device='cuda', where each lane is a thread, got {threads}")
        try:
            return CudaBatch(program, lanes)
        except (ImportError, RuntimeError) as problem:
            raise error.DependencyNotInstalled(str(problem)) from problem
    if scenario.plant is None:
        return ArmBatch(program, lanes, threads_for(lanes, threads))
    if threads not in (None, 1):
        raise ValueError(f"threads must be 1 or None with a plant, whose arms move one after the other, got {threads}")
    try:
        from fbl_gym.engines.mujoco import MuJoCoBatch
    except ImportError:
        raise error.DependencyNotInstalled("plant='mujoco' needs MuJoCo: pip install 'fbl-gym[mujoco]'") from None
    return MuJoCoBatch(scenario, program, lanes)


def check_seed(seed: Any) -> int:
    """Return a seed as an int that fits the key of a random stream."""
    if check_whole("seed", seed) > MAX_SEED:
        raise ValueError(f"seed must be below 2**64, got {seed!r}")
    return int(seed)


FIRST_RESET = "the first reset must be of every lane: no episode has begun outside reset_mask"
#: The options of `reset` that say where an episode starts.
START = ("position", "velocity", "reference")


def check_reset_options(options: dict[str, Any] | None, known: tuple[str, ...]) -> None:
    """Refuse options of `reset` that are not known."""
    for name in options or {}:
        check_choice("reset option", name, known)


def as_actions(action: Any, shape: tuple[int, ...]) -> Array:
    """Return actions as an array of real numbers; refuse another shape."""
    array = np.asarray(action)
    if array.dtype.kind not in "fiu" or array.shape != shape:
        given = f"shape {array.shape}" if array.dtype.kind in "fiu" else repr(action)
        raise ValueError(f"action must be numbers of shape {shape}, got {given}")
    return array
