"""What a policy promises, checked on any policy: `fbl-gym check-policy`."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.policies import resolve
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.arm import Array

LANES, STEPS = 5, 30

LAST_BITS = 1e-4
"""So much may actions of a batch and of one arm differ, as fractions of the limits: a network in single precision rounds by the
size of its matrices."""


@dataclass(frozen=True)
class Check:
    """A promise, and whether it is kept.

    Args:
        promise: in words.
        kept: whether.
        detail: what was seen.
    """

    promise: str
    kept: bool
    detail: str


class Broken(AssertionError):
    """A promise that is not kept."""


def check(policy: str) -> Iterator[Check]:
    """Each promise in turn.  policy: a name, or what else `resolve.make` understands."""
    promises: tuple[tuple[str, Callable[[str], str]], ...] = (
        ("is made from the interface alone", _made_from_the_interface),
        ("actions have the observations' shape, are finite and lie in the box", _shapes),
        ("a lane of a batch acts as a single policy", _lanes),
        ("episode_start begins just those lanes afresh", _resets),
        ("predict is a function of its arguments, and leaves them alone", _pure),
        ("hidden parameters do not reach it", _blind),
        ("runs an episode to its end", _episode),
        ("time of a decision", _speed),
    )
    for promise, look in promises:
        try:
            yield Check(promise, True, look(policy))
        except Broken as broken:
            yield Check(promise, False, str(broken))
        except Exception as problem:  # a stranger's policy may raise anything
            yield Check(promise, False, f"{type(problem).__name__}: {problem}{_place(policy, problem)}")


def _place(policy: str, problem: Exception) -> str:
    """Where in a stranger's own files something was raised, such as " (my_law.py:12)"; empty: not there."""
    own = {str(file) for file in resolve.sources(policy)}
    lines = [frame for frame in traceback.extract_tb(problem.__traceback__) if frame.filename in own]
    return f" ({os.path.relpath(lines[-1].filename)}:{lines[-1].lineno})" if lines else ""


def _expect(kept: bool, otherwise: str) -> None:
    if not kept:
        raise Broken(otherwise)


def _loop(policy: Any, env: Any, steps: int = STEPS, seed: int = 0) -> list[tuple[Array, Array, Any]]:
    """Observations, actions and states of a closed loop."""
    observation, _ = env.reset(seed=seed)
    state, log = None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state=state, episode_start=None, deterministic=True)
        log.append((observation, action, state))
        observation = env.step(action)[0]
    return log


def _made_from_the_interface(policy: str) -> str:
    if resolve.access(policy) == "privileged":
        return "no: it is told the truth, so it is shown and not ranked"
    made = resolve.make(policy, TwoLinkArmEnv().interface)
    return f"{type(made).__name__}, told: {resolve.access(policy)}"


def _shapes(policy: str) -> str:
    # An archive fits the one kind of action that it was trained with.
    kinds = ("normalized",) if policy.endswith(".zip") else ("normalized", "torque", "acceleration")
    for action in kinds:
        env = TwoLinkArmVectorEnv(LANES, "everything-2", action=action)
        box = env.interface.action_space
        for _, actions, _ in _loop(resolve.make(policy, env), env):
            _expect(
                np.shape(actions) == (LANES, 2), f"got shape {np.shape(actions)} for {LANES} observations ({action})"
            )
            _expect(bool(np.isfinite(actions).all()), f"got {actions} ({action})")
            _expect(
                bool(np.all((actions >= box.low) & (actions <= box.high))), f"got {actions}, outside the box ({action})"
            )
        single = TwoLinkArmEnv("everything-2", action=action)
        for _, one, _ in _loop(resolve.make(policy, single), single, 3):
            _expect(np.shape(one) == (2,), f"got shape {np.shape(one)} for one observation ({action})")
    return f"{', '.join(kinds)}, single and batched"


