"""Closed loop of a policy and a batch of arms in lockstep; every lane is one seed."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from benchmarks.policies.spec import PolicySpec, resolve
from fbl_gym.envs.env import TwoLinkArmEnv
from fbl_gym.envs.hand import course
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.model.arm import Array
from fbl_gym.options import SENSORS
from fbl_gym.scenarios import Scenario


@dataclass(frozen=True)
class Trace:
    """The signals of the real arm, sample by sample.

    T is the number of control steps and n the number of seeds. Sample 0 is the start.

    Args:
        scenario: the task.
        seeds: [n].
        time: [T + 1] s.
        position, velocity, reference: [T + 1 x n x 2] rad, rad/s, rad.
        command: torque command, within the torque limits [T + 1 x n x 2] N m.
        torque: applied torque, after delay, lag and gain [T + 1 x n x 2] N m.
        disturbance: [T + 1 x n x 2] N m.
        alive: [T + 1 x n]; False from the sample at which a lane diverged. From there, only
            `reference` is of this episode.
        decision_time: wall time of the policy for one decision of one lane [s], the median over the
            steps.
        payload: mass carried at the tip [T + 1 x n] kg.
        lengths: true link lengths of each seed's first episode [n x 2] m.
        event_times: of each seed's first episode [n x number of events] s.
        watched: the signals of `rollout`'s argument `watch`, by name; [T x n x ...], from sample 1
            on.
        details: with `detailed`, the readings of the sensors, the motion of the motors, and the
            arrays of the policy's state, by name [T + 1 x n x ...]. NaN in the first sample of the
            state: the others are those after the decision that led to the sample.
    """

    scenario: Scenario
    seeds: tuple[int, ...]
    time: Array
    position: Array
    velocity: Array
    reference: Array
    command: Array
    torque: Array
    disturbance: Array
    alive: NDArray[np.bool_]
    decision_time: float
    payload: Array = field(default_factory=lambda: np.empty((0, 0)))
    lengths: Array = field(default_factory=lambda: np.empty((0, 2)))
    event_times: Array = field(default_factory=lambda: np.empty((0, 0)))
    watched: dict[str, Array] = field(default_factory=dict)
    details: dict[str, Array] = field(default_factory=dict)


def make_env(policy: PolicySpec, scenario: Scenario, lanes: int | None, action: str | None = None) -> Any:
    """Return the environment of an evaluation, with the preview that the policy declares.

    It has lanes, or one arm where `lanes` is None.
    """
    preview = math.ceil(policy.preview / scenario.control_dt - 1e-9)
    options: Any = {"action": action or action_of(scenario), "preview": preview}
    return TwoLinkArmEnv(scenario, **options) if lanes is None else TwoLinkArmVectorEnv(lanes, scenario, **options)


#: A signal to record after each step: a function of the environment, the policy and its state.
Watch: TypeAlias = Callable[[TwoLinkArmVectorEnv, Any, Any], Array]

#: Most numbers of a lane in an array of a policy's state that is recorded.
LARGEST = 16


def action_of(scenario: Scenario) -> str:
    """Return the kind of action: "normalized" with a torque limit, "torque" without."""
    return "torque" if scenario.actuator.torque_limit is None else "normalized"


def rollout(
    policy: PolicySpec | str, scenario: Scenario, seeds: Sequence[int], gains: Mapping[str, Any] | None = None,
    watch: Mapping[str, Watch] | None = None, *, trust: bool = False,
) -> Trace:  # fmt: skip
    """Run one episode for each seed, a lane each, and return the trace.

    `gains` are arguments of the policy. `watch` has more signals to record after each step.
    `trust` allows the code of an archive to run.
    """
    return rollout_trials(resolve(policy, trust=trust), scenario, seeds, 1, gains, watch)[0]


def rollout_trials(
    policy: PolicySpec | str, scenario: Scenario, seeds: Sequence[int], trials: int,
    gains: Mapping[str, Any] | None = None, watch: Mapping[str, Watch] | None = None, detailed: bool = False,
) -> list[Trace]:  # fmt: skip
    """Run an arm and a motion for each seed several times in a row, and return each trial's trace.

    The policy's state goes on from trial to trial, with `episode_start` at the first step of each,
    as in stable-baselines3. A run that diverged takes part in the next trial again.
    With `detailed`, the traces have their `details`.
    """
    n, steps = len(seeds), scenario.steps
    spec = resolve(policy)
    if trials > 1:
        scenario = scenario.replace(drawn_per="seed")
    env = make_env(spec, scenario, n)
    actor = spec.make(env, **(gains or {}))
    state: Any = None
    traces = []
    for trial in range(trials):
        alive, waits = np.ones((steps + 1, n), dtype=bool), np.empty(steps)
        starts, ended = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
        observation, _ = env.reset(seed=list(seeds) if trial == 0 else None)
        samples, watched = [env.true_signals()], []
        details = [_details(env, observation, ())] if detailed else []
        lengths, event_times = np.array(env.truth.lengths), env.truth.event_times
        for k in range(steps):
            begin = time.perf_counter()
            action, state = actor.predict(observation, state=state, episode_start=starts, deterministic=True)
            waits[k] = time.perf_counter() - begin
            try:
                observation, _, terminated, truncated, _ = env.step(action)
            except ValueError as problem:
                raise ValueError(f"{spec.name} after {k * scenario.control_dt:.4g} s: {problem}") from None
            # A lane that diverged begins its next episode one step later; that episode is not used.
            starts, ended = ended, terminated | truncated
            alive[k + 1] = alive[k] & ~terminated
            samples.append(env.true_signals())
            if detailed:
                details.append(_details(env, observation, state))
            watched.append({name: signal(env, actor, state) for name, signal in (watch or {}).items()})
        signals = {name.removeprefix("applied_"): signal for name, signal in _stacked(samples).items()}
        # The statistics of a lane that diverged need the reference to the end of its episode, and
        # the lane's next episode has another one.
        if not alive.all():
            signals["reference"] = reference_motion(scenario, seeds)[0]
        traces.append(Trace(
            scenario=scenario, seeds=tuple(seeds), time=scenario.control_dt * np.arange(steps + 1.0), alive=alive,
            decision_time=float(np.median(waits)) / n, lengths=lengths, event_times=event_times,
            watched=_stacked(watched), details=_stacked(details), **signals,
        ))  # fmt: skip
    env.close()
    return traces


def _stacked(rows: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    """Return the signals of some samples as arrays, by name; NaN where one is absent."""
    return {
        name: np.array([row[name] if name in row else np.full_like(last, np.nan) for row in rows])
        for name, last in (rows[-1] if rows else {}).items()
    }


def reference_motion(scenario: Scenario, seeds: Sequence[int]) -> Array:
    """Return the reference of each seed over the whole episode [3 x T + 1 x n x 2].

    It has position, velocity and acceleration.
    """
    return course(scenario.replace(disturbance=None), seeds)[:3]


def _details(env: TwoLinkArmVectorEnv, observation: Array, state: Any) -> dict[str, Array]:
    """Return `Trace.details` of one sample."""
    truth, layout = env.truth, env.interface.layout
    readings = {f"measured_{name}": observation[:, layout[name]].copy() for name in SENSORS if name in layout}
    motors = {"motor_position": truth.motor_position, "motor_velocity": truth.motor_velocity}
    return readings | motors | dict(_named("state", state, env.num_envs))


def _named(name: str, state: Any, lanes: int) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of a policy's state with at most `LARGEST` numbers of each lane, by name."""
    if isinstance(state, tuple):
        for i, part in enumerate(state):
            yield from _named(f"{name}_{getattr(state, '_fields', range(len(state)))[i]}", part, lanes)
    elif isinstance(state, np.ndarray) and len(state) == lanes and state.size <= LARGEST * lanes:
        yield name, np.array(state, dtype=float)
