"""The policies to use on an arm that is described by a scenario.

Policies run in the scenario. The best laws among them may be tuned for it. The best policies then
run in conditions around it. In each of these, one kind of uncertainty is larger, most often twice
as large. The order is that of the penalized error, as on a board; a condition costs at most as much
as the motionless baseline. The scenario itself counts as much as all its conditions together.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import controllers
from benchmarks.analysis.board import Board, assemble
from benchmarks.analysis.statistics import proportion
from benchmarks.policies.isolation import Failed
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.cell import Cell
from benchmarks.run.expansion import distinguish
from benchmarks.run.linearize import margins_as_data
from benchmarks.run.loop import LEAST_DELAY, LEAST_PHASE, UNSTABLE
from benchmarks.run.metrics import penalize
from benchmarks.run.rollout import reference_motion
from benchmarks.run.store import Result
from benchmarks.run.suite import OTHER_TASKS, Suite
from benchmarks.seeds import SPLITS
from fbl_gym.model.arm import ArmParameters, Array, gravity_torque, inverse_dynamics, stretched_inertia
from fbl_gym.options import Datasheet, Friction, PiecewiseConstantDisturbance, SensorError
from fbl_gym.records.record import Distribution, ends, middle, scaled
from fbl_gym.scenarios import Scenario
from fbl_gym.scenarios.class_families import LEAST, conditions, uniform
from fbl_gym.scenarios.classes import CLASSES

#: Runs cells and returns the result of each. A failed one has an error.
Run = Callable[[Sequence[Cell]], Mapping[Cell, Result]]

#: Policies that go on from the scenario alone to its conditions.
SCREENED = 8

#: Tunes the laws of some policies, the best first, and names those with new gains.
Tune = Callable[[Sequence[str]], Sequence[str]]

#: A policy is not safe if the lower bound of its share of diverged runs is above this one.
SAFE_DIVERGED = 0.01

#: A policy is not safe if it errs more than this share of the motionless baseline.
SAFE_ERROR = 0.5

RULE = (
    "safe: phase and delay margin are not below those asked for, if they are known; in the scenario itself, and in all "
    f"conditions together, at most {100 * SAFE_DIVERGED:g} % of the runs diverge (lower bound of Clopper and Pearson's 95 % "
    f"interval), and the error is below {SAFE_ERROR:g} of that of the motionless baseline"
)

#: Joints of which one alone vibrates at a lower rate [Hz] count as elastic.
SPRINGY = 25.0

#: Dry friction above this share of the arm's weight is that of the class `geared`.
MUCH_FRICTION = 0.14

#: An arm is between two classes if the distances of both differ by no more than that.
BETWEEN = 0.5

#: What a condition pushes; "everything" pushes all but the saturation, half as far.
KINDS = (
    "parameters", "payload", "delay", "lag", "friction", "disturbance", "noise", "elastic", "torque constant", "data sheet",
    "saturation",
)  # fmt: skip


def likeness(base: Scenario) -> tuple[tuple[str, ...], str]:
    """Return the class of robots that a scenario's arm is most like, and the reasons in one line.

    An arm between two classes has the next one, too. The distance of a class is half the number of
    doublings between both rates, and 1 each for another side of the encoders and another amount of
    friction.
    """
    fast, friction, joint = ("servo", "direct"), base.friction, base.joint
    sides: tuple[str, ...] = fast
    reasons = [f"{1 / base.control_dt:.0f} Hz", "rigid joints"]
    if joint is not None:
        rate = joint.springs(base.arm, lambda k: ends(k)[0])[1].min()
        sides = fast if rate > SPRINGY else ("geared",) if joint.encoder == "motor" else ("servo",)
        reasons[1] = f"springs of {rate:.2g} Hz with encoders on the {joint.encoder}s"
    if base.link is not None:
        reasons.append("links that bend")
    levels: tuple[str, ...] = tuple(CLASSES)
    if friction is not None:
        both = [np.array([np.mean(ends(x)) for x in level]) for level in (friction.coulomb, friction.stiction)]  # type: ignore[union-attr]
        share = float(np.mean(sum(both) / _weight(base.arm)))
        levels = ("geared",) if share > MUCH_FRICTION else fast
        reasons.append(f"dry friction of {100 * share:.0f} % of the weight")
    distances = {
        robot: abs(np.log2(base.control_dt / kind.control_dt)) / 2 + (robot not in sides) + (robot not in levels)
        for robot, kind in CLASSES.items()
    }
    first, second = sorted(distances, key=distances.__getitem__)[:2]
    near = (first, second) if distances[second] - distances[first] <= BETWEEN else (first,)
    return near, f"class: {'between ' * (len(near) > 1)}{' and '.join(near)} ({', '.join(reasons)})"


def around(base: Scenario) -> dict[str, Scenario]:
    """Return the conditions around a scenario, by name; the first one is the scenario itself.

    What a scenario does not have, such as noise, comes in the size of its class of robots. Rigid
    joints and links stay rigid: no stiffness can be guessed.
    """
    scenarios, robot = {"as described": base}, likeness(base)[0][0]
    for kind in KINDS:
        if (changed := push(base, kind, 2.0, robot)) != base:
            scenarios[kind] = changed.replace(name=f"{base.name}+{kind.replace(' ', '-')}")
    everything = base
    for kind in KINDS[:-1]:
        everything = push(everything, kind, 1.5, robot)
    return scenarios | {"everything": everything.replace(name=f"{base.name}+everything")}


def push(base: Scenario, kind: str, factor: float, robot: str) -> Scenario:
    """Return a scenario in which one of `KINDS` of uncertainty is larger by a factor above 1.

    `robot` is the class whose sizes are taken where the scenario has none.
    """
    more, actuator, error = factor - 1.0, base.actuator, base.parameter_error
    match kind:
        case "parameters":
            radius = factor * error.radius if error is not None and error.radius > 0 else 0.2 * more
            changes: dict[str, Any] = {"parameter_error": _replaced(error, radius=radius)}
        case "payload":
            end, payload = base.duration, error and error.payload
            mass = max(0.5 * more * base.arm.m2, factor * ends(getattr(payload, "mass", 0.0))[1])
            times = {"pick_up": uniform(0.1 * end, 0.3 * end), "drop": uniform(0.6 * end, 0.8 * end)}
            payload = _replaced(payload, mass=uniform(0.0, mass), **times)
            changes = {"parameter_error": _replaced(error, payload=payload)}
        case "delay":
            late = ends(actuator.delay)[1], ends(actuator.delay_samples)[1] * base.control_dt
            delay = factor * late[0] + more * late[1] if any(late) else more * base.control_dt
            changes = {"actuator": _replaced(actuator, delay=round(delay / base.physics_dt) * base.physics_dt)}
        case "lag":
            usual = CLASSES[robot].scenario["actuator"]["lag"]["log_uniform"][1]
            changes = {"actuator": _replaced(actuator, lag=factor * ends(actuator.lag)[1] or more * usual)}
        case "friction":
            usual = Friction(**conditions(base.arm, robot)["friction"])
            levels = ("viscous", "coulomb", "stiction", *(["load"] if base.friction is None else []))
            changes = {"friction": _larger(base.friction, usual, levels, factor)}
        case "disturbance":
            if base.disturbance is not None and not hasattr(base.disturbance, "amplitude"):
                return base
            period = max(1, round(0.5 / base.physics_dt)) * base.physics_dt
            given = {**conditions(base.arm, robot, "disturbance", 2)["disturbance"], "period": period}
            usual = PiecewiseConstantDisturbance(**given)
            changes = {"disturbance": _larger(base.disturbance, usual, ("amplitude",), factor)}
        case "noise":
            noise = getattr(base.noise, "position", None) or SensorError()
            usual = conditions(base.arm, robot, "noise", 2)["noise"]
            std = noise.std_at(base.control_dt)
            sigma = scaled(std, factor) if ends(std)[1] > 0 else usual["position"] * more
            changes = {"noise": _replaced(base.noise, position=replace(noise, sigma=sigma, density=0.0, snr_db=None))}
        case "elastic":  # half the stiffness, of joints and of links
            powers = {("joint", "stiffness"): -1.0, ("joint", "frequency"): -0.5, ("link", "frequency"): -0.5}
            changes = {
                name: _replaced(record, **{field: scaled(numbers, factor**power)})
                for (name, field), power in powers.items()
                if (record := getattr(base, name)) is not None and (numbers := getattr(record, field)) is not None
            }
        case "torque constant":
            low, high = ends(actuator.gain)
            changes = {"actuator": _replaced(actuator, gain=uniform(max(low - 0.2 * more, 0.0), high + 0.2 * more))}
        case "data sheet":
            changes = _off(base, 1.4 if factor >= 2 else 1.2, 0.25 * factor)
        case _:
            changes = {"actuator": _replaced(actuator, torque_limit=_scarce_torque(base))}
    try:
        return base.replace(**changes)
    except ValueError:  # such as of a lighter link, which is faster on its spring
        if kind == "elastic":  # the links would bend too far
            return base
        return base.replace(physics_dt=base.physics_dt / 2, **changes)


def _off(base: Scenario, times: float, samples: float) -> dict[str, Any]:
    """Return options whose truth lies on both sides of what policies are told, which stays.

    Args:
        base: the scenario.
        times: lag and stiffness are so many times what is told, or that part of it.
        samples: the delay differs by so much of a control step.
    """
    drive = base.actuator
    delay, more = middle(drive.delay), samples * base.control_dt
    ends_of_delay = [round(x / base.physics_dt) * base.physics_dt for x in (max(delay - more, 0.0), delay + more)]
    drive = replace(drive, delay=Distribution(choice=tuple(ends_of_delay)))
    sheet: dict[str, Any] = {"delay": sum(base.actuator.facts(base)["delay"]) / 2}
    if lag := middle(drive.lag):
        drive, sheet["lag"] = replace(drive, lag=Distribution(choice=(lag / times, lag * times))), lag
    changes: dict[str, Any] = {"actuator": drive}
    joint: Any = base.joint
    if joint is not None:
        name = "stiffness" if joint.frequency is None else "frequency"
        power = 1.0 if name == "stiffness" else 0.5
        each = [middle(x) for x in getattr(joint, name)]
        off = tuple(Distribution(choice=(x / times**power, x * times**power)) for x in each)
        changes["joint"] = replace(joint, **{name: off})
        both = zip(*joint.facts(base)["stiffness"], strict=True)
        sheet["stiffness"] = tuple(math.sqrt(low * high) for low, high in both)
    stated = {name: x for name, x in vars(base.datasheet or Datasheet()).items() if x is not None}
    return {**changes, "datasheet": Datasheet(**sheet | stated)}


def _scarce_torque(base: Scenario, episodes: int = 8) -> tuple[float, float]:
    """Return torque limits that the nominal motion exceeds in about a tenth of the samples [N m].

    They exceed the arm's weight by a tenth, and no limit is above the given one. As everywhere in
    the classes, an arm in a horizontal plane has the torque of an acceleration as its weight.
    """
    motion = reference_motion(base, SPLITS["test"][:episodes])[:, :-1]
    torques = np.abs(inverse_dynamics(base.arm, *motion))
    limit = np.maximum(np.quantile(torques, 0.9, axis=(0, 1)), 1.1 * _weight(base.arm))
    given = base.actuator.torque_limit
    return tuple(limit if given is None else np.minimum(limit, given))


def _weight(arm: ArmParameters) -> Array:
    """Return the largest torques of gravity, or of an acceleration of `LEAST`, [2] N m."""
    return np.maximum(np.abs(gravity_torque(arm, (0.0, 0.0))), LEAST * stretched_inertia(arm))


def _replaced(record: Any, **changes: Any) -> Any:
    """Return a record with other fields, or their plain data where there is no record."""
    return changes if record is None else replace(record, **changes)


def _larger(record: Any, usual: Any, names: Sequence[str], factor: float) -> Any:
    """Return a record with some fields times a factor; without one, the usual times factor - 1."""
    if record is None:
        record, factor = usual, factor - 1.0
    return replace(record, **{name: scaled(getattr(record, name), factor) for name in names})


def candidates(robots: Sequence[str]) -> list[str]:
    """Return the policies that are tried by default: all of those that do not know the truth.

    Laws also have the gains for some classes of robots. `OTHER_TASKS` are left out.
    """
    without = ("zero", *OTHER_TASKS)
    known = (*controllers.names(), *(name for robot in robots for name in controllers.tuned(robot)))
    return [name for name in known if (spec := resolve(name)).ranked and spec.parsed.source not in without]


@dataclass(frozen=True)
class Choice:
    """A policy in the scenario and its conditions.

    Attributes:
        policy: its name.
        safe: True if it is, by `RULE`.
        errors_pct: error of each run [conditions x seeds] %.
        lost: 1 where the run diverged, else 0 [conditions x seeds].
        effort: variation of the torque, relative to that of the calmest policy that is recommended.
        phase_deg: phase margin; NaN: unknown.
        delay_samples: delay margin in control steps; NaN: unknown.
        remark: on the margins, such as the reason why they are unknown.
        same: other policies with the same runs, bit for bit.
    """

    policy: str
    safe: bool
    errors_pct: Array
    lost: Array
    effort: float
    phase_deg: float = math.nan
    delay_samples: float = math.nan
    remark: str = ""
    same: tuple[str, ...] = ()


@dataclass(frozen=True)
class Recommendation:
    """The policies to use, the best first.

    Attributes:
        scenario: its name.
        choices: up to three policies of different laws: the safe ones, then those with too small
            margins; if there is none, the best ones.
        conditions: names of the conditions.
        failed: policies that failed, each with the error.
    """

    scenario: str
    choices: tuple[Choice, ...]
    conditions: tuple[str, ...]
    failed: dict[str, str]

    @property
    def safe(self) -> bool:
        """True if there is a policy to use."""
        return any(choice.safe for choice in self.choices)


def recommend(
    base: Scenario, policies: Sequence[str], number: int, run: Run, tune: Tune | None = None,
    bounds: tuple[float, float] = (LEAST_PHASE, LEAST_DELAY),
) -> Recommendation:  # fmt: skip
    """Return the best three of some policies on the arm of a scenario, on a number of test seeds.

    With `tune`, the laws with new gains compete, too. `bounds` are the least phase margin [degrees]
    and delay margin [samples] of a safe policy.

    Raises:
        ValueError: every policy failed.
    """
    results: dict[str, Result] = {}
    known = {spec.name: spec for spec in map(resolve, policies)}  # with the trust in them
    (base,) = distinguish((base,))  # the name that its cells have

    def measured(names: Sequence[str], *tasks: Scenario) -> list[Result]:
        cells = Suite("recommend", tuple(known.get(name, name) for name in names), tasks, number).cells
        results.update((result.cell.id, result) for result in run(cells).values())
        return [results[cell.id] for cell in cells]

    screened = measured(policies, base)
    names = _best(screened)
    if tune is not None and (tuned := tune([x for x in names if x not in known or not known[x].external])):
        names = _best([*screened, *measured(tuned, base)])
    tasks = around(base)
    measured(names[:SCREENED], *tasks.values())
    failed = {result.cell.policy.name: result.error for result in results.values() if result.error}
    complete = [name for name in names[:SCREENED] if name not in failed]
    table = [[results[f"{name}/{task.name}"] for task in tasks.values()] for name in complete]
    board = assemble([result for row in table for result in row])
    margins = [margins_of(known.get(name, name), base) for name in complete]
    wide = [not (phase < bounds[0] or delay < bounds[1]) for phase, delay, _ in margins]
    keeps = [is_safe(row[:1]) and is_safe(row) for row in table]
    safe = [x and y for x, y in zip(wide, keeps, strict=True)]
    levels = np.minimum(_levels(board), np.log(board.runs["baseline_error_pct"]).mean(axis=-1))
    levels = levels[:, 0] + levels[:, 1:].mean(axis=1)
    order = sorted(np.argsort(levels).tolist(), key=lambda i: not safe[i])
    same = _groups([i for i in order if keeps[i] or not any(keeps)], board, safe)
    best = [*same][:3]
    variation = np.median(board.runs["variation"], axis=(1, 2))
    calmest = min(filter(None, variation[best]), default=1.0)  # a policy without a torque has none
    errors, lost = board.errors, board.runs["diverged"]
    choices = [
        Choice(
            complete[i], safe[i], errors[i], lost[i], float(variation[i] / calmest), *margins[i],
            tuple(complete[k] for k in same[i]),
        ) for i in best
    ]  # fmt: skip
    return Recommendation(base.name, tuple(choices), tuple(tasks), failed)


def _levels(board: Board) -> Array:
    """Return the logarithm of each policy's penalized error [policies x scenarios]."""
    return np.log(penalize(board.errors, board.runs["diverged"])).mean(axis=-1)


