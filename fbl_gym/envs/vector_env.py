"""The vector environment: many arms of one scenario, stepped together."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import error
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from fbl_gym.envs.env_common import (
    FIRST_RESET,
    MAX_SEED,
    START,
    TaskProperties,
    as_actions,
    check_reset_options,
    check_seed,
)
from fbl_gym.envs.side_by_side import side_by_side
from fbl_gym.kernel.batch import Flags, Truth
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import check_choice, check_whole

#: The modes, in the order of their numbers in the kernel.
_AUTORESET = (AutoresetMode.DISABLED, AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)


class TwoLinkArmVectorEnv(TaskProperties, VectorEnv[Array, Array, Array]):
    """Independent arms of one scenario, stepped together.

    `TwoLinkArmEnv` describes spaces, reward and options. A lane with seed s equals the single
    environment with seed s bit for bit, for any `num_envs`. As in Gymnasium's vector environments,
    `reset(seed=s)` gives lane i the seed s + i.

    With a list of scenarios, this returns a `SideBySideVectorEnv`: a batch of each, side by side.

    The other arguments are those of `TwoLinkArmEnv`.

    Args:
        num_envs: number of lanes, one or more.
        scenario: as in `TwoLinkArmEnv`, or a list of them, which share the lanes equally.
        autoreset_mode: NEXT_STEP (default), SAME_STEP or DISABLED, as
            `gymnasium.vector.AutoresetMode` or its value.
        max_episode_steps: truncate after this number of steps, if the scenario's duration is
            longer.
        threads: number of threads that step the lanes, with the same bits for any number. None: all
            cores that the process may use from 1,024 lanes on (`OMP_NUM_THREADS`, affinity and a
            container's quota limit them), else one. A thread takes at least 64 lanes. Windows has
            one.
        device: "cpu", or "cuda" for an NVIDIA GPU (extra `cuda`), with the same bits. Observations,
            rewards and flags are then torch tensors on the GPU, or, if torch has no CUDA, arrays
            with `__dlpack__`. Actions are one of these, or a NumPy array. `step` does not wait for
            the GPU; `check` raises its errors. `reset` and `truth` copy the whole batch. So does
            each step with `info` or `constraints`, whose infos are NumPy arrays.
        render_mode: "rgb_array" or None.
        render_size: width and height of each lane's frame [pixels].
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012 - as in Gymnasium

    def __new__(cls, num_envs: int = 1, scenario: Any = None, **options: Any) -> Any:
        """Return a batch of one scenario, or those of a list side by side."""
        if isinstance(scenario, list | tuple):
            return side_by_side(cls, num_envs, scenario, options)
        return super().__new__(cls)

    def __init__(
        self, num_envs: int = 1, scenario: Any = None, *, autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None, threads: int | None = None, device: str = "cpu", **options: Any,
    ) -> None:  # fmt: skip
        self.num_envs = self._lanes = check_whole("num_envs", num_envs, low=1, high=10**7)
        mode, modes = getattr(autoreset_mode, "value", autoreset_mode), [each.value for each in AutoresetMode]
        self.autoreset_mode = AutoresetMode(check_choice("autoreset_mode", mode, modes))
        if max_episode_steps is not None:
            check_whole("max_episode_steps", max_episode_steps, low=1)
        self._episodes = {"max_episode_steps": max_episode_steps, "autoreset": _AUTORESET.index(self.autoreset_mode)}
        self.device, self._threads = check_choice("device", device, ("cpu", "cuda")), threads
        super().__init__(scenario, **options)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = self.observation_space, self.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every lane, or in some.

        Args:
            seed: s gives lane i the seed s + i. A sequence has one seed per lane; None in it: the
                next episode of that lane's last seed. None: the same for every lane. The first
                `reset` without a seed draws them from the operating system's entropy.
            options: {"reset_mask": mask} resets the lanes where the boolean mask [num_envs] is
                True; with `device="cuda"` it may be a tensor. "position", "velocity" and
                "reference" are those of `TwoLinkArmEnv.reset`, the same for all lanes or, of each,
                [num_envs x 2] and [num_envs x points x 2], so [num_envs x 1 x 2] for goals.

        Returns:
            Observations [num_envs x size], unchanged for lanes that were not reset, and infos. They
            are empty without `context=True`. With it, they have `context`, and its mask `_context`.
        """
        check_reset_options(options, ("reset_mask", *START))
        mask = self._as_mask((options or {}).get("reset_mask"))
        if not self._begun and not mask.all():
            raise error.ResetNeeded(FIRST_RESET)
        (seeded, seeds), starts = self._as_seeds(seed), self.starts_of(options)
        super().reset(seed=int(seeds[0]) if len(seeds) else None)
        if not self._begun:
            drawn = self.np_random.integers(MAX_SEED, size=self.num_envs, dtype=np.uint64)
            self._batch.seed(np.arange(self.num_envs), drawn)
        chosen = np.flatnonzero(mask)
        self._batch.give(chosen, {name: start[chosen] for name, start in starts.items()})
        fresh = np.isin(chosen, seeded)
        self._batch.seed(chosen[fresh], seeds[mask[seeded]])
        if self._begun:
            self._batch.next_episode(chosen[~fresh])
        self._begun = True
        observations = self._batch.observations()
        self._batch.reset(chosen, observations)
        return observations, _in_lanes(mask, self._context())

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Hold each lane's action for `control_dt`.

        Args:
            actions: [num_envs x 2], in the unit of `action`.

        Returns:
            Observations [num_envs x size], rewards, terminated and truncated [num_envs], and infos.
            In SAME_STEP mode, infos has `final_obs` and `final_info` of the lanes that ended, with
            their masks `_final_obs` and `_final_info`. With `info=True` or `constraints`, it has
            the arrays of `TwoLinkArmEnv`, with masks that are False in lanes that this step reset;
            those of their last step are in `final_info`. With `context=True`, it has the context of
            the lanes that this step reset. On a GPU, `final_obs` is one array
            [num_envs x size], of which the rows of lanes that ended count; torch has their mask.

        Raises:
            ValueError: if the actions have another shape or one is not finite. No lane has moved.
                On a GPU, the others have moved: see `check`.
            gymnasium.error.ResetNeeded: before the first `reset`, and in DISABLED mode if a lane
                that ended was not reset.
        """
        if self.device == "cpu":
            actions = as_actions(actions, (self.num_envs, 2))
        self._expect_begun("the first step()")
        batch = self._batch
        observations = batch.observations()
        self._refuse(batch.step(actions, observations), actions)
        rewards, terminated, truncated = batch.outcomes
        return observations, rewards, terminated, truncated, self._infos(terminated, truncated)

    def check(self) -> None:
        """Wait for the GPU, and raise the error of a lane that did not move since the last check.

        Such a lane has an action that is not finite, or needs a reset; its reward is NaN. On the
        CPU, `step` has raised it.
        """
        if self.device == "cuda":
            self._refuse(self._batch.refused())

    def _refuse(self, refused: int, actions: Any = None) -> None:
        """Raise the error of a result of `api.check`, if it is one."""
        if refused < 0:
            return
        lane = refused // 2
        if refused % 2 == 0:
            got = "" if actions is None else f", got {actions[lane]}"
            raise ValueError(f"actions must be finite{got} in lane {lane}")
        raise error.ResetNeeded(
            f"the episode of lane {lane} has ended: call reset(options={{'reset_mask': ...}}) before step()"
        )

    def _infos(self, terminated: Flags, truncated: Flags) -> dict[str, Any]:
        measures = self._measures() if self._reports else {}
        infos: dict[str, Any] = _in_lanes(self._batch.field("step") > 0, measures) if measures else {}
        if self._has_context and (begins := self._batch.field("step") == 0).any():
            infos |= _in_lanes(begins, self._context())
        if self.autoreset_mode != AutoresetMode.SAME_STEP:
            return infos
        if self.device == "cuda":  # nothing here waits for the GPU, but for measures
            infos["final_obs"] = self._batch.final_observations
            if hasattr(terminated, "__or__"):
                infos["_final_obs"] = terminated | truncated
            if not measures:
                return infos
            terminated, truncated = (self._batch.field(name) != 0.0 for name in ("terminated", "truncated"))
        done = terminated | truncated
        if not done.any():
            return infos
        infos |= {"final_info": _in_lanes(done, measures), "_final_info": done.copy()}
        if self.device == "cpu":
            final, lasts = np.full(self.num_envs, None, dtype=object), self._batch.final_observations
            for lane in np.flatnonzero(done):
                final[lane] = lasts[lane].copy()
            infos |= {"final_obs": final, "_final_obs": done}
        return infos

    @property
    def truth(self) -> Truth:
        """Return the true parameters and signals of every lane now. A policy must not use them."""
        self._expect_begun("reading truth")
        return self._batch.truth()

    def true_signals(self) -> dict[str, Array]:
        """Return the true signals that a recording needs, without computing the rest of `truth`.

        They are `position`, `velocity`, `reference`, `applied_torque`, `disturbance` and the last
        `command`, [lanes x 2], and `payload`, [lanes].
        """
        self._expect_begun("reading true_signals")
        return self._batch.true_signals()

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return the frame of each lane, [size x size x 3]; see `TwoLinkArmEnv.render`."""
        views = self._shown_views()
        if not views:
            return None
        lanes = map(self.truth.of_lanes, range(self.num_envs))
        return tuple(view.frame(lane) for view, lane in zip(views, lanes, strict=True))

    def _as_mask(self, mask: Any) -> Flags:
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        if self.device == "cuda" and hasattr(mask, "cpu"):
            mask = mask.cpu().numpy()
        if not (isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (self.num_envs,)):
            raise ValueError(f"reset_mask must be a boolean array of shape ({self.num_envs},), got {mask!r}")
        if not mask.any():
            raise ValueError("reset_mask must have at least one True, got none")
        return mask

    def _as_seeds(self, seed: Any) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
        """Return the lanes that get a new seed, and those seeds."""
        if seed is None:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.uint64)
        if isinstance(seed, int | np.integer):
            first = check_seed(seed)
            check_seed(first + self.num_envs - 1)
            return np.arange(self.num_envs), np.uint64(first) + np.arange(self.num_envs, dtype=np.uint64)
        if np.shape(seed) != (self.num_envs,):
            raise ValueError(f"seed must be a whole number, or one for each of {self.num_envs} lanes, got {seed!r}")
        lanes = [lane for lane, lane_seed in enumerate(seed) if lane_seed is not None]
        return np.array(lanes, dtype=np.int64), np.array([check_seed(seed[lane]) for lane in lanes], dtype=np.uint64)


def _in_lanes(lanes: Flags, measures: dict[str, Array]) -> dict[str, Array]:
    """Return measures that are 0 outside of some lanes, each with these lanes as its mask."""
    infos: dict[str, Any] = {}
    for name, values in measures.items():
        infos |= {name: np.where(lanes if values.ndim == 1 else lanes[:, None], values, 0.0), f"_{name}": lanes.copy()}
    return infos
