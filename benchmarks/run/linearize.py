"""Linearisation of a policy and an arm at rest.

The plant is the real arm over one control interval. The law is the policy's map from measured
signals and its state to a torque and its next state; its derivatives are difference quotients of
`predict`.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.loop import LinearLoop, NotLinear, Unstable
from benchmarks.run.metrics import MARGINS
from benchmarks.run.rollout import make_env, reference_motion
from controllers.base import leaves, map_state, where_lanes
from controllers.oracles.true_arm import TrueArm
from fbl_gym.interface import Interface
from fbl_gym.kernel.batch import Truth
from fbl_gym.model.arm import Array
from fbl_gym.options import ArrayReference, Encoder, Friction, Payload
from fbl_gym.records.checks import Pair, check_pair
from fbl_gym.records.record import Distribution, ends
from fbl_gym.scenarios import Scenario, as_scenario
from fbl_gym.scenarios.classes import CLASSES

#: A point within the default motion at which gravity acts on both joints [rad].
POINT: Pair = (-1.0, 0.5)

#: The slots of the observation that depend on the arm. The reference is held.
MEASURED = ("position", "velocity", "acceleration", "previous_actions")

#: An arm that is not at rest after so long [s] does not come to rest without dry friction.
SETTLING = 10.0

#: A policy whose state has more numbers is not linearised, since that would take minutes.
MOST_NUMBERS = 2_000

#: Steps of the difference quotients: shares of each quantity, absolute where it is below 1.
STEPS = (1e-5, 1e-6)

#: Parts of the steps that are tried at a kink.
#:
#: A law that mixes two settings is smooth, and bends within some 1e-6 rad.
FINER = (0.1, 0.01)


def linearize(
    policy: PolicySpec | str, scenario: Scenario | str | None = None, at: Pair = POINT, *, seed: int = 0
) -> LinearLoop:
    """Linearise the loop of a policy about rest at the constant reference `at` [rad].

    The policy first runs an episode of the scenario that ends at rest there; what it learns, such
    as the dry friction, it knows at the operating point. The arm then goes on without noise,
    disturbance and dry friction, and carries its payload. If it does not come to rest, the
    operating point is that of the end of the episode. The law is built for the sensors of the data
    sheet; its readings are exact.

    Raises:
        NotLinear: the policy reads the true state, the drives are too weak, or the law is not
            linear even for small deviations.
    """
    (loop,) = linearize_all(policy, scenario, at, [seed])
    if isinstance(loop, NotLinear):
        raise loop
    return loop


def linearize_all(
    policy: PolicySpec | str, scenario: Scenario | str | None, at: Pair, seeds: Sequence[int], **gains: Any
) -> list[LinearLoop | NotLinear]:
    """Return the loop of a policy with the arm of each seed, or why it has none; see `linearize`.

    `gains` take the place of the policy's.
    """
    scenario, spec = _without_jitter(as_scenario(scenario)), resolve(policy)
    point = check_pair("at", at)
    if not spec.ranked:
        raise NotLinear("the policy reads the true state")
    steps = round(SETTLING / scenario.control_dt) + 1
    reference, duration = ArrayReference(position=(point,)), steps * scenario.control_dt
    calm = _calm(scenario, spec).replace(reference=reference, initial_error=0.0, duration=duration)
    env, told = make_env(spec, calm, len(seeds)), make_env(spec, scenario, 1).interface
    # A law designs its filter for the sensors that the datasheet states; here they read exactly.
    stated = {"noise_std": told.noise_std, "resolution": told.resolution}
    actor = spec.make(dataclasses.replace(env.interface, **stated), **gains)
    adapter = getattr(actor, "adapter", None)
    if adapter is not None and adapter.settings.action == "torque" and adapter.hold > 1:
        return [NotLinear("the agent holds its torque for several samples")] * len(seeds)
    observation, state, errors, lost = _run(spec, scenario, point, seeds, gains)
    loops: list[LinearLoop | NotLinear] = []
    limit = scenario.actuator.torque_limit
    with np.errstate(invalid="ignore", divide="ignore"):  # a state may be moved beyond its bounds
        rests = _rest(env, actor, seeds, observation, state, lost)
        for (seen, known, truth), error in zip(rests, errors, strict=True):
            for _ in range(3):  # an agent that decides at this sample goes on for one or two
                try:
                    loop: LinearLoop | NotLinear = _loop(calm, limit, env.interface, truth, actor, seen, known, error)
                    break
                except NotLinear as reason:
                    loop = reason
                _, known = actor.predict(seen[None], state=known, deterministic=True)
            loops.append(loop)
    return loops


#: Number of arms whose margins a result has, and least number of its seeds.
#:
#: Margins take longer than the runs of a short board, which has 8 seeds.
ARMS, LEAST_SEEDS = 8, 16


def has_margins(policy: PolicySpec, scenario: Scenario, seeds: Sequence[int]) -> bool:
    """Return True if a result has margins: of a ranked policy in a board's nominal scenario."""
    nominal = scenario.name.partition("@")[0] in [f"{robot}-nominal" for robot in CLASSES]
    return nominal and policy.ranked and len(seeds) >= LEAST_SEEDS


