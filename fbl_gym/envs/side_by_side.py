"""Batches of several scenarios, side by side as one vector environment."""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from gymnasium import error
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from fbl_gym.envs.env_common import FIRST_RESET, as_actions, check_seed
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import check_whole

#: Number of axes of an option of `reset` with a value for each lane.
_AXES = {"reset_mask": 1, "position": 2, "velocity": 2, "reference": 3}


class SideBySideVectorEnv(VectorEnv[Array, Array, Array]):
    """Vector environments of the same spaces as one, whose lanes follow one another.

    Each has the bits that it has alone. An integer seed of `reset` is that of each of them, so lane
    i of every scenario has the seed s + i.

    Args:
        *envs: one or more, on the CPU.

    Attributes:
        envs: the same. They have `scenario`, `interface` and `truth`.
    """

    def __init__(self, *envs: VectorEnv) -> None:
        self.envs, self.metadata, self.render_mode = envs, dict(envs[0].metadata), envs[0].render_mode
        *self._cuts, self.num_envs = np.cumsum([env.num_envs for env in envs]).tolist()
        for name in ("observation_space", "action_space"):
            first, *spaces = (getattr(env, f"single_{name}") for env in envs)
            for space in spaces:
                if space != first:
                    shapes = f"shapes {first.shape} and {space.shape}, maybe with other bounds"
                    raise ValueError(
                        f"scenarios must have the same {name}, such as by sensors and limits, got {shapes}"
                    )
            setattr(self, f"single_{name}", first)
            setattr(self, name, batch_space(first, self.num_envs))
        self._seen: Any = None
        self._ended = np.zeros(self.num_envs, dtype=bool)  # lanes that need a reset

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start episodes, see `TwoLinkArmVectorEnv.reset`; arrays are of all lanes."""
        options = {name: value for name, value in (options or {}).items() if value is not None}
        if not np.any(mask := options.get("reset_mask", True)):
            raise ValueError("reset_mask must have at least one True, got none")
        if self._seen is None and not np.all(mask):
            raise error.ResetNeeded(FIRST_RESET)
        if isinstance(seed, Sequence | np.ndarray):
            for each in seed:
                if each is not None:
                    check_seed(each)
        parts = {name: self._split(value, _AXES.get(name, 9), name) for name, value in options.items()}
        given = [{name: part[i] for name, part in parts.items()} for i in range(len(self.envs))]
        starts = [np.any(each.get("reset_mask", True)) for each in given]
        for env, each, begins in zip(self.envs, given, starts, strict=True):
            if begins:  # refuse before any episode ends
                env.unwrapped.starts_of(each)  # type: ignore[attr-defined]
        seeds, last = self._split(seed, 1, "seed"), self._split(self._seen, 2)
        arguments = zip(self.envs, seeds, given, starts, last, strict=True)
        results = [env.reset(seed=a, options=b) if begins else (seen, {}) for env, a, b, begins, seen in arguments]
        observations, infos = zip(*results, strict=True)
        self._seen, self._ended = np.concatenate(observations), self._ended & ~np.asarray(mask)
        return self._seen.copy(), self._joined(infos)

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Hold each lane's action, see `TwoLinkArmVectorEnv.step`."""
        actions = as_actions(actions, (self.num_envs, 2))
        if not np.isfinite(actions).all():  # before any arm moves
            raise ValueError(f"actions must be finite, got {actions[~np.isfinite(actions).all(axis=1)][0]}")
        if self._ended.any():  # likewise
            lane = self._ended.argmax()
            raise error.ResetNeeded(f"the episode of lane {lane} has ended: call reset(options={{'reset_mask': ...}})")
        results = [env.step(part) for env, part in zip(self.envs, self._split(actions, 2), strict=True)]
        *signals, infos = zip(*results, strict=True)
        self._seen, *others = map(np.concatenate, signals)
        if self.metadata["autoreset_mode"] == AutoresetMode.DISABLED:
            self._ended = others[1] | others[2]
        return self._seen.copy(), *others, self._joined(infos)

    def render(self) -> Any:
        """Return the frame of each lane."""
        return tuple(chain(*(env.render() or () for env in self.envs))) or None

    def close_extras(self, **_: Any) -> None:
        """Close the environments."""
        for env in self.envs:
            env.close()

    def _split(self, values: Any, axes: int, name: str = "") -> list[Any]:
        """Return the part of each environment, if the values have the axes of all lanes."""
        if np.ndim(values) != axes:
            return [values] * len(self.envs)
        if len(values) != self.num_envs:
            raise ValueError(f"{name} must have one entry for each of {self.num_envs} lanes, got {len(values)}")
        return [values[begin:end] for begin, end in zip([0, *self._cuts], [*self._cuts, None], strict=True)]

    def _joined(self, infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """Return the infos of all lanes, with zeros or None where an environment lacks a key."""
        joined: dict[str, Any] = {}
        for key in dict.fromkeys(chain(*infos)):
            value = next(info[key] for info in infos if key in info)
            if isinstance(value, dict):
                joined[key] = self._joined([info.get(key, {}) for info in infos])
                continue
            fill = None if value.dtype == object else 0
            joined[key] = np.concatenate([
                info[key] if key in info else np.full((env.num_envs, *value.shape[1:]), fill, value.dtype)
                for info, env in zip(infos, self.envs, strict=True)
            ])  # fmt: skip
        return joined


def side_by_side(kind: Any, num_envs: Any, scenarios: Sequence[Any], options: dict[str, Any]) -> SideBySideVectorEnv:
    """Return a class's batches of several scenarios as one, with the lanes in equal parts.

    All observe as many previous actions as the scenario that needs most.
    """
    check_whole("num_envs", num_envs, low=max(1, len(scenarios)))
    if not scenarios or options.get("device", "cpu") != "cpu":
        raise ValueError("scenario must be a list of one or more, and device 'cpu' with a list")
    layouts = [kind(1, scenario, **options).interface.layout for scenario in scenarios]
    most = max(len(range(*x["previous_actions"].indices(x.size))) if "previous_actions" in x else 0 for x in layouts)
    lanes = [len(part) for part in np.array_split(range(num_envs), len(scenarios))]
    options = options | {"past_actions": most // 2}
    return SideBySideVectorEnv(*(kind(n, scenario, **options) for n, scenario in zip(lanes, scenarios, strict=True)))
