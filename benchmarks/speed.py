"""`python -m benchmarks.speed`: steps per second of environments, and times of decisions.

Machines drift, so contestants take turns in the rounds of one run, and results are ratios of
medians over the rounds. Environments have one thread if not stated otherwise. One step of the arm
takes ten Runge-Kutta steps of 1 ms: forty evaluations of its dynamics.
"""

import argparse
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np

from benchmarks.policies.spec import resolve
from benchmarks.run.suite import load
from controllers import Runner
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.kernel.cuda import TorchGpu, open_gpu
from fbl_gym.kernel.step.pool import cores
from fbl_gym.model.arm import Array

#: A function that takes one step, and returns the number of environments that it stepped.
Contestant: TypeAlias = Callable[[], int]

#: Duration of a contestant's turn in each round [s].
ROUND_S = 0.1

BUSY: dict[str, Any] = {
    "friction": {"coulomb": 10.0, "stiction": 10.0},
    "noise": {"position": 1e-3, "velocity": 1e-2, "acceleration": 1e-1},
    "disturbance": {"kind": "piecewise-constant", "amplitude": 10.0},
}

_ARM = "fbl_gym:fbl_gym/TwoLinkArm-v0"
_ACROBOT, _ACROBOTS = "Acrobot-v1", "SyncVectorEnv(Acrobot-v1), 256"


def _contestants() -> dict[str, tuple[Contestant, str]]:
    """Return each contestant and the name of its peer, by name."""
    single = {
        "TwoLinkArm-v0": gym.make(_ARM),
        "TwoLinkArm-v0, busy": gym.make(_ARM, **BUSY),
        "TwoLinkArmTracking-v0": gym.make(_ARM.replace("Arm-", "ArmTracking-")),
        "TwoLinkArm-v0, unwrapped": gym.make(_ARM).unwrapped,
    }
    contestants = {_ACROBOT: (contestant(gym.make(_ACROBOT), 1), "")}
    contestants |= {name: (contestant(env, np.zeros(2)), _ACROBOT) for name, env in single.items()}
    contestants[_ACROBOTS] = contestant(gym.make_vec(_ACROBOT, 256, "sync"), np.ones(256, dtype=int)), ""
    kinds: dict[str, Any] = {"": {}, ", busy": BUSY, ", servo-elastic-2": {"scenario": "servo-elastic-2"}}
    sizes = (16, 1), (256, 1), (4096, 1), (4096, cores())
    for (lanes, threads), (kind, options) in itertools.product(sizes, kinds.items()):
        env = gym.make_vec(_ARM, lanes, vectorization_mode="vector_entry_point", threads=threads, **options)
        name = f"TwoLinkArm-v0 batch, {lanes}{kind}{f', {threads} threads' if threads > 1 else ''}"
        contestants[name] = contestant(env, np.zeros((lanes, 2))), _ACROBOTS
    return contestants


def contestant(env: Any, action: Any) -> Contestant:
    """Return a contestant: an environment, or a batch, with the same action at every step.

    A single environment is reset at an episode's end.
    """
    env.reset(seed=0)
    lanes = getattr(env, "num_envs", 1)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(action)
        if lanes == 1 and (terminated or truncated):
            env.reset()
        return lanes

    return step


def measure_rates(contestants: Mapping[Any, Contestant], rounds: int) -> dict[Any, Array]:
    """Return the steps per second of each contestant in each round, after one step to warm up."""
    for step in contestants.values():
        step()
    rates = {name: np.empty(rounds) for name in contestants}
    for k, (name, step) in itertools.product(range(rounds), contestants.items()):
        count, begin = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - begin) < ROUND_S:
            for _ in range(10 if elapsed < 0.5 * ROUND_S else 1):
                count += step()
        rates[name][k] = count / elapsed
    return rates


def measure_environments(rounds: int = 7) -> list[dict[str, Any]]:
    """Return the speed of every contestant in environment steps per second.

    Each row has the contestant's name, the median of the rounds, the name of its peer, if there is
    one, and the median ratio to it.
    """
    contestants = _contestants()
    rates = measure_rates({name: step for name, (step, _) in contestants.items()}, rounds)
    ratios = {name: rates[name] / rates[peer or name] for name, (_, peer) in contestants.items()}
    return [
        {"name": name, "median": float(np.median(rates[name])), "ratio": float(np.median(ratios[name])), "peer": peer}
        for name, (_, peer) in contestants.items()
    ]


def measure_gpu(rounds: int = 7) -> Iterator[tuple[str, int, float]]:
    """Yield a name, its number of lanes, and the most steps per second of batches on a GPU.

    A CUDA graph of torch draws the actions and makes the steps.

    Raises:
        ImportError: without the extra `cuda`, or a torch with CUDA.
        RuntimeError: without a GPU.
    """
    if not isinstance(open_gpu(), TorchGpu):
        raise ImportError("--device cuda needs a torch with CUDA: pip install torch")
    import torch

    names = {name: {"scenario": name} for name in ("servo-everything-2", "servo-elastic-2")}
    kinds: dict[str, Any] = {"plain": {}, "busy": BUSY, **names, "links that bend": {"link": 8.0}}
    for name, lanes in itertools.product(kinds, (4_096, 65_536, 1_048_576)):
        env = TwoLinkArmVectorEnv(lanes, device="cuda", **kinds[name])
        env.reset(seed=0)
        actions = torch.empty(lanes, 2, dtype=torch.float64, device="cuda")
        env.step(actions.uniform_(-1, 1))
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            env.step(actions.uniform_(-1, 1))

        def step(graph: Any = graph, lanes: int = lanes) -> int:
            for _ in range(20):
                graph.replay()
            torch.cuda.synchronize()
            return 20 * lanes

        yield name, lanes, float(measure_rates({name: step}, rounds)[name].max())
        env.check()