def _best(results: Sequence[Result]) -> list[str]:
    """Return the policies that did not fail, the best in the scenario first."""
    board = assemble(results)
    return [board.policies[i] for i in np.argsort(_levels(board)[:, 0])]


def _groups(order: Sequence[int], board: Board, safe: Sequence[bool]) -> dict[int, list[int]]:
    """Return the first policy of each law, in an order, and with it the others with its runs."""
    groups: dict[int, list[int]] = {}
    laws = [spec.parsed.law for spec in board.specs]
    for i in order:
        twins = [k for k in groups if np.array_equal(board.errors[i], board.errors[k]) and safe[k] == safe[i]]
        if twins:
            groups[twins[0]].append(i)
        elif all(laws[i] != laws[k] for k in groups):
            groups[i] = []
    return groups


def margins_of(policy: PolicySpec | str, base: Scenario) -> tuple[float, float, str]:
    """Return phase margin [degrees] and delay margin [samples], and a remark; NaN: unknown."""
    spec = resolve(policy)
    try:
        margins = spec.call(margins_as_data, spec, base)
    except (ValueError, Failed) as problem:  # of an external policy, an `Unstable` arrives as its text alone
        unknown = 0.0 if UNSTABLE in str(problem) else math.nan
        return unknown, unknown, str(problem)
    return min(margins["phase"]), margins["delay"] / base.control_dt, ""


def is_safe(results: Sequence[Result]) -> bool:
    """Return True if a policy is safe by `RULE`, from its results in some conditions together."""
    runs = [run for result in results for run in result.rows]
    names = ("diverged", "error_pct", "baseline_error_pct")
    diverged, error, baseline = np.array([[run[name] for name in names] for run in runs]).T
    share = proportion(diverged.sum(), len(diverged)).low
    return bool(share <= SAFE_DIVERGED and np.log(error / baseline).mean() < np.log(SAFE_ERROR))
