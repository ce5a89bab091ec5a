"""Check of identification: how often do the intervals hold the true numbers of drawn arms?

`python -m tests.identification_coverage 100` draws arms around `dfki-c1`, moves each by random
torques, identifies it from its log, and prints each arm when it is done. 90 % should hold.
"""

import argparse
import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.identification.fit import identify
from benchmarks.identification.logs import read
from benchmarks.identification.model import PARAMETERS, parameters_of
from fbl_gym import scenarios
from fbl_gym.envs.env import TwoLinkArmEnv
from fbl_gym.model.arm import Array
from fbl_gym.scenarios import Scenario

START = "dfki-c1"
NAMES = ("time_s", "position_1_rad", "position_2_rad", "torque_1_Nm", "torque_2_Nm")


def draw(generator: np.random.Generator) -> Scenario:
    """Return an arm with drawn masses, rotor, friction, gain of joint 1, delay and zeros."""
    start, pair = scenarios.get(START), (2,)
    mass, turns = generator.uniform(0.8, 1.25, pair), generator.uniform(0.5, 2.0)
    rotor = (start.arm.rotor[0], turns * start.arm.rotor[1])  # type: ignore[index]
    gain, delay = (generator.uniform(0.8, 1.1), 1.0), start.physics_dt * generator.integers(0, 29)
    return start.replace(
        arm=dataclasses.replace(start.arm, m1=mass[0] * start.arm.m1, m2=mass[1] * start.arm.m2, rotor=rotor),
        friction={"viscous": generator.uniform(0, 0.03, pair), "coulomb": generator.uniform(0.05, 0.25, pair)},
        actuator={"torque_limit": 10.0, "gain": gain, "delay": delay},
        noise={"position": {"bias": generator.uniform(-0.05, 0.05, pair), "sigma": generator.uniform(0.0, 0.001)}},
        encoder={"counts": 16384},
        sensors=("position",), limits={"velocity": 100.0, "position": 100.0}, duration=10.0,
    )  # fmt: skip


def move(robot: Scenario, generator: np.random.Generator, size: Sequence[float] = (0.45, 0.3)) -> Array:
    """Return time, measured positions and commands of a robot under two sines a joint [n x 5]."""
    rate, phase = generator.uniform(2.0, 12.0, (2, 2)), generator.uniform(0.0, 2 * np.pi, (2, 2))
    time = np.arange(robot.steps) * robot.control_dt
    torque = (size * np.sin(rate * time[:, None, None] + phase)).sum(axis=1)
    env = TwoLinkArmEnv(robot, action="torque")
    first = env.reset(seed=int(generator.integers(2**31)))[0]
    rows = [first, *(env.step(action)[0] for action in torque.astype(np.float32)[:-1])]
    return np.column_stack([time, np.array(rows)[:, :2], torque])


def write(path: Path, rows: Array, names: Sequence[str] = NAMES) -> Path:
    """Write a log to a file, and return its path."""
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="")
    return path


def main(argv: Sequence[str] | None = None) -> None:
    """Print the arms, then the share of intervals that hold, by number."""
    parser = argparse.ArgumentParser(prog="python -m tests.identification_coverage", description=__doc__)
    parser.add_argument("arms", type=int, metavar="N", help="number of arms")
    holds = np.full((parser.parse_args(argv).arms, len(PARAMETERS)), np.nan)
    for k in range(len(holds)):
        generator = np.random.default_rng(k)
        robot = draw(generator)
        with tempfile.TemporaryDirectory() as folder:
            log = read(write(Path(folder) / "log.csv", move(robot, generator)))
        fit, true = identify([log], scenarios.get(START)), parameters_of(robot)
        low, high = fit.interval.T
        holds[k] = np.where([name in fit.free for name in PARAMETERS], (low <= true) & (true <= high), np.nan)
        missed = [name for name, held in zip(PARAMETERS, holds[k], strict=True) if held == 0]
        print(f"arm {k}: {np.nanmean(holds[k]):4.0%} of {np.isfinite(holds[k]).sum()}; missed: {missed}", flush=True)
    for name, column in [*zip(PARAMETERS, holds.T, strict=True), ("all", holds)]:
        if np.isfinite(column).any():
            print(f"{name:10} {np.nanmean(column):4.0%} of {np.isfinite(column).sum()}")


if __name__ == "__main__":
    main()
