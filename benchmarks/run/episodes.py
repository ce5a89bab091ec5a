"""Recorded episodes of a policy: a data set for offline learning, as NumPy and Minari files."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.rollout import action_of, make_env
from fbl_gym import __version__
from fbl_gym.arm import Array
from fbl_gym.scenarios import Scenario

ENVIRONMENTS = {"tracking": "fbl_gym/TwoLinkArmTracking-v0", "raw": "fbl_gym/TwoLinkArm-v0"}
"""The environment of each kind of observation."""


@dataclass(frozen=True)
class Episodes:
    """Episodes of a policy, one after the other.

    N is the number of steps of all episodes together. Row k of each array is of step k.

    Args:
        scenario: the task.
        observed: one of `ENVIRONMENTS`.
        seeds: of the environment, one for each episode.
        ends: number of steps up to the end of each episode.
        steps: observations and next_observations [N x size], actions [N x 2], rewards,
            terminations and truncations [N], by name.
        truth: the fields of `fbl_gym.batch.Truth` at the start of each step [N x ...], by name.
    """

    scenario: Scenario
    observed: str
    seeds: tuple[int, ...]
    ends: Array
    steps: dict[str, Array]
    truth: dict[str, Array]

    @property
    def env_options(self) -> dict[str, Any]:
        """Return the options of `gym.make` for the environment of the observations."""
        return {"scenario": self.scenario.to_dict(), "action": action_of(self.scenario)}


def record(
    policy: PolicySpec | str, scenario: Scenario, seeds: Sequence[int], noise: float = 0.0, observed: str = "tracking"
) -> Episodes:
    """Run one episode of a policy for each seed and return what a learner sees of them.

    Args:
        policy: to be recorded.
        scenario: the task.
        seeds: of the episodes.
        noise: standard deviation of white Gaussian noise on the actions, as a share of their bound.
        observed: one of `ENVIRONMENTS`, whose observations and rewards are recorded. The policy
            observes its own environment.
    """
    n, spec = len(seeds), resolve(policy)
    env = make_env(spec, scenario, n)
    # The same arms with another observation: equal seeds and actions make equal motions.
    options: Any = {"scenario": scenario, "action": action_of(scenario), "vectorization_mode": "vector_entry_point"}
    learner: Any = gym.make_vec(ENVIRONMENTS[observed], n, **options)
    actor, state = spec.make(env), None
    bound = env.action_space.high
    draws = np.stack([np.random.default_rng(seed).standard_normal((scenario.steps, 2)) for seed in seeds], axis=1)
    observation, _ = env.reset(seed=list(seeds))
    seen, _ = learner.reset(seed=list(seeds))
    starts, running, ended = np.ones(n, dtype=bool), np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    masks, rows, truths = [], [], []
    for draw in draws:
        action, state = actor.predict(observation, state=state, episode_start=starts, deterministic=True)
        action = np.clip(action + noise * bound * draw, -bound, bound).astype(np.float32)
        truths.append(vars(env.truth))
        observation, *_ = env.step(action)
        following, rewards, terminated, truncated, _ = learner.step(action)
        row = {"observations": seen, "actions": action, "rewards": rewards, "next_observations": following}
        rows.append({**row, "terminations": terminated, "truncations": truncated})
        masks.append(running)
        seen, starts, ended = following, ended, terminated | truncated
        running = running & ~ended  # the next episode of a lane that ended is not recorded
    mask = np.array(masks).T
    env.close()
    learner.close()

    def joined(each: list[dict[str, Array]]) -> dict[str, Array]:
        """Return each array with the steps of the first lane, then of the second, and so on."""
        return {name: np.array([row[name] for row in each]).swapaxes(0, 1)[mask] for name in each[0]}

    return Episodes(scenario, observed, tuple(seeds), np.cumsum(mask.sum(axis=1)), joined(rows), joined(truths))


def lacks_minari() -> bool:
    """Return True unless Minari and its file format are installed."""
    return any(find_spec(module) is None for module in ("minari", "h5py"))


def write(episodes: Episodes, folder: Path, description: Mapping[str, Any]) -> None:
    """Write a data set to a new folder, which is complete or absent.

    Args:
        episodes: to be written.
        folder: named as Minari names data sets, such as "expert-v0".
        description: plain data about the origin of the episodes.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".", dir=folder.parent.resolve()) as beside:
        new = Path(beside, folder.name)
        new.mkdir()
        np.savez_compressed(
            new / "episodes.npz",
            seeds=episodes.seeds,
            episode_ends=episodes.ends,
            **episodes.steps,  # type: ignore[arg-type]
        )
        np.savez_compressed(new / "truth.npz", **episodes.truth)  # type: ignore[arg-type]
        if not lacks_minari():
            _write_minari(episodes, new, description)
        text = {**description, "environment": ENVIRONMENTS[episodes.observed], "options": episodes.env_options}
        (new / "description.json").write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")
        new.rename(folder)


def _write_minari(episodes: Episodes, folder: Path, description: Mapping[str, Any]) -> None:
    """Write Minari's files: the folder `data`, without the truth."""
    import minari
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    arrays = {name: episodes.steps[name] for name in ("actions", "rewards", "terminations", "truncations")}
    buffers = []
    for seed, first, end in zip(episodes.seeds, [0, *episodes.ends[:-1]], episodes.ends, strict=True):
        last = episodes.steps["next_observations"][end - 1 : end]
        observations = np.concatenate([episodes.steps["observations"][first:end], last])
        parts = {name: array[first:end] for name, array in arrays.items()}
        buffers.append(EpisodeBuffer(seed=seed, observations=observations, **parts))
    env = gym.make(ENVIRONMENTS[episodes.observed], **episodes.env_options)
    (folder / "data").mkdir()
    storage = MinariStorage.new(folder / "data", env.observation_space, env.action_space, env.spec)
    about = {"algorithm_name": description["policy"], "description": description["command"]}
    requirements = [f"fbl-gym=={__version__}"]
    storage.update_metadata(
        {"dataset_id": folder.name, "minari_version": minari.__version__, "requirements": requirements, **about}
    )
    storage.update_episodes(buffers)