#: Of the single arm, and of a batch at 1 kHz with its number of arms.
SCENARIO, BATCH, ARMS = "servo-delay-2", "geared-delay-2", 32

#: First decisions, which do not count.
WARM_UP = 50

#: Decisions of a policy before those of the next one.
TURN = 300


def decisions(policy: str) -> Iterator[float]:
    """Yield the time of each decision [s], without end; the robot is an arm of `SCENARIO`."""
    scenario = scenarios.get(SCENARIO)
    runner = Runner(policy, scenario, max_error=1e3)
    env = TwoLinkArmEnv(scenario, action="torque", preview=runner.rows - 1)
    for seed in range(2**63):
        observation, _ = env.reset(seed=seed)
        runner.reset()
        ended, k = False, 0
        while not (ended or runner.stopped):
            reading, reference = observation[env.layout["position"]], observation[env.layout.reference]
            begin = time.perf_counter()
            torque = runner.step(reading, reference, time=k * scenario.control_dt)
            yield time.perf_counter() - begin
            observation, _, terminated, truncated, _ = env.step(torque)
            ended, k = terminated or truncated, k + 1


def batch_decisions(policy: str) -> Iterator[float]:
    """Yield the time of each decision for `ARMS` arms of `BATCH` [s], without end.

    An agent that cannot drive these gets arms of `SCENARIO`.
    """
    env, state, spec = TwoLinkArmVectorEnv(ARMS, BATCH), None, resolve(policy)
    try:
        law = spec.make(env)
    except ValueError:
        env = TwoLinkArmVectorEnv(ARMS, SCENARIO)
        law = spec.make(env)
    observation, _ = env.reset(seed=0)
    while True:
        begin = time.perf_counter()
        action, state = law.predict(observation, state)
        yield time.perf_counter() - begin
        observation = env.step(action)[0]


def measure_decisions(policies: Sequence[str], rounds: int = 7) -> list[tuple[str, float, float]]:
    """Return each policy with its median times [microseconds]: of one arm, of a batch; in turns."""
    loops = {(policy, measure): measure(policy) for policy in policies for measure in (decisions, batch_decisions)}
    waits: dict[Any, list[float]] = {key: [*itertools.islice(loop, WARM_UP, WARM_UP)] for key, loop in loops.items()}
    for _ in range(rounds):
        for key, loop in loops.items():
            waits[key].extend(itertools.islice(loop, TURN))
    medians = {key: 1e6 * float(np.median(times)) for key, times in waits.items()}
    return [(name, medians[name, decisions], medians[name, batch_decisions]) for name in dict.fromkeys(policies)]


LEGEND = """
x peer: to Acrobot-v1 through gym.make for a single environment, to SyncVectorEnv of 256 for a batch.
busy: stick-slip friction, noise on every sensor and a disturbance. One step is ten Runge-Kutta steps of 1 ms."""


def main() -> None:
    """Measure and print the speed of the environments."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, metavar="N", help="number of rounds (7)")
    parser.add_argument(
        "--decisions", nargs="*", metavar="POLICY",
        help="instead, measure a decision by these policies, or by all that the board ranks: of one arm, and of 32 at 1 kHz",
    )  # fmt: skip
    parser.add_argument("--device", choices=["cuda"], help="instead, measure batches on an NVIDIA GPU, with torch")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error(f"argument --rounds: must be at least 1, got {arguments.rounds}")
    if arguments.device is not None:
        try:
            for name, lanes, rate in measure_gpu(arguments.rounds):
                print(f"{name:<20} {lanes:>9,} lanes {rate / 1e6:>8,.0f} million steps/s", flush=True)
        except (ImportError, RuntimeError) as problem:
            parser.exit(1, f"{problem}\n")
        return
    if arguments.decisions is not None:
        ranked = [name for name in map(str, load("servo").policies) if resolve(name).ranked]
        print(f"{'decision, median microseconds':<42} {'one arm':>8} {'32 arms':>8}")
        for name, one, batch in measure_decisions(arguments.decisions or ranked, arguments.rounds):
            print(f"{name:<42} {one:>8.0f} {batch:>8.0f}")
        return
    rows = measure_environments(arguments.rounds)
    print(f"{'environment steps per second':<42} {'median':>12} {'x peer':>8}")
    for row in rows:
        ratio = f"{row['ratio']:.3g}" if row["peer"] else ""
        print(f"{row['name']:<42} {row['median']:>12,.0f} {ratio:>8}")
    print(f"{LEGEND}\nThis process may use {cores()} cores; rows without a number of threads have one.")


if __name__ == "__main__":
    main()
