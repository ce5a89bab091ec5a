"""The command `fbl-gym record`: a data set for offline learning."""

import argparse
import re
from pathlib import Path

import numpy as np

from benchmarks.cli import common
from benchmarks.policies.spec import resolve
from benchmarks.text import say
from benchmarks.training.training_settings import SEEDS_PER_RUN, training_seeds
from fbl_gym import scenarios


def folder(text: str) -> Path:
    """Return a new folder, named as Minari names data sets."""
    path = Path(text)
    if not re.fullmatch(r"\w[\w-]*-v\d+", path.name, flags=re.ASCII):
        raise argparse.ArgumentTypeError(f"must end in a name and a version, such as data/expert-v0, got {text!r}")
    if path.exists():
        raise argparse.ArgumentTypeError(f"must be a new folder, got {text!r}, which exists; give another version")
    return path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    common.add(parser, "policy", "--scenario")
    common.add_option(parser, "--episodes", common.count, 100, "N", "number of episodes")
    common.add_option(parser, "--seed", int, 0, "K", f"training seed, with {SEEDS_PER_RUN} episode seeds")
    meaning = "standard deviation of noise on the actions, as a share of their bound"
    common.add_option(parser, "--noise", float, 0.0, "S", meaning)
    recorded = "the environment whose observations are recorded (tracking)"
    parser.add_argument("--observation", choices=("tracking", "raw"), default="tracking", help=recorded)
    parser.add_argument("--out", type=folder, required=True, metavar="DIR", help="new folder, such as data/expert-v0")
    common.add(parser, "--trust")


def run(arguments: argparse.Namespace) -> int:
    from benchmarks.run.episodes import record, write  # the extra `data`

    common.trust(arguments)
    scenario = scenarios.get(arguments.scenario)
    common.refuse_judged(scenario)
    seeds = training_seeds(arguments.seed)[: arguments.episodes]
    if arguments.episodes > SEEDS_PER_RUN:
        raise ValueError(f"episodes must be at most {SEEDS_PER_RUN}, the seeds of one --seed, got {arguments.episodes}")
    if not arguments.noise >= 0:
        raise ValueError(f"noise must not be negative, got {arguments.noise}")
    policy = resolve(arguments.policy)
    episodes = policy.call(record, policy, scenario, seeds, arguments.noise, arguments.observation)
    about = {"algorithm_name": policy.name, "description": common.command_line()}
    write(episodes, arguments.out, scenario, arguments.observation, **about)
    errors = [episode["infos"]["reference"] - episode["infos"]["position"] for episode in episodes]
    terminated = sum(bool(episode["terminations"][-1]) for episode in episodes)
    say(
        f"{len(seeds)} episodes, {terminated} terminated, mean return "
        f"{np.mean([sum(episode['rewards']) for episode in episodes]):.1f}, "
        f"error {1e3 * np.mean([np.sqrt(np.mean(error[:-1] ** 2)) for error in errors]):.3g} mrad\n"
        f"data set: {arguments.out}"
    )
    return 0
