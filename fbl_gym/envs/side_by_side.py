"""Batches of several scenarios, side by side as one vector environment."""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from fbl_gym.envs.env_common import as_actions
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
        self.envs, self.metadata = envs, dict(envs[0].metadata)
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

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start episodes, see `TwoLinkArmVectorEnv.reset`; arrays are of all lanes."""
        parts = {name: self._split(value, _AXES.get(name, 9)) for name, value in (options or {}).items()}
        given = [{name: part[i] for name, part in parts.items()} for i in range(len(self.envs))]
        starts = [self._seen is None or np.any(each.get("reset_mask", True)) for each in given]
        arguments = zip(self.envs, self._split(seed, 1), given, starts, self._split(self._seen, 2), strict=True)
        results = [env.reset(seed=a, options=b) if begins else (seen, {}) for env, a, b, begins, seen in arguments]
        observations, infos = zip(*results, strict=True)
        self._seen = np.concatenate(observations)
        return self._seen, self._joined(infos)

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Hold each lane's action, see `TwoLinkArmVectorEnv.step`."""
        actions = as_actions(actions, (self.num_envs, 2))
        if not np.isfinite(actions).all():  # before any arm moves
            raise ValueError(f"actions must be finite, got {actions[~np.isfinite(actions).all(axis=1)][0]}")
        results = [env.step(part) for env, part in zip(self.envs, self._split(actions, 2), strict=True)]
        *signals, infos = zip(*results, strict=True)
        self._seen, *others = map(np.concatenate, signals)
        return self._seen, *others, self._joined(infos)

    def render(self) -> Any:
        """Return the frame of each lane."""
        return tuple(chain(*(env.render() or () for env in self.envs))) or None

    def close_extras(self, **_: Any) -> None:
        """Close the environments."""
        for env in self.envs:
            env.close()

    def _split(self, values: Any, axes: int) -> list[Any]:
        """Return the part of each environment, if the values have the axes of all lanes."""
        if np.ndim(values) != axes:
            return [values] * len(self.envs)
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
