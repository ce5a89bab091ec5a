"""The fit of an arm to logs: output error over windows, terms by held-out windows, intervals.

Each window starts in its measured state, which is corrected within its spread; each log has its own
zeros of the angles, as drives are often zeroed where the arm happens to rest.
"""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.identification.logs import Log
from benchmarks.identification.model import INDEX, PARAMETERS, Windows, arm_of, parameters_of, regress, windows
from fbl_gym.model.arm import Array
from fbl_gym.scenarios import Scenario

#: Terms that stay if they lower the error of windows that were not fitted.
TERMS = {"stiction": ("stiction 1", "stiction 2"), "lag": ("lag",)}

STEP = 0.03  # change of a scaled number for a derivative: across many stops of the joints, since these are not smooth
ZERO_SPREAD = 0.1  # standard deviation of a log's zero of the angles, before its motion is known [rad]
LOWERS = 0.98  # a term stays if the median held-out error falls to this share, and no fold's rises by over 1 %
FOLDS = 6  # most parts of the logs that are held out in turn
PRECISION = 2e-4  # error of the scaled numbers by the steps of the simulation, measured on arms that are known
BLOCK = 1.0  # length of the parts of one or two logs that are left out in turn [s]
LEAST_MOTION = 0.01  # least range of an angle; below it, the arm rests and its encoder flickers [rad]
UNLIKE = 0.3  # largest error of an angle relative to standing still: 0.05 for two real arms, 0.45 and more for nonsense
PLAUSIBLE, LIKELY = 5.0, 20.0  # largest ratios of fitted numbers to those of the start, of both links and of link 2
UNLIKE_WEIGHT = 3.5  # the same of inertias, and of inertias per weight: a clock off by 2 changes both by 4

# Share of the torques that the first fit leaves, beyond which signs, zeros and units are tried.
# It is 0.1 for simulated arms, and 0.2 to 0.4 for logs of two real ones.
UNEXPLAINED = 0.6

# Error of a log by the model of all logs, relative to its own model's, beyond which robots differ.
# It is below 2 for each log of two real arms, and 3.9 and more if logs of both are mixed.
MIXED = 3.0

CHECK = (
    "Check units (s, rad and N m; degrees and amperes by --signals position=deg torque=0.1*A), signs, zeros (--zero), "
    "the order of the joints, whether position 2 counts from link 1, the lengths of --start; or give logs of larger "
    "motions"
)