def margin_metrics(
    policy: PolicySpec, scenario: Scenario, seeds: Sequence[int], gains: Mapping[str, Any] = {}
) -> list[dict[str, float]]:
    """Return the metrics of margins of the arm of each seed, by their names in `METRICS`.

    A loop that is unstable without dry friction has no margin; one that cannot be linearised is
    NaN.
    """
    rows, dt = [], scenario.control_dt
    for loop in linearize_all(policy, scenario, POINT, seeds, **gains):
        numbers = [math.nan] * 4
        try:
            if not isinstance(loop, NotLinear):
                found = loop.margins()
                numbers = [min(found.phase), found.delay / dt, min(found.gain_upper), max(found.sensitivity)]
        except Unstable:
            numbers = [0.0, 0.0, 1.0, math.inf]
        rows.append(dict(zip(MARGINS, np.minimum(numbers, 1e6).tolist(), strict=True)))
    return rows


def margins_as_data(
    policy: PolicySpec, scenario: Scenario, at: Pair = POINT, seed: int = 0, *, response: bool = False
) -> dict[str, Any]:
    """Return the fields of a policy's margins, with `response` also both joints' loop transfers."""
    loop = linearize(policy, scenario, at, seed=seed)
    curves = {"response": [loop.response(joint, points=500) for joint in (0, 1)]} if response else {}
    return vars(loop.margins()) | curves


def _without_jitter(scenario: Scenario) -> Scenario:
    """Return the scenario with the mean of the jitter, to a physics step, in the drive's delay."""
    drive, dt = scenario.actuator, scenario.physics_dt
    if not (mean := round(0.5 * ends(drive.jitter)[1] / dt) * dt):
        return scenario
    delay: Any = drive.delay
    if isinstance(delay, Distribution):
        delay = Distribution(**{name: x and tuple(y + mean for y in x) for name, x in vars(delay).items()})
    else:
        delay = delay + mean
    return scenario.replace(actuator=dataclasses.replace(drive, jitter=0.0, delay=delay))


def _run(
    spec: PolicySpec, scenario: Scenario, point: Pair, seeds: Sequence[int], gains: dict[str, Any]
) -> tuple[Array, Any, Array, Array]:
    """Return observation [n x size], state, root mean square error [n] rad after an episode.

    The episode has the motion of the first seed and ends at rest at a point. The last part of the
    answer marks the arms that diverged [n]; their error counts as 1 mrad.
    """
    every = math.ceil(0.02 / scenario.control_dt)
    motion = reference_motion(scenario, seeds[:1])[0, ::every, 0]
    share = np.minimum(np.linspace(0.0, 1.5, 75), 1.0)[:, None]
    last = motion[-1] + (np.array(point) - motion[-1]) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    reference = ArrayReference(position=np.concatenate([motion, last]).tolist(), dt=every * scenario.control_dt)
    scenario = scenario.replace(reference=reference, duration=len(reference.position) * reference.dt)
    env, state, squares, lost = make_env(spec, scenario, len(seeds)), None, [], np.zeros(len(seeds), dtype=bool)
    actor, (observation, _) = spec.make(env, **gains), env.reset(seed=[*seeds])
    for _ in range(scenario.steps - 1):
        action, state = actor.predict(observation, state=state, deterministic=True)
        observation, _, terminated, _, _ = env.step(action)
        lost |= terminated
        truth = env.truth
        squares.append(np.mean((truth.reference - truth.position) ** 2, axis=1))
    return observation, state, np.where(lost, 1e-3, np.sqrt(np.mean(squares, axis=0))), lost


