"""The promises of a policy, checked on any policy: `fbl-gym check-policy`.

Before its first run on a scenario, an external policy must keep them too. It acts over a whole
episode, or its first part: 1000 steps at least, so at least a second, and past the last event.
"""

import itertools
import math
import os
import traceback
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from benchmarks.policies.key import shared
from benchmarks.policies.spec import PolicySpec, build, resolve
from benchmarks.policies.watch import Watch
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import action_of, make_env, rollout
from benchmarks.text import reason_of
from controllers.base import leaves, map_state
from fbl_gym import Scenario
from fbl_gym.model.arm import Array
from fbl_gym.records.record import ends
from fbl_gym.scenarios import as_scenario

ARMS, FEW = 3, 30

#: Fewest steps of the episode, if it is not over, and time after the last event [s].
LEAST_STEPS, AFTER = 1000, 0.5

#: Largest difference of the actions of a batch and of one arm, as a fraction of the limits. A
#: network in single precision rounds differently for matrices of different sizes.
LAST_BITS = 1e-4


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
    shared()  # reads files, which are not the policy's
    with Watch(spec) as seen:
        trial = _Trial(spec, task, seen)
        for promise, test in _PROMISES.items():
            try:
                yield Check(promise, True, test(trial))
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
    files = {*policy.files.values()} if policy.external else set()
    lines = [frame for frame in traceback.extract_tb(problem.__traceback__) if frame.filename in files]
    return f" ({os.path.relpath(lines[-1].filename)}:{lines[-1].lineno})" if lines else ""


def _expect(kept: Any, otherwise: str) -> None:
    if not kept:
        raise Broken(otherwise)


def _act(policy: Any, observation: Array, state: Any, start: Any = None) -> Any:
    return policy.predict(observation, state=state, episode_start=start, deterministic=True)


def _loop(policy: Any, env: Any, steps: int = FEW, seed: int = 0) -> list[tuple[Array, Array, Any]]:
    """Return observations, actions and states of a closed loop."""
    observation, _ = env.reset(seed=seed)
    state, log = None, []
    for _ in range(steps):
        action, state = _act(policy, observation, state)
        log.append((observation, action, state))
        observation = env.step(action)[0]
    return log


class _Trial:
    """A policy on a scenario, loaded once, with an episode of it."""

    def __init__(self, policy: PolicySpec, scenario: Scenario, seen: Watch) -> None:
        self.policy, self.scenario, self.seen = policy, scenario, seen

    @cached_property
    def factory(self) -> Callable[..., Any]:
        return self.policy.factory()

    def actor(self, lanes: int | None, action: str | None = None, **changes: Any) -> tuple[Any, Any]:
        """Return the policy, newly made, and its environment."""
        env = make_env(self.policy, self.scenario.replace(**changes), lanes, action)
        return build(self.policy.parsed, self.factory, env), env

    @cached_property
    def log(self) -> list[tuple[Array, Array, Any]]:
        """Observations, actions and states of an episode of `ARMS` seeds from `SEED` on."""
        dt = self.scenario.control_dt
        last = max((ends(event.time)[1] for event in self.scenario.events), default=0.0)
        steps = min(self.scenario.steps, max(LEAST_STEPS, math.ceil((max(last, 0.5) + AFTER) / dt)))
        return _loop(*self.actor(ARMS), steps, SEED)

    @np.errstate(invalid="ignore")  # a state may be infinite
    def distance(self, lanes: int | Sequence[int]) -> float:
        """Return the largest distance of a new actor's actions from those of lanes of the episode.

        It gets the readings of the episode, and before each step the lanes' state of then: a closed
        loop would amplify the last bits, in which a batch may differ. Its next state counts like
        its action. Its environment repeats the actions, as an oracle looks into it.
        """
        actor, env = self.actor(None if isinstance(lanes, int) else len(lanes))
        env.reset(seed=SEED + lanes if isinstance(lanes, int) else [SEED + lane for lane in lanes])
        worst, state = 0.0, None
        for observations, actions, after in self.log:
            action, state = _act(actor, observations[lanes], state)
            worst = max(worst, float(np.abs(actions[lanes] - action).max()))
            expected = _of_lanes(after, lanes)
            kept, new = leaves(expected), leaves(state)
            if expected is not None and [*map(np.shape, kept)] == [*map(np.shape, new)]:
                pairs = [np.asarray(pair, dtype=float) for pair in zip(kept, new, strict=True) if pair[0] is not None]
                gaps = [np.nan_to_num(np.abs(a - b) / (1.0 + np.abs(a)), posinf=0.0) for a, b in pairs]
                worst, state = max([worst, *(float(gap.max(initial=0.0)) for gap in gaps)]), expected
            if not self.policy.ranked and np.any(env.step(actions[lanes])[2]):  # it diverged
                break
        return worst


SEED = 10


def _of_lanes(state: Any, lanes: int | Sequence[int]) -> Any:
    """Return the state of some of `ARMS` lanes; None if an array in it has no axis for them."""
    kept = leaves(state)
    axes = [next((i for i, n in enumerate(np.shape(x)[:2]) if n == ARMS), None) for x in kept]  # LSTMs have the second
    if any(x is not None and axis is None for x, axis in zip(kept, axes, strict=True)):
        return None
    some = np.atleast_1d(lanes)
    taken = iter([x if x is None else np.take(x, some, axis) for x, axis in zip(kept, axes, strict=True)])
    return map_state(lambda _: next(taken), state)