def _lanes(policy: str) -> str:
    batch = TwoLinkArmVectorEnv(LANES, "everything-2")
    log = _loop(resolve.make(policy, batch), batch, seed=10)
    worst = 0.0
    for lane in range(LANES):
        # The single arm does as the lane did, and the policy sees the lane's readings: no loop is closed that would
        # amplify the last bits, in which a batch may differ.
        env = TwoLinkArmEnv("everything-2")
        env.reset(seed=10 + lane)
        alone, state = resolve.make(policy, env), None
        for observations, actions, _ in log:
            action, state = alone.predict(observations[lane], state=state, episode_start=None, deterministic=True)
            worst = max(worst, float(np.abs(actions[lane] - action).max()))
            if env.step(actions[lane])[2]:  # it diverged
                break
    _expect(worst < LAST_BITS, f"actions differ by up to {worst:.2g}")
    return f"actions differ by at most {worst:.1e}"


def _resets(policy: str) -> str:
    if resolve.access(policy) == "privileged":
        return "not checked: it looks at the environment"
    env = TwoLinkArmVectorEnv(3, "everything-2")
    made = resolve.make(policy, env)
    _, _, old = _loop(made, env)[-1]
    observation, _ = env.reset(seed=5)
    some = np.array([False, True, False])
    kept, _ = made.predict(observation, state=old, episode_start=~np.ones(3, dtype=bool), deterministic=True)
    fresh, _ = made.predict(observation, state=None, episode_start=None, deterministic=True)
    mixed, _ = made.predict(observation, state=old, episode_start=some, deterministic=True)
    _expect(np.array_equal(mixed[~some], kept[~some]), "lanes that go on were begun afresh too")
    _expect(np.array_equal(mixed[some], fresh[some]), "a lane that begins still knows of the last episode")
    return "as promised"


def _pure(policy: str) -> str:
    env = TwoLinkArmVectorEnv(2, "everything-2")
    made = resolve.make(policy, env)
    observation, _, state = _loop(made, env)[-1]
    before = observation.copy(), _copies(state)
    one, _ = made.predict(observation, state=state, episode_start=None, deterministic=True)
    two, _ = made.predict(observation, state=state, episode_start=None, deterministic=True)
    _expect(np.array_equal(one, two), "the same arguments gave two different actions")
    _expect(np.array_equal(before[0], observation), "it changed the observation")
    same = all(np.array_equal(a, b) for a, b in zip(before[1], _copies(state), strict=True))
    _expect(same, "it changed the state that it was given")
    return "the same twice"


def _copies(state: Any) -> list[Array]:
    return [np.array(x, copy=True) for x in state] if isinstance(state, tuple | list) else []


def _blind(policy: str) -> str:
    if resolve.access(policy) == "privileged":
        return "not so: it is told the truth"
    made = [resolve.make(policy, TwoLinkArmEnv(parameter_error=ratio)) for ratio in (0.5, 2.0)]
    env = TwoLinkArmEnv()
    log = _loop(made[0], env)
    state = None
    for observation, action, _ in log:
        other, state = made[1].predict(observation, state=state, episode_start=None, deterministic=True)
        _expect(
            np.array_equal(action, other), "two arms with one nominal model and the same readings got different actions"
        )
    return "the same readings gave the same actions"


def _episode(policy: str) -> str:
    (row,) = measure(rollout(policy, scenarios.get("nominal"), [0]))
    return f"nominal, seed 0: error {row['error_pct']:.3g} %" + (", diverged" if row["diverged"] else "")


def _speed(policy: str) -> str:
    found = []
    for lanes in (1, 256):
        env = TwoLinkArmVectorEnv(lanes, "nominal")
        made = resolve.make(policy, env)
        observation, _, state = _loop(made, env, 5)[-1]
        times = []
        for _ in range(50):
            begin = time.perf_counter()
            made.predict(observation, state=state, episode_start=None, deterministic=True)
            times.append(time.perf_counter() - begin)
        found.append(f"{1e6 * float(np.median(times)) / lanes:.3g} us a lane of {lanes}")
    return ", ".join(found)