def _rest(
    env: Any, actor: Any, seeds: Sequence[int], last: Array, learned: Any, lost: Array
) -> list[tuple[Array, Any, Truth]]:
    """Return observation [size], the policy's state and the true state at rest of each arm.

    An arm that does not come to rest has the `last` observation and what is `learned`. A policy
    that `lost` its arm begins anew.
    """
    observation, _ = env.reset(seed=[*seeds])
    if lost.any():
        last = np.where(lost[:, None], observation, last)
        fresh = None if lost.all() else actor.predict(observation, deterministic=True)[1]
        learned = None if fresh is None else where_lanes(lost, fresh, learned)
    dt, state = env.scenario.control_dt, learned
    points = [_of_lane(i, last, learned, env.truth) for i in range(len(seeds))]
    moving, before = np.ones(len(seeds), dtype=bool), np.full(len(seeds), np.inf)
    for k in range(round(SETTLING / dt)):
        action, state = actor.predict(observation, state=state, deterministic=True)
        observation, _, terminated, _, _ = env.step(action)
        moving &= ~terminated
        if (k + 1) % round(1.0 / dt) == 0:
            truth = env.truth
            speeds = np.abs(np.concatenate([truth.velocity, truth.acceleration], axis=1)).max(axis=1)
            for i in np.flatnonzero(moving & (speeds < 1e-6)).tolist():
                points[i] = _of_lane(i, observation, state, truth)
            # An arm that loses so little of its speed in a second does not come to rest in time.
            moving &= (speeds >= 1e-6) & ((speeds <= 1e-3) | (speeds <= 0.7 * before))
            before = speeds
        if not moving.any():
            break
    return points


def _of_lane(lane: int, observation: Array, state: Any, truth: Truth) -> tuple[Array, Any, Truth]:
    """Return a lane's observation [size], and its state and truth as those of one lane."""
    one = slice(lane, lane + 1)
    state = None if state is None else map_state(lambda part: np.asarray(part)[one], state)
    return observation[lane], state, Truth(**{name: value[one] for name, value in vars(truth).items()})


def _calm(scenario: Scenario, spec: PolicySpec) -> Scenario:
    """Return the scenario without noise, disturbance, dry friction, ripple and the like."""
    encoder, drive, error = scenario.encoder, scenario.actuator, scenario.parameter_error
    if encoder is not None:
        encoder = dataclasses.replace(encoder, counts=None, dropout=0.0)
    if error is not None and isinstance(error.payload, Payload):
        error = dataclasses.replace(error, payload=dataclasses.replace(error.payload, pick_up=0.0, drop=None))
    friction = None if scenario.friction is None else Friction(viscous=scenario.friction.viscous)
    # Small motions stay within the limits, but the steps of a difference quotient may not.
    # The actions of an agent are shares of the limits.
    times = 10.0 if spec.kind == "classical" else 1.0
    limit: Any = drive.torque_limit and np.minimum(times * np.array(drive.torque_limit), 1e30)
    drive = dataclasses.replace(drive, ripple=0.0, torque_limit=limit)
    calm: dict[str, Any] = {"noise": None, "disturbance": None, "constraints": None, "events": ()}
    return scenario.replace(parameter_error=error, friction=friction, encoder=encoder, actuator=drive, **calm)


