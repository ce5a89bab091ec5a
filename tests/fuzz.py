"""Fuzz options and files until a time is over: `python -m tests.fuzz --minutes 10 --seed 0`.

Each case works, or a ValueError that names an argument refuses it. Anything else is printed and makes the program fail:
another error, a warning, an observation outside its space.
"""

import argparse
import io
import random
import re
import tempfile
import time
import traceback
import warnings
from collections import Counter
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from benchmarks.agents.policy import SHIPPED
from benchmarks.policies.spec import resolve
from benchmarks.run.suite import load
from controllers.name import PolicyName
from fbl_gym import TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.urdf import read_robot
from fbl_gym.records.record import merged
from tests.fbl_gym.declared import FIELDS, LEAVES
from tests.fbl_gym.test_urdf import chain

NAMES = {name for field in FIELDS for name in field.stream.split(".")} | {"seeds", "policy", "urdf", "toml", "json"}
WILD = [0, -1, 1, 0.5, 1e-300, 1e200, -1e200, 5e-324, 10**400, float("nan"), float("inf"), True, None, "", "\x1b[2J\0", "1",
        b"1", [], {}, (1, 2), [1e200, 1e-200], [[1, 2]], {"uniform": [1e-9, 1e9]}, {"choice": []}, object()]  # fmt: skip
TASK = 'base = "noise-2"\nduration = 0.2\n[arm]\nm1 = 3.0\n[friction]\nviscous = 1.0\n'
FILES = {
    "arm.urdf": (chain(), read_robot),
    "task.toml": (TASK, lambda path: TwoLinkArmVectorEnv(1, scenarios.get(path))),
    "suite.toml": ('policies = ["zero"]\nscenarios = ["noise-1"]\nseeds = 2\n', lambda path: load(path).build()),
    "gains.json": ('{"gains": {"frequency": 9.0}}', lambda path: PolicyName.parse(f"pd-gravity@{path}").given_gains),
    "agent.json": ((SHIPPED / "td3/0/agent.json").read_text(), lambda path: resolve(f"{Path(path).parent}/")),
}  # fmt: skip


def wild_options(rng):
    """Three options of which some are wild, and twelve steps."""
    options = {}
    for field in rng.choices(LEAVES, k=3):
        number = rng.choice([-1, 1, 1]) * 10 ** rng.uniform(-320, 308)
        options = merged(options, field.given(rng.choice([*field.values, number, rng.choice(WILD)])))

    def run():
        env = TwoLinkArmVectorEnv(2, **options)
        for size in (None, *np.logspace(-6, 6, 12)):
            observation = (env.reset(seed=0) if size is None else env.step(np.full((2, 2), size)))[0]
            assert observation in env.observation_space, observation

    return options, run


def damaged_files(rng):
    """A file with a wild number, or with other bytes in place of some."""
    name, (text, read) = rng.choice([*FILES.items()])
    number, start = rng.choice([*re.finditer(r"-?\d+(\.\d+)?", text)]), rng.randrange(len(text))
    wild = f"{text[: number.start()]}{rng.choice(WILD)}{text[number.end() :]}".encode()
    torn = text[:start].encode() + rng.randbytes(rng.randrange(4)) + text[start + rng.randrange(9) :].encode()
    Path(name).write_bytes(data := rng.choice([wild, torn]))
    return (name, data), lambda: read(str(Path(name).resolve()))


def outcome_of(run):
    """Return "works", "refused", or "FAILED" with the traceback."""
    try:
        with redirect_stdout(io.StringIO()) as text, redirect_stderr(text), warnings.catch_warnings(action="error"):
            run()
    except Exception as problem:
        named = isinstance(problem, ValueError) and NAMES & {*re.findall(r"\w+", str(problem))}
        return "refused" if named else f"FAILED\n{traceback.format_exc()}"
    return "works"


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    given, counts = parser.parse_args(), Counter()
    rng, end = random.Random(given.seed), time.monotonic() + 60 * given.minutes
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        while time.monotonic() < end:
            kind = rng.choice([wild_options, wild_options, damaged_files])
            case, run = kind(rng)
            outcome, _, details = outcome_of(run).partition("\n")
            counts[f"{kind.__name__} {outcome}"] += 1
            if details:
                print(f"{kind.__name__} {case!r:.2000}\n{details}", flush=True)
    print(*(f"{count:>7,} {name}" for name, count in sorted(counts.items())), sep="\n")
    return any("FAILED" in name for name in counts)


if __name__ == "__main__":
    raise SystemExit(main())
