"""The promises of a policy, checked on any policy: `fbl-gym check-policy`."""

import itertools
import os
import traceback
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from benchmarks.policies import external
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import action_of, make_env, rollout
from benchmarks.text import reason_of
from controllers.base import leaves
from fbl_gym import Scenario
from fbl_gym.model.arm import Array
from fbl_gym.scenarios import as_scenario

ARMS, STEPS = 5, 30

LAST_BITS = 1e-4
"""Largest difference of the actions of a batch and of one arm, as a fraction of the limits. A
network in single precision rounds differently for matrices of different sizes."""


class Check(NamedTuple):
    """The check of one promise: whether it is kept, the observation, and True for an error."""

    promise: str
    kept: bool
    detail: str
    failed: bool = False


class Broken(AssertionError):
    """A promise is broken."""


def check(policy: PolicySpec | str, scenario: Scenario | str = "everything-2") -> Iterator[Check]:
    """Check each promise of a policy in turn."""
    spec, task = resolve(policy), as_scenario(scenario)
    for promise, test in _PROMISES.items():
        try:
            yield Check(promise, True, test(spec, task))
        except Broken as broken:
            yield Check(promise, False, str(broken))
        except (Exception, SystemExit) as problem:  # an external policy may raise anything
            yield Check(promise, False, reason_of(problem) + _position(spec, problem), failed=True)


def broken(policy: PolicySpec, scenario: Scenario) -> str:
    """Return the first promise that a policy breaks, and how; empty: none before an error."""
    checks = itertools.islice(check(policy, scenario), len(_PROMISES) - 1)  # the cell runs whole episodes itself
    first = next((one for one in checks if not one.kept), None)
    # The run raises an error again.
    return "" if first is None or first.failed else f"breaks a promise ({first.promise}): {first.detail}"


def _position(policy: PolicySpec, problem: BaseException) -> str:
    """Return the position of an error in an external policy's files, such as " (my_law.py:12)"."""
    files = {str(file) for file in external.sources(policy.parsed).values()} if policy.external else set()
    lines = [frame for frame in traceback.extract_tb(problem.__traceback__) if frame.filename in files]
    return f" ({os.path.relpath(lines[-1].filename)}:{lines[-1].lineno})" if lines else ""


def _expect(kept: Any, otherwise: str) -> None:
    if not kept:
        raise Broken(otherwise)


def _act(policy: Any, observation: Array, state: Any, start: Any = None) -> Any:
    return policy.predict(observation, state=state, episode_start=start, deterministic=True)


def _loop(policy: Any, env: Any, steps: int = STEPS, seed: int = 0) -> list[tuple[Array, Array, Any]]:
    """Return observations, actions and states of a closed loop."""
    observation, _ = env.reset(seed=seed)
    state, log = None, []
    for _ in range(steps):
        action, state = _act(policy, observation, state)
        log.append((observation, action, state))
        observation = env.step(action)[0]
    return log


def _made_from_the_interface(policy: PolicySpec, scenario: Scenario) -> str:
    _expect(not policy.problem, policy.problem)
    if not policy.ranked:
        return "no: it knows the truth, so the board shows it without a rank"
    return f"{type(policy.make(make_env(policy, scenario, 1).interface)).__name__}, access: {policy.access}"


def _shapes(policy: PolicySpec, scenario: Scenario) -> str:
    usual = action_of(scenario)
    own = policy.kind == "learned" and policy.external  # it may know only the actions of its training
    kinds = (usual,) if own else dict.fromkeys((usual, "torque", "acceleration"))
    for action in kinds:
        env, single = make_env(policy, scenario, ARMS, action), make_env(policy, scenario, None, action)
        box = env.interface.action_space
        for _, actions, _ in _loop(policy.make(env), env):
            shape = np.shape(actions)
            _expect(shape == (ARMS, 2), f"got shape {shape} for {ARMS} observations ({action})")
            _expect(np.isfinite(actions).all(), f"got {actions} ({action})")
            rounded = np.asarray(actions, box.dtype)  # as a torque limit is
            _expect(((rounded >= box.low) & (rounded <= box.high)).all(), f"got {actions}, outside the box ({action})")
        for _, one, _ in _loop(policy.make(single), single, 3):
            _expect(np.shape(one) == (2,), f"got shape {np.shape(one)} for one observation ({action})")
    return f"{', '.join(kinds)}, single and batched"