def _loop(
    scenario: Scenario, limit: Any, interface: Interface, truth: Truth, actor: Any, observation: Array, state: Any,
    error: float,
) -> LinearLoop:  # fmt: skip
    """Linearise at a true state, and at an observation [size] with the policy's state.

    Where the law has a kink, the point is beside it: of a reading by the `error` of a run [rad].
    The drives that hold the arm there have the torque `limit`.
    """
    if limit is not None and np.any(np.abs(truth.applied_torque) > truth.gain * np.array(limit)):
        raise NotLinear("the drives cannot hold the arm there")
    layout, (motion, drive) = interface.layout, _motion(scenario, truth)
    encoder = scenario.encoder or Encoder()
    slots = {slot: np.arange(layout.size)[layout[slot]] for slot in MEASURED if slot in layout}
    entries = np.concatenate([*slots.values()])
    (step, point), m = _law(actor, interface, observation, entries, state), len(entries)
    slope, kinks = _derivative(step, point)
    part = next((x for x in FINER if kinks.any() and not _derivative(step, point, x)[1].any()), 1.0)
    if part < 1.0:
        slope, kinks = _derivative(step, point, part)
    elif kinks.any():
        beside = np.append(np.full(m, error), 2 * max(STEPS) * np.maximum(1.0, np.abs(point[m:])))
        point = point + beside * kinks
        slope, _ = _derivative(step, point, smooth=True)
    if not slope[:2].any():
        raise NotLinear("the torque is constant, perhaps at its limit")
    if _differ(_derivative(lambda points: step(points, later=1), point, part, smooth=True)[0], slope).any():
        raise NotLinear("the law changes from sample to sample")
    share = 1.0 - np.exp(-2 * np.pi * (encoder.low_pass or np.inf) * scenario.control_dt)
    loop = LinearLoop(
        control_dt=scenario.control_dt, delay=float(truth.delay[0]), lag=float(truth.lag[0]), motion=motion,
        drive=drive * truth.gain[0],
        measured=len(motion) - 4 if scenario.joint is not None and scenario.joint.encoder == "motor" else 0,
        encoder=(encoder.latency, encoder.difference or 0, share),
        matrices=(*_minimal(slope[2:, m:], slope[2:, :m], slope[:2, m:]), slope[:2, :m]),
        readings={slot: len(places) for slot, places in slots.items()},
        action_scale=np.array(interface.torque_limit) if interface.action == "normalized" else np.ones(2),
    )  # fmt: skip
    if not kinks.any():
        _check_motion(loop, step, point, slope)
    return loop


def _motion(scenario: Scenario, truth: Truth) -> tuple[Array, Array]:
    """Return the derivatives of the state's rate by the state and by the drives' torque.

    The torque holds the arm. A tooth that is pressed stays pressed.
    """
    arm, gap = TrueArm(truth, scenario, scenario.arm.gravity), 0.5 * truth.backlash
    stretch = np.abs(truth.motor_position - truth.position)
    if arm.elastic and np.any((gap > 0.0) & (stretch < gap + 2 * max(STEPS))):
        raise NotLinear("a joint is within the gap of its backlash, where motor and link do not touch")
    state = arm.state
    by_torque = arm.slope(state)[0, :, -2:]
    state[0, -2:] -= np.linalg.lstsq(by_torque, arm.rates(state[:, :-2], state[:, -2:])[0], rcond=None)[0]
    slope = arm.slope(state)[0]
    return slope[:, :-2], slope[:, -2:]


def _law(
    actor: Any, interface: Interface, observation: Array, entries: Array, state: Any
) -> tuple[Callable[..., Array], Array]:
    """Return a policy as a function of lanes, and the point at which it is linearised.

    The function maps entries of the observation, and the state's finite floating-point parts, to
    the torque and the next state.
    """
    layout, m = interface.layout, len(entries)
    parts = [np.asarray(part) for part in leaves(state or ())]
    if any(part.shape[:1] != (1,) for part in parts):
        raise NotLinear("the policy's state has no row for each lane")
    # An infinite part is a limit that does not act.
    real = [i for i, part in enumerate(parts) if part.dtype.kind == "f" and np.isfinite(part).all()]
    cuts = np.cumsum([m, *(parts[i].size for i in real)])
    if cuts[-1] > MOST_NUMBERS:
        raise NotLinear(f"the policy's state has too many numbers, {cuts[-1] - m}")

    def step(points: Array, later: int = 0) -> Array:
        """Return torque and next state [n x ...]; the state's counters are increased by `later`."""
        n = len(points)
        observations = np.tile(observation, (n, 1))
        observations[:, entries] = points[:, :m]
        lanes = [np.repeat(part + later if part.dtype.kind in "iu" else part, n, axis=0) for part in parts]
        for i, start, stop in zip(real, cuts[:-1], cuts[1:], strict=True):
            lanes[i] = points[:, start:stop].reshape(n, *parts[i].shape[1:])
        rows = iter(lanes)
        now = None if state is None else map_state(lambda _: next(rows), state)
        action, after = actor.predict(observations, state=now, deterministic=True)
        after = leaves(after or ())
        q = observations[:, layout["position"]]
        v = observations[:, layout["velocity"]] if "velocity" in layout else np.zeros_like(q)
        torque = interface.torque_from_action(np.asarray(action), q, v)
        return np.hstack([torque, *(after[i].reshape(n, -1) for i in real)])

    return step, np.concatenate([observation[entries], *(parts[i].ravel() for i in real)])