def _made_from_the_interface(trial: _Trial) -> str:
    policy = trial.policy
    _expect(not policy.problem, policy.problem)
    if not policy.ranked:
        return "no: it knows the truth, so the board shows it without a rank"
    interface = make_env(policy, trial.scenario, 1).interface
    return f"{type(build(policy.parsed, trial.factory, interface)).__name__}, access: {policy.access}"


def _shapes(trial: _Trial) -> str:
    usual = action_of(trial.scenario)
    own = trial.policy.kind == "learned" and trial.policy.external  # it may know only the actions of its training
    kinds = (usual,) if own else dict.fromkeys((usual, "torque", "acceleration"))
    for action in kinds:
        actor, env = trial.actor(ARMS, action)
        box = env.interface.action_space
        for _, actions, _ in _loop(actor, env):
            shape = np.shape(actions)
            _expect(shape == (ARMS, 2), f"got shape {shape} for {ARMS} observations ({action})")
            _expect(np.isfinite(actions).all(), f"got {actions} ({action})")
            rounded = np.asarray(actions, box.dtype)  # as a torque limit is
            _expect(((rounded >= box.low) & (rounded <= box.high)).all(), f"got {actions}, outside the box ({action})")
        for _, one, _ in _loop(*trial.actor(None, action), 3):
            _expect(np.shape(one) == (2,), f"got shape {np.shape(one)} for one observation ({action})")
    return f"{', '.join(kinds)}, single and batched"


def _lanes(trial: _Trial) -> str:
    some: tuple[int | list[int], ...] = (ARMS - 1, [*range(ARMS)][::-1], [0, 1])  # alone, reordered, in a smaller batch
    worst = max(map(trial.distance, some))
    _expect(worst < LAST_BITS, f"actions differ by up to {worst:.2g}")
    return f"actions differ by at most {worst:.1e}"


def _resets(trial: _Trial) -> str:
    if not trial.policy.ranked:
        return "not checked: it reads the environment"
    actor, env = trial.actor(3)
    _, _, old = _loop(actor, env)[-1]
    observation, _ = env.reset(seed=5)
    some = np.array([False, True, False])
    going, _ = _act(actor, observation, old, np.zeros(3, dtype=bool))
    fresh, _ = _act(actor, observation, None)
    mixed, _ = _act(actor, observation, old, some)
    _expect(np.array_equal(mixed[~some], going[~some]), "lanes that go on began afresh too")
    _expect(np.array_equal(mixed[some], fresh[some]), "a lane that begins still knows the last episode")
    return "as promised"


def _pure(trial: _Trial) -> str:
    actor, env = trial.actor(2)
    observation, _, state = _loop(actor, env)[-1]
    before = _copies((observation, state))
    one, two = (_act(actor, observation, state)[0] for _ in range(2))
    _expect(np.array_equal(one, two), "the same arguments gave two different actions")
    same = (np.array_equal(a, b) for a, b in zip(before, _copies((observation, state)), strict=True))
    _expect(all(same), "it changed the observation or the state that it was given")
    del trial.factory  # each cell loads the policy anew
    again = zip(trial.log, _loop(*trial.actor(ARMS), len(trial.log), SEED), strict=True)
    same = (np.array_equal(first, second, equal_nan=True) for (_, first, _), (_, second, _) in again)
    _expect(all(same), "the same episode gave two different numbers")
    return "the same twice"


def _copies(state: Any) -> list[Array]:
    return [np.array(x, copy=True) for x in leaves(state)]


def _blind(trial: _Trial) -> str:
    if not trial.policy.ranked:
        return "no: it knows the truth"
    env = make_env(trial.policy, trial.scenario.replace(parameter_error=1.0), 1)
    (one, _), (two, _) = (trial.actor(1, parameter_error=ratio) for ratio in (0.9, 1.1))
    state = None
    for observation, action, _ in _loop(one, env):
        other, state = _act(two, observation, state)
        _expect(np.array_equal(action, other), "two arms with one model and the same readings got other actions")
    return "the same readings gave the same actions"


def _covered(trial: _Trial) -> str:
    _expect(not trial.seen.seen, "; ".join([*trial.seen.seen][:3]))
    return "it opened, started and asked for nothing else"


def _episode(trial: _Trial) -> str:
    (row,) = measure(rollout(trial.policy, trial.scenario, [0]))
    return f"{trial.scenario.name}, seed 0: error {row['error_pct']:.3g} %" + (", diverged" if row["diverged"] else "")


_PROMISES: dict[str, Callable[[_Trial], str]] = {
    "is made from the interface alone": _made_from_the_interface,
    "actions have the observations' shape, are finite and lie in the box": _shapes,
    "a lane of a batch acts as a single policy": _lanes,
    "episode_start begins exactly those lanes afresh": _resets,
    "predict is a function of its arguments, and leaves them alone": _pure,
    "hidden parameters do not reach it": _blind,
    "its numbers depend on nothing beside its key": _covered,
    "runs an episode to its end": _episode,
}
