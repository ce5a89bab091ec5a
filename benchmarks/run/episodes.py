"""Recorded episodes of a policy: a data set of Minari for offline learning."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import minari
import numpy as np
from minari.data_collector.episode_buffer import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.rollout import action_of, make_env
from fbl_gym import __version__
from fbl_gym.scenarios import Scenario

ENVIRONMENTS = {"tracking": "fbl_gym/TwoLinkArmTracking-v0", "raw": "fbl_gym/TwoLinkArm-v0"}
"""The environment of each kind of observation."""


def record(
    policy: PolicySpec | str, scenario: Scenario, seeds: Sequence[int], noise: float = 0.0, observed: str = "tracking"
) -> list[dict[str, Any]]:
    """Run one episode of a policy for each seed and return what a learner sees of them.

    An episode has the fields of Minari's `EpisodeBuffer`. All episodes run at once, unlike those of
    Minari's `DataCollector`. The `infos` of an episode of k steps have the fields of
    `fbl_gym.kernel.batch.Truth` [k + 1 x ...], which no policy may know.

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
    learner: Any = gym.make_vec(
        ENVIRONMENTS[observed], n, "vector_entry_point", scenario=scenario, action=action_of(scenario)
    )
    actor, state = spec.make(env), None
    bound = env.action_space.high
    draws = np.stack([np.random.default_rng(seed).standard_normal((scenario.steps, 2)) for seed in seeds], axis=1)
    observation, _ = env.reset(seed=list(seeds))
    observations, truths, steps = [learner.reset(seed=list(seeds))[0]], [vars(env.truth)], []
    starts = np.ones(n, dtype=bool)
    for draw in draws:
        action, state = actor.predict(observation, state=state, episode_start=starts, deterministic=True)
        action = np.clip(action + noise * bound * draw, -bound, bound).astype(np.float32)
        observation, *_ = env.step(action)
        following, rewards, terminated, truncated, _ = learner.step(action)
        observations.append(following)
        truths.append(vars(env.truth))
        steps.append((action, rewards, terminated, truncated))
        starts = terminated | truncated
    env.close()
    learner.close()
    seen, infos = np.array(observations), {name: np.array([truth[name] for truth in truths]) for name in truths[0]}
    actions, rewards, terminations, truncations = map(np.array, zip(*steps, strict=True))
    ends = 1 + np.argmax(terminations | truncations, axis=0)  # a lane's next episode is not recorded
    return [
        {
            "seed": seed,
            "observations": seen[: end + 1, lane],
            "actions": actions[:end, lane],
            "rewards": rewards[:end, lane],
            "terminations": terminations[:end, lane],
            "truncations": truncations[:end, lane],
            "infos": {name: values[: end + 1, lane] for name, values in infos.items()},
        }
        for lane, (seed, end) in enumerate(zip(seeds, ends, strict=True))
    ]


def write(episodes: Sequence[dict[str, Any]], folder: Path, scenario: Scenario, observed: str, **about: str) -> None:
    """Write a data set to a new folder, which is complete or absent.

    Args:
        episodes: to be written, of `record`.
        folder: named as Minari names data sets, such as "expert-v0".
        scenario: as in `record`.
        observed: as in `record`.
        **about: metadata of Minari, such as `algorithm_name` and `description`.
    """
    env = gym.make(ENVIRONMENTS[observed], scenario=scenario.to_dict(), action=action_of(scenario))
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=folder.parent.resolve()) as beside:
        data = Path(beside) / folder.name / "data"
        data.mkdir(parents=True)
        storage = MinariStorage.new(data, env.observation_space, env.action_space, env.spec)
        versions = {"minari_version": minari.__version__, "requirements": [f"fbl-gym=={__version__}"]}
        storage.update_metadata({"dataset_id": folder.name, **versions, **about})
        storage.update_episodes([EpisodeBuffer(**episode) for episode in episodes])
        data.parent.rename(folder)