def _check_motion(loop: LinearLoop, step: Callable[..., Array], point: Array, slope: Array) -> None:
    """Raise `NotLinear` if the law departs from its linearisation while a linear plant moves.

    An estimator, such as that of `adaptive-flm`, may switch only if its samples are those of a
    moving arm. The plant is delayed, since an estimator with an exact model would find it again.
    """
    a, b, c = loop.plant(1.5 * loop.control_dt)
    m, centre = len(c), step(point[None])[0]
    x, states = np.zeros(len(a)), np.zeros(len(point) - m)
    x[: len(loop.motion)] = [1e-6, -1e-6, 1e-5, 2e-5] * (len(loop.motion) // 4)
    largest = 0.0
    for _ in range(100):
        inputs = np.concatenate([c @ x, states])
        change, expected = step((point + inputs)[None])[0] - centre, slope @ inputs
        largest = max(largest, np.abs(expected[:2]).max())
        if np.abs(change - expected)[:2].max() > 0.02 * largest:
            raise NotLinear("the law does not follow its linearisation")
        if np.abs(c @ x).max() > 1e-3:
            break
        x, states = a @ x + b @ change[:2], change[2:]


def _derivative(
    function: Callable[[Array], Array], point: Array, part: float = 1.0, *, smooth: bool = False
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the derivative [k x m] of a function of lanes [n x m] -> [n x k], and its kinks [m].

    The slopes differ on both sides of a kink. With `smooth`, it is refused. The steps are that part
    of `STEPS`.
    """
    steps = [part * step * np.maximum(1.0, np.abs(point)) for step in STEPS]
    moved = [point + sign * np.diag(step) for step in steps for sign in (1.0, -1.0)]
    values = function(np.concatenate([point[None], *moved]))
    if not np.isfinite(values).all():
        raise NotLinear("the law's numbers are not finite near this point")
    centre, (up, down, fine_up, fine_down) = values[0], np.split(values[1:], 4)
    coarse, slope = (up - down).T / (2.0 * steps[0]), (fine_up - fine_down).T / (2.0 * steps[1])
    # The slopes of both sides differ in proportion to the step, or there is a kink.
    gap, fine_gap = (up + down - 2.0 * centre).T / steps[0], (fine_up + fine_down - 2.0 * centre).T / steps[1]
    wrong = _differ(coarse, slope) | _differ(slope + fine_gap, slope, 0.3 * np.abs(gap))
    if wrong.any():
        # At a jump, the quotients grow as the steps shrink.
        jumps = np.abs(slope) + np.abs(fine_gap) > 0.5 * STEPS[0] / STEPS[1] * (np.abs(coarse) + np.abs(gap))
        if (wrong & jumps).any():
            raise NotLinear("the law jumps at this point")
        if smooth:
            raise NotLinear("the law has no derivative at this point")
    return slope, np.any(wrong, axis=0)


def _differ(one: Array, other: Array, allowed: Array | float = 0.0) -> NDArray[np.bool_]:
    """Return True where two derivatives differ by more than is allowed and their rounding."""
    rounding = 1e-3 * np.abs(other) + 1e-5 * np.abs(other).max(axis=1, keepdims=True)
    return np.abs(one - other) > allowed + rounding


def _minimal(a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
    """Return A, B, C without the states that no input moves or no output shows."""
    for _ in range(2):
        basis, block = np.zeros((len(a), 0)), b
        while block.any():
            block = block / np.maximum(np.linalg.norm(block, axis=0), 1e-300)
            for _ in range(2):  # rounding leaves nothing after the second time
                block = block - basis @ (basis.T @ block)
            directions, sizes, _ = np.linalg.svd(block, full_matrices=False)
            new = directions[:, sizes > 1e-7]
            basis, block = np.hstack([basis, new]), a @ new
        a, b, c = (basis.T @ a @ basis).T, (c @ basis).T, (basis.T @ b).T
    return a, b, c