def _lanes(policy: PolicySpec, scenario: Scenario) -> str:
    batch = make_env(policy, scenario, ARMS)
    log = _loop(policy.make(batch), batch, seed=10)
    worst = 0.0
    for lane in range(ARMS):
        # The single arm repeats the lane's actions and the policy gets the lane's readings: a
        # closed loop would amplify the last bits, in which a batch may differ.
        env = make_env(policy, scenario, None)
        env.reset(seed=10 + lane)
        alone, state = policy.make(env), None
        for observations, actions, _ in log:
            action, state = _act(alone, observations[lane], state)
            worst = max(worst, float(np.abs(actions[lane] - action).max()))
            if env.step(actions[lane])[2]:  # it diverged
                break
    _expect(worst < LAST_BITS, f"actions differ by up to {worst:.2g}")
    return f"actions differ by at most {worst:.1e}"


def _resets(policy: PolicySpec, scenario: Scenario) -> str:
    if not policy.ranked:
        return "not checked: it reads the environment"
    env = make_env(policy, scenario, 3)
    actor = policy.make(env)
    _, _, old = _loop(actor, env)[-1]
    observation, _ = env.reset(seed=5)
    some = np.array([False, True, False])
    going, _ = _act(actor, observation, old, np.zeros(3, dtype=bool))
    fresh, _ = _act(actor, observation, None)
    mixed, _ = _act(actor, observation, old, some)
    _expect(np.array_equal(mixed[~some], going[~some]), "lanes that go on began afresh too")
    _expect(np.array_equal(mixed[some], fresh[some]), "a lane that begins still knows the last episode")
    return "as promised"


def _pure(policy: PolicySpec, scenario: Scenario) -> str:
    env = make_env(policy, scenario, 2)
    actor = policy.make(env)
    observation, _, state = _loop(actor, env)[-1]
    before = observation.copy(), _copies(state)
    one, two = (_act(actor, observation, state)[0] for _ in range(2))
    _expect(np.array_equal(one, two), "the same arguments gave two different actions")
    _expect(np.array_equal(before[0], observation), "it changed the observation")
    same = all(np.array_equal(a, b) for a, b in zip(before[1], _copies(state), strict=True))
    _expect(same, "it changed the state that it was given")
    return "the same twice"


def _copies(state: Any) -> list[Array]:
    return [np.array(x, copy=True) for x in leaves(state)] if isinstance(state, tuple | list) else []


def _blind(policy: PolicySpec, scenario: Scenario) -> str:
    if not policy.ranked:
        return "no: it knows the truth"
    env, *others = (make_env(policy, scenario.replace(parameter_error=ratio), 1) for ratio in (1.0, 0.9, 1.1))
    actors = [policy.make(other) for other in others]
    state = None
    for observation, action, _ in _loop(actors[0], env):
        other, state = _act(actors[1], observation, state)
        _expect(
            np.array_equal(action, other), "two arms with one nominal model and the same readings got other actions"
        )
    return "the same readings gave the same actions"


def _episode(policy: PolicySpec, scenario: Scenario) -> str:
    (row,) = measure(rollout(policy, scenario, [0]))
    return f"{scenario.name}, seed 0: error {row['error_pct']:.3g} %" + (", diverged" if row["diverged"] else "")


_PROMISES: dict[str, Callable[[PolicySpec, Scenario], str]] = {
    "is made from the interface alone": _made_from_the_interface,
    "actions have the observations' shape, are finite and lie in the box": _shapes,
    "a lane of a batch acts as a single policy": _lanes,
    "episode_start begins exactly those lanes afresh": _resets,
    "predict is a function of its arguments, and leaves them alone": _pure,
    "hidden parameters do not reach it": _blind,
    "runs an episode to its end": _episode,
}