#: What a log may have wrong, by the words for what is to be checked.
MISTAKES = tomllib.loads(Path(__file__).with_name("mistakes.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Fit:
    """An identified arm.

    Attributes:
        parameters: the estimate [16]; see `model.PARAMETERS`.
        free: names of the parameters that were estimated.
        interval: both ends of each parameter's 90 % interval [16 x 2]; see `draws`.
        zero: angles at which each log's readings are zero [logs x 2] rad.
        weak: estimated parameters that the logs hardly tell, each with the motion that would.
        trials: held-out error with each term, relative to that without it.
        passive: joints without torque, whose gain is not told: 1, 2 or none.
        errors: at the ends of windows of 0.5 s [windows x 2] rad: of the arm, of the one to start
            from, and of one that stands still.
    """

    parameters: Array
    free: tuple[str, ...]
    interval: Array
    zero: Array
    weak: dict[str, str]
    trials: dict[str, float]
    passive: tuple[int, ...]
    errors: dict[str, Array]

    def estimates(self) -> list[tuple[str, float, Array]]:
        """Return name, estimate and interval [2] of each estimated parameter."""
        rows = zip(PARAMETERS, self.parameters, self.interval, strict=True)
        return [row for row in rows if row[0] in self.free]


@dataclass(frozen=True)
class _Problem:
    """Least squares over windows.

    Its unknowns x are the free parameters by their scale, then the zeros of each log by
    `ZERO_SPREAD`. Both have a prior as wide as their scale.
    """

    data: Windows
    free: tuple[str, ...]
    first: Array
    tie: float
    scale: Array

    def on(self, windows: Array, **changes: Any) -> "_Problem":
        """Return the problem of some windows, by a mask."""
        return replace(self, data=self.data.take(windows), **changes)

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Return parameters [m x 16] and zeros [m x logs x 2] of unknowns [m x n]."""
        p, indices = np.tile(self.first, (len(x), 1)), [INDEX[name] for name in self.free]
        p[:, indices] = x[:, : len(indices)] * self.scale[indices]
        if self.tie:
            p[:, 2] = self.tie * p[:, 4]
        return p, x[:, len(indices) :].reshape(len(x), -1, 2) * ZERO_SPREAD

    def error(self, x: Array, moved: Array | float = 0.0) -> Array:
        """Return simulated less measured positions [m x windows x k x 2]; states move by [4]."""
        p, zero = self.unpack(x)
        return self.data.simulate(p, zero[:, self.data.log], self.data.state + moved) - self.data.measured

    def solve(self, rounds: int, evaluations: int, size: Array) -> tuple[Array, Array, Array, Array]:
        """Return the solution, its residuals, their derivative and the size of the errors [k x 2].

        Errors are relative to a size, first the given one, then that of the errors of each round.
        """
        indices, zeros = [INDEX[name] for name in self.free], 2 * (int(self.data.log[-1]) + 1)
        x = prior = np.r_[np.maximum(self.first[indices] / self.scale[indices], 1e-3), np.zeros(zeros)]
        for _ in range(rounds):
            x, residual, table, left = self._round(x, prior, size, evaluations)
            spread = 1.4826 * np.median(np.abs(left), axis=0)
            size = np.maximum(spread, np.maximum(0.1 * spread.max(axis=0), 1e-4))
        return x, residual, table, size

    def _round(self, x: Array, prior: Array, size: Array, evaluations: int) -> tuple[Array, Array, Array, Array]:
        """Return solution, residuals, their derivative, and the errors [windows x k x 2] left."""
        data, n, k = self.data, len(self.free), len(self.data.keep)
        low = np.where(np.arange(len(x)) < n, 0.0, -np.inf)
        moves = np.zeros((n + 2, len(x)))  # the zeros of all logs at once
        moves[:n, :n], moves[n, n::2], moves[n + 1, n + 1 :: 2] = STEP * np.eye(n), STEP, STEP
        states = 0.5 * np.diag(data.spread)
        to_state = np.stack([(self.error(x[None], s) - self.error(x[None], -s))[0] for s in states], axis=-1)
        rows = to_state / (data.spread * size[..., None] * np.sqrt(k))
        weights = np.broadcast_to(np.diag(1.0 / data.spread), (len(rows), 4, 4))
        basis = np.linalg.qr(np.concatenate([rows.reshape(-1, 2 * k, 4), weights], axis=1))[0]

        def without_state(errors: Array) -> Array:
            """Return scaled errors [windows x (2 k + 4) x m] less what the state explains."""
            scaled = (errors / size / np.sqrt(k)).reshape(*errors.shape[:2], 2 * k)
            full = np.moveaxis(np.concatenate([scaled, np.zeros((*scaled.shape[:2], 4))], axis=-1), 0, -1)
            return full - basis @ (basis.transpose(0, 2, 1) @ full)

        def residual(x: Array) -> Array:
            return np.r_[without_state(self.error(x[None])).ravel(), x - prior * (low == 0)]

        def derivative(x: Array) -> Array:
            up, down = x + moves, np.maximum(x - moves, low)
            slope = (self.error(up) - self.error(down)) / (up - down).max(axis=1)[:, None, None, None]
            moved, logs = without_state(slope), np.arange(len(x) - n) // 2
            zeros = np.where(data.log[:, None, None] == logs, np.tile(moved[..., n:], len(logs) // 2), 0.0)
            table = np.concatenate([moved[..., :n], zeros], axis=-1)
            return np.concatenate([table.reshape(-1, len(x)), np.eye(len(x))])

        ends: dict[str, Any] = {"max_nfev": evaluations, "xtol": 1e-6, "ftol": 1e-6}
        found = least_squares(residual, x, derivative, (low, np.inf), loss="soft_l1", f_scale=0.5, **ends)
        left = without_state(self.error(found.x[None]))[:, : 2 * k, 0].reshape(-1, k, 2) * size * np.sqrt(k)
        return found.x, found.fun, derivative(found.x), left

    def fitted(self, evaluations: int, size: Array) -> tuple[Array, Array]:
        """Return the parameters [16] of one round, and the errors left [windows x k x 2]."""
        x = self.solve(1, evaluations, size)[0][None]
        return self.unpack(x)[0][0], self.error(x)[0]

    def draws(self, x: Array, residual: Array, table: Array, number: int = 2000) -> Array:
        """Return parameters [number x 16] that scatter as the fits without one part do (jackknife).

        Parts are the logs, of three or more, since errors of the model repeat within a log; else
        blocks. Few parts scatter as Student's t. The fits are linearised.
        """
        count, n = len(self.data.start), len(x)
        weight = 1.0 / np.sqrt(1.0 + (residual[:-n] / 0.5) ** 2)
        rows = table[:-n].reshape(count, -1, n)
        weighted = rows * weight.reshape(count, -1, 1)
        part = self.data.log.astype(int)
        if part.max() < 2:
            part = np.unique(part * 100_000 + (self.data.time / BLOCK + 1e-9).astype(int), return_inverse=True)[1]
        parts = int(part.max()) + 1
        slopes, bends = np.zeros((parts, n)), np.zeros((parts, n, n))
        np.add.at(slopes, part, np.einsum("wri,wr->wi", weighted, residual[:-n].reshape(count, -1)))
        np.add.at(bends, part, np.einsum("wri,wrj->wij", weighted, rows))
        bend = bends.sum(axis=0) - bends + np.eye(n)
        moved = np.linalg.solve(bend, (slopes - slopes.mean(axis=0))[..., None])[..., 0]
        generator = np.random.default_rng(0)
        wide = np.sqrt((parts - 1) ** 2 / parts / generator.chisquare(parts - 1, (number, 1)))
        blur = PRECISION * generator.normal(size=(number, n)) * (np.arange(n) < len(self.free))
        return self.unpack(x + wide * generator.normal(size=(number, parts)) @ moved + blur)[0]


def _scale(logs: Sequence[Log], first: Array) -> Array:
    """Return the size of each parameter [16], to which its prior is as wide."""
    torque = max(float(np.mean([np.abs(log.torque).mean() for log in logs])), 1e-9)
    speed = max(float(np.mean([np.abs(log.smooth[:, 2:]).mean() for log in logs])), 1e-9)
    small = [first[1], torque, torque, torque / speed, torque / speed, torque, torque, 1.0, 1.0, 0.02, 0.02]
    return np.r_[np.maximum(np.abs(first[:5]), 1e-9), small]


def identify(logs: list[Log], start: Scenario, tick: Callable[[str], object] = str) -> Fit:
    """Return the arm of some logs, from the scenario of a similar one, whose lengths are true.

    The gain of joint 2 is that of `start`, or that of joint 1 if joint 2 has no torque: masses,
    friction and gains share one scale.

    Args:
        logs: of one arm, at one rate.
        start: the arm to start from; its lengths, gravity and first rotor are kept.
        tick: called `len(TERMS) + 3` times with words for what is done next.

    Raises:
        ValueError: the logs have no torque or no motion, are of several robots, or fit far better
            with other signs, zeros or units.
    """
    gravity, given, passive = start.arm.gravity, parameters_of(start), _passive(logs, start)
    if gravity > 0 and min(given[3:5]) <= 0:
        raise ValueError(
            f"--start must have its weight beyond both joints (p4 and p5 above 0), got {given[3:5].round(4)}"
        )
    tie = start.arm.L1 / gravity if gravity > 0 else 0.0
    fixed = {"gain 2", *("gain 1" for _ in passive), *(("p3",) if gravity > 0 else ("p4", "p5"))}.union(*TERMS.values())
    free = tuple(name for name in PARAMETERS if name not in fixed)
    tick("first fit")
    first, share = regress(logs, start)
    _refuse_mistakes(logs, share, lambda logs: regress(logs, start, (first[INDEX["delay"]],))[1])
    data = windows(logs, every=0.5, substeps=2)
    problem = _Problem(data, free, first, tie, _scale(logs, first))
    x, _, _, size = problem.solve(3, 15, np.full((len(data.keep), 2), 0.05))
    problem = replace(problem, first=problem.unpack(x[None])[0][0])
    # Few logs are judged and held out in thirds.
    part = data.log if len(logs) > 2 else 3 * data.log + (2.999 * data.time / data.time.max()).astype(int)
    ratios = []
    for k in np.unique(part):
        models = [problem.on(part == k, free=names).fitted(8, size) for names in ((), free)]
        errors = [np.abs(error).mean(axis=(0, 1)) + 1e-4 for _, error in models]
        ratios.append(np.exp(np.log(errors[0] / errors[1]).mean()))
    if (worst := max(ratios)) > MIXED:
        name = logs[data.log[part == np.unique(part)[np.argmax(ratios)]][0]].name
        part_of = "a third of " if len(logs) < 3 else ""
        alone = f"a model of {part_of}{name} alone has errors {worst:.1f} times smaller than the model of all logs"
        raise ValueError(f"logs must be of one robot that does not change, in the right units, but {alone}")
    tick("held-out error")
    least, trials = _held_out(problem, part % FOLDS, size), {}
    for term, names in TERMS.items():
        tick(term)
        longer = replace(problem, free=(*problem.free, *names))
        error = _held_out(longer, part % FOLDS, size)
        trials[term] = float(np.median((error + 1e-12) / (least + 1e-12)))
        if trials[term] < LOWERS and (error < 1.01 * least).all():
            problem, least = longer, error
    tick("intervals")
    free, last = problem.free, replace(problem, data=windows(logs))
    x, residual, table, _ = last.solve(2, 15, size)
    (parameters,), (zero,) = last.unpack(x[None])
    draws = last.draws(x, residual, table)
    interval = np.maximum(np.quantile(draws, (0.05, 0.95), axis=0), 0.0).T
    wide = draws.std(axis=0) > 0.3 * np.maximum(np.abs(parameters), 0.1 * last.scale)
    weak = {name: motion for name, motion in PARAMETERS.items() if name in free and wide[INDEX[name]]}
    base = last.data.simulate(given[None], np.zeros((1, len(last.data.log), 2)), last.data.state)[0]
    ends = {
        "this model": last.error(x[None])[0, :, -1],
        "starting model": (base - last.data.measured)[:, -1],
        "standing still": standing_still(last.data),
    }
    return Fit(parameters, free, interval, zero, weak, trials, passive, ends)


def standing_still(data: Windows) -> Array:
    """Return the errors of an arm that stands still, at the ends of windows [windows x 2]."""
    return data.state[:, :2] - data.measured[:, -1]


def _passive(logs: Sequence[Log], start: Scenario) -> tuple[int, ...]:
    """Return the joints without torque or a drive; refuse arms at rest, and logs without torque."""
    moved = np.array([np.ptp(log.smooth[:, :2], axis=0) for log in logs])
    for log, change in zip(logs, moved, strict=True):
        if change.max() < LEAST_MOTION:
            raise ValueError(f"{log.name}: the arm must move, but rests: its angles change by {change.round(5)} rad")
    for joint in np.flatnonzero(moved.max(axis=0) < LEAST_MOTION):
        raise ValueError(f"joint {joint + 1} must move in some log, but rests, as in {logs[0].name}")
    torque = np.max([np.abs(log.torque).mean(axis=0) for log in logs], axis=0)
    if not torque.any():
        raise ValueError(f"torques must not all be zero, as in {logs[0].name}: name the commands' columns by --signals")
    limit: Any = start.actuator.torque_limit
    passive = np.flatnonzero(torque < 1e-3 * torque.max())
    for joint in passive:
        if limit is None or limit[joint] > 0:
            advice = "name its column by --signals, or give --start an actuator.torque_limit of 0 there"
            raise ValueError(f"torque {joint + 1} is zero in all logs, but --start has a drive there: {advice}")
    return tuple(int(joint) + 1 for joint in passive)


def _refuse_mistakes(logs: list[Log], share: float, unexplained: Callable[[list[Log]], float]) -> None:
    """Raise an error if the logs fit far better with other signs, zeros, units or another order."""
    if share < UNEXPLAINED:
        return
    shares = {}
    for name, undo in MISTAKES.items():
        turn, zero, push = undo.get("position", np.eye(2)), undo.get("zero", 0.0), undo.get("torque", np.eye(2))
        undone = [replace(log, position=log.position @ turn + zero, torque=log.torque @ push) for log in logs]
        shares[name] = unexplained(undone)
    best = min(shares, key=lambda name: shares[name])
    if shares[best] < 0.5 * share:
        changed = f"{100 * shares[best]:.0f} % with one change: check {best}"
        raise ValueError(f"the logs leave {100 * share:.0f} % of the torques unexplained, and {changed}")


def refuse_meaningless(fit: Fit, start: Scenario, names: Sequence[str]) -> None:
    """Raise an error if a fit explains no motion, or has numbers of no arm like the start.

    Args:
        fit: to judge.
        start: the scenario that it started from.
        names: of the logs.
    """
    error, base, _ = (float(np.median(np.hypot(*errors.T))) for errors in fit.errors.values())
    reasons = ["its error is larger than that of the starting model"] * (error > 1.05 * base)
    left, _, still = (np.abs(errors).mean(axis=0) for errors in fit.errors.values())
    for joint in np.flatnonzero(left > UNLIKE * still):
        reasons.append(f"its angle {joint + 1} errs {left[joint] / still[joint]:.2f} times as much as standing still")
    given, masses = parameters_of(start), ("p4", "p5") if start.arm.gravity > 0 else ("p1", "p2")
    for name in (*masses, "gain 1"):
        ratio = fit.parameters[INDEX[name]] / given[INDEX[name]] if given[INDEX[name]] > 0 else 1.0
        most = LIKELY if name == masses[1] else PLAUSIBLE
        if not 1 / most < ratio < most:
            reasons.append(f"{name} is {ratio:.3g} times that of --start")
    for inertia, weight in zip(("p1", "p2"), masses, strict=True) if start.arm.gravity > 0 else ():
        ratio, heavier = (fit.parameters[INDEX[name]] / max(given[INDEX[name]], 1e-12) for name in (inertia, weight))
        if min(ratio, ratio / heavier) > UNLIKE_WEIGHT or max(ratio, ratio / heavier) < 1 / UNLIKE_WEIGHT:
            reasons.append(f"{inertia} is {ratio:.3g} times that of --start, unlike {weight}: is time in s?")
    for name, zero in zip(names, fit.zero, strict=True):
        if np.abs(zero).max() > 3 * ZERO_SPREAD:
            reasons.append(f"the zeros of {name} are off by {zero[0]:.4f} and {zero[1]:.4f} rad: add them to --zero")
    try:
        arm_of(fit.parameters, start.arm)
    except ValueError:
        reasons.append("no two links have its inertias, of which p1 p2 must exceed the square of p3")
    if reasons:
        raise ValueError(f"the fit is refused: {'; '.join(reasons)}. {CHECK}")


def _held_out(problem: _Problem, fold: Array, size: Array) -> Array:
    """Return the error of windows of each fold [folds], by the fit to the other folds."""
    costs = []
    for k in np.unique(fold):
        parameters, _ = problem.on(fold != k).fitted(8, size)
        _, errors = problem.on(fold == k, free=(), first=parameters).fitted(6, size)
        costs.append(np.mean(np.sqrt(1.0 + (errors / size) ** 2) - 1.0))
    return np.array(costs)


def rollout_errors(log: Log, parameters: Array, length: float, zeros: bool = True) -> tuple[Array, Windows, Array]:
    """Return the errors at the ends of open-loop windows [windows x 2] rad.

    Args:
        log: not one of those fitted.
        parameters: [16].
        length: of the windows, which start each 0.25 s [s].
        zeros: estimate the log's zeros for each window, from those that ended before it.

    Returns:
        The errors, the windows, and the simulated positions [windows x k x 2].
    """
    data, step = windows([log], length), 0.01
    zero = np.zeros((1, len(data.start), 2))
    if zeros:
        shift = step * np.array([(0, 0), (1, 0), (0, 1)])[:, None] + zero
        sim = data.simulate(np.tile(parameters, (3, 1)), shift, data.state)
        left, slope = data.measured - sim[0], np.moveaxis(sim[1:] - sim[0], 0, -1) / step
        size = 1.4826 * np.median(np.abs(left), axis=0) + 1e-4
        for w, time in enumerate(data.time):
            before = data.time <= time - length + 1e-9
            r, rows = (left / size)[before].ravel(), (slope / size[..., None])[before].reshape(-1, 2)
            for _ in range(4):
                weighted = rows.T / np.sqrt(1.0 + (r - rows @ zero[0, w]) ** 2) / len(data.keep)
                zero[0, w] = np.linalg.solve(weighted @ rows + np.eye(2) / ZERO_SPREAD**2, weighted @ r)
    sim = data.simulate(parameters[None], zero, data.state)[0]
    return sim[:, -1] - data.measured[:, -1], data, sim
