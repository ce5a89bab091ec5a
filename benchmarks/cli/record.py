"""The command `fbl-gym record`: a data set for offline learning."""

import argparse
import re
from pathlib import Path

import numpy as np

from benchmarks.cli.common import add_policy, add_scenario, add_trust, command_line, count, refuse_judged, trust
from benchmarks.policies.spec import resolve
from benchmarks.rl.training_settings import LANES
from benchmarks.run.episodes import ENVIRONMENTS, lacks_minari, record, write
from benchmarks.seeds import SPLITS
from fbl_gym import __version__, scenarios


def episodes(text: str) -> int:
    """Return a number of episodes that one `--seed` has seeds for."""
    if (number := count(text)) > LANES:
        raise argparse.ArgumentTypeError(f"must be at most {LANES}, the seeds of one --seed, got {text!r}")
    return number


def folder(text: str) -> Path:
    """Return a new folder, named as Minari names data sets."""
    path = Path(text)
    if not re.fullmatch(r"\w[\w-]*-v\d+", path.name, flags=re.ASCII):
        raise argparse.ArgumentTypeError(f"must end in a name and a version, such as data/expert-v0, got {text!r}")
    if path.exists():
        raise argparse.ArgumentTypeError(f"must be a new folder, got {text!r}, which exists; give another version")
    return path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policy(parser)
    add_scenario(parser)
    parser.add_argument("--episodes", type=episodes, default=100, metavar="N", help="number of episodes (100)")
    parser.add_argument("--seed", type=int, default=0, metavar="K", help=f"training seeds, {LANES} for each K (0)")
    parser.add_argument(
        "--noise", type=float, default=0.0, metavar="S",
        help="standard deviation of noise on the actions, as a share of their bound (0)",
    )  # fmt: skip
    parser.add_argument(
        "--observation", choices=tuple(ENVIRONMENTS), default="tracking",
        help="the environment whose observations are recorded (tracking)",
    )  # fmt: skip
    parser.add_argument("--out", type=folder, required=True, metavar="DIR", help="new folder, such as data/expert-v0")
    add_trust(parser)


def run(arguments: argparse.Namespace) -> int:
    trust(arguments)
    scenario = scenarios.get(arguments.scenario)
    refuse_judged(scenario)
    first = arguments.seed * LANES
    seeds = SPLITS["training"][first : first + arguments.episodes]
    if arguments.seed < 0 or len(seeds) < arguments.episodes:
        raise ValueError(f"seed must be 0 to {len(SPLITS['training']) // LANES - 1}, got {arguments.seed}")
    if not arguments.noise >= 0:
        raise ValueError(f"noise must not be negative, got {arguments.noise}")
    policy = resolve(arguments.policy)
    data = record(policy, scenario, seeds, arguments.noise, arguments.observation)
    error = data.truth["reference"] - data.truth["position"]
    description = {
        "command": command_line(), "fbl-gym": __version__, "policy": policy.name, "access": policy.access,
        "noise": arguments.noise, "episodes": len(seeds), "steps": int(data.ends[-1]),
        "terminated": int(data.steps["terminations"].sum()),
        "mean_return": float(data.steps["rewards"].sum() / len(seeds)),
        "rms_mrad": float(np.mean([1e3 * np.sqrt(np.mean(each**2)) for each in np.split(error, data.ends[:-1])])),
    }  # fmt: skip
    write(data, arguments.out, description)
    print(
        f"{len(seeds)} episodes, {description['terminated']} terminated, mean return "
        f"{description['mean_return']:.1f}, error {description['rms_mrad']:.3g} mrad"
    )
    if lacks_minari():
        print("no Minari files, since Minari is not installed: pip install 'fbl-gym[data]'")
    print(f"data set: {arguments.out}")
    return 0
