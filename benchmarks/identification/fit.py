"""The fit of an arm to logs: output error over windows, terms by held-out windows, intervals.

Each window starts in its measured state, which is corrected within its spread; each log has its own
zeros of the angles, as drives are often zeroed where the arm happens to rest.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from benchmarks.identification.logs import Log
from benchmarks.identification.model import INDEX, Windows, parameters_of, regress, windows
from fbl_gym.model.arm import Array
from fbl_gym.scenarios import Scenario

TERMS = {
    "rotor": ("rotor 2",), "gain": ("gain 1",), "viscous": ("viscous 1", "viscous 2"),
    "stiction": ("stiction 1", "stiction 2"), "lag": ("lag",),
}  # fmt: skip
"""Terms that stay if they lower the error of windows that were not fitted."""

STEP = 0.03
"""Change of a scaled number for a derivative: across many stops of the joints, which are no smooth
functions of the numbers."""

ZERO_SPREAD = 0.1
"""Standard deviation of a log's zero of the angles, before its motion is known [rad]."""

LOWERS = 0.98
"""A term must lower the held-out error to this share, in the median over the folds."""

FOLDS = 6
"""Most parts of the logs that are held out in turn."""

EXCITE = {
    "p": "moves of both joints together and against each other, fast and through large angles",
    "rotor": "fast reversals of joint 2 while joint 1 swings",
    "coulomb": "slow moves with many reversals of that joint",
    "viscous": "moves at several speeds of that joint, up to its fastest",
    "stiction": "starts from rest by slowly rising torques",
    "gain": "moves in which gravity and inertia load that joint",
    "delay": "jumps of the command",
    "lag": "jumps of the command",
}
"""The motion that identifies a number, by the first word of its name."""


@dataclass(frozen=True)
class Fit:
    """An identified arm.

    Attributes:
        parameters: the estimate [16]; see `model.PARAMETERS`.
        free: names of the parameters that were estimated.
        draws: estimates from resampled windows [draws x 16].
        zero: angles at which each log's readings are zero [logs x 2] rad.
        weak: estimated parameters that the logs hardly tell, each with the motion that would.
        trials: held-out error with each term, relative to that without it.
    """

    parameters: Array
    free: tuple[str, ...]
    draws: Array
    zero: Array
    weak: dict[str, str]
    trials: dict[str, float]

    def interval(self, level: float = 0.9) -> Array:
        """Return both ends of the interval of each parameter [16 x 2]."""
        tail = 0.5 * (1.0 - level)
        return np.quantile(self.draws, (tail, 1.0 - tail), axis=0).T


@dataclass(frozen=True)
class _Problem:
    """Least squares over windows: which numbers are free, and how large they may be."""

    data: Windows
    free: tuple[str, ...]
    first: Array
    tie: float
    scale: Array

    @property
    def logs(self) -> int:
        return int(self.data.log[-1]) + 1

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Return parameters [16] and zeros [logs x 2] of scaled numbers."""
        p, n = self.first.copy(), len(self.free)
        indices = [INDEX[name] for name in self.free]
        p[indices] = x[:n] * self.scale[indices]
        if self.tie:
            p[2] = self.tie * p[4]
        return p, x[n:].reshape(self.logs, 2) * ZERO_SPREAD

    def error(self, x: Array, steps: Array | None = None) -> Array:
        """Return simulated less measured positions [m x windows x k x 2].

        Variant 0 is x. The others move one number each by its step: the free ones, the zeros of
        both joints, and the state at the start.
        """
        many = 0 if steps is None else len(steps)
        p, zero = self.unpack(x)
        n = len(self.free)
        parameters = np.tile(p, (many + 1, 1))
        zeros = np.tile(zero[self.data.log], (many + 1, 1, 1))
        states = np.tile(self.data.state, (many + 1, 1, 1))
        for i in range(many):
            if i < n:
                moved = x.copy()
                moved[i] += steps[i]  # type: ignore[index]
                parameters[i + 1] = self.unpack(moved)[0]
            elif i < n + 2:
                zeros[i + 1, :, i - n] += steps[i]  # type: ignore[index]
            else:
                states[i + 1, :, i - n - 2] += steps[i]  # type: ignore[index]
        return self.data.simulate(parameters, zeros, states) - self.data.measured

    def solve(
        self, rounds: int = 3, evaluations: int = 15, start_size: Array | float = 0.05
    ) -> tuple[Array, Array, Array, Array]:
        """Return the solution, its residuals, their derivative and the size of the errors [k x 2].

        Errors are relative to a size, first the given one, then that of the errors of each round.
        """
        data, n, logs = self.data, len(self.free), self.logs
        k = len(data.keep)
        low = np.r_[np.zeros(n), np.full(2 * logs, -np.inf)]
        x = np.r_[
            self.first[[INDEX[name] for name in self.free]] / self.scale[[INDEX[name] for name in self.free]],
            np.zeros(2 * logs),
        ]
        x[:n] = np.maximum(x[:n], 1e-3)
        prior = x.copy()
        steps = np.r_[np.full(n, STEP), 0.1 * STEP, 0.1 * STEP, 0.5 * data.spread]
        size: Array = np.broadcast_to(start_size, (k, 2))
        for _ in range(rounds):
            e = self.error(x, steps)
            to_state = ((e[n + 3 :] - e[0]) / steps[n + 2 :, None, None, None] / size).transpose(1, 2, 3, 0) / np.sqrt(
                k
            )
            rows = np.concatenate(
                [to_state.reshape(-1, 2 * k, 4), np.broadcast_to(np.diag(1.0 / data.spread), (len(e[0]), 4, 4))], axis=1
            )
            basis = np.linalg.qr(rows)[0]

            def without_state(errors: Array, size: Array = size, basis: Array = basis) -> Array:
                """Return scaled errors [windows x (2 k + 4) x m] less what the state explains."""
                scaled = (errors / size[..., None] / np.sqrt(k)).reshape(len(errors), 2 * k, -1)
                full = np.concatenate([scaled, np.zeros((len(errors), 4, scaled.shape[-1]))], axis=1)
                return full - basis @ (basis.transpose(0, 2, 1) @ full)

            def residual(x: Array, project: Callable[..., Array] = without_state) -> Array:
                return np.r_[project(self.error(x)[0][..., None]).ravel(), x[:n] - prior[:n], x[n:]]

            def derivative(x: Array, project: Callable[..., Array] = without_state) -> Array:
                up, down = steps[: n + 2], steps[: n + 2].copy()
                down[:n] = np.minimum(down[:n], x[:n])  # no number is below 0
                slope = (self.error(x, up)[1:] - self.error(x, -down)[1:]) / (up + down)[:, None, None, None]
                moved = project(slope.transpose(1, 2, 3, 0))
                table = np.zeros((*moved.shape[:2], n + 2 * logs))
                table[..., :n] = moved[..., :n]
                for j in (0, 1):
                    table[np.arange(len(table)), :, n + 2 * data.log + j] = moved[..., n + j] * ZERO_SPREAD
                return np.concatenate([table.reshape(-1, n + 2 * logs), np.eye(n + 2 * logs)])

            solution = least_squares(
                residual, x, derivative, bounds=(low, np.inf), loss="soft_l1", f_scale=0.5, max_nfev=evaluations, xtol=1e-6,
                ftol=1e-6,
            )  # fmt: skip
            x = solution.x
            left = without_state(self.error(x)[0][..., None])[:, : 2 * k, 0].reshape(-1, k, 2) * size * np.sqrt(k)
            spread = 1.4826 * np.median(np.abs(left), axis=0)
            size = np.maximum(spread, np.maximum(0.1 * spread.max(axis=0), 1e-4))
        return x, solution.fun, derivative(x), size

    def draws(self, x: Array, residual: Array, table: Array, number: int = 400) -> Array:
        """Return solutions [number x len(x)] for resampled seconds of the logs, linearised."""
        windows, n = len(self.data.start), len(x)
        weight = 1.0 / np.sqrt(1.0 + (residual / 0.5) ** 2)
        per = (len(residual) - n) // windows
        _, block = np.unique(self.data.log * 10_000 + self.data.time.astype(int), return_inverse=True)
        slopes, bends = np.zeros((block.max() + 1, n)), np.zeros((block.max() + 1, n, n))
        for w in range(windows):
            rows = table[w * per : (w + 1) * per]
            weighted = rows * weight[w * per : (w + 1) * per, None]
            slopes[block[w]] += weighted.T @ residual[w * per : (w + 1) * per]
            bends[block[w]] += weighted.T @ rows
        generator = np.random.default_rng(0)
        counts = generator.multinomial(len(slopes), np.full(len(slopes), 1.0 / len(slopes)), size=number)
        # Residuals are smaller than errors, the more numbers are fitted to few seconds.
        grow = np.sqrt(len(slopes) / max(len(slopes) - n, 1))
        slope = counts @ slopes - slopes.sum(axis=0)
        bend = np.einsum("db,bij->dij", counts, bends) + np.eye(n)
        fixed = (x < 1e-6) & (np.arange(n) < len(self.free))  # at its bound
        bend[:, fixed, fixed] += 1e12
        return x - grow * np.linalg.solve(bend, slope[..., None])[..., 0]


def _scale(logs: Sequence[Log], first: Array) -> Array:
    """Return the size of each parameter [16], to which its prior is as wide."""
    torque = max(float(np.mean([np.abs(log.torque).mean() for log in logs])), 1e-9)
    speed = max(float(np.mean([np.abs(log.smooth[:, 2:]).mean() for log in logs])), 1e-9)
    small = [first[1], torque, torque, torque / speed, torque / speed, torque, torque, 1.0, 1.0, 0.02, 0.02]
    return np.r_[np.maximum(np.abs(first[:5]), 1e-9), small]


def _fit(
    logs: list[Log], free: Sequence[str], first: Array, tie: float, every: float, *known: Any
) -> tuple[_Problem, tuple[Array, ...]]:
    """Return a problem and its solution; see `_Problem.solve` for what is known."""
    problem = _Problem(windows(logs, every=every), tuple(free), first, tie, _scale(logs, first))
    return problem, problem.solve(*known)


def _held_out(folds: list[list[Log]], free: Sequence[str], first: Array, tie: float, size: Array) -> Array:
    """Return the error of windows of each fold [folds], by the fit to the other folds."""
    costs = []
    for fold in folds:
        others = [log for other in folds if other is not fold for log in other]
        problem, (x, *_) = _fit(others, free, first, tie, 0.5, 1, 8, size)
        judged, (zeros, *_) = _fit(fold, (), problem.unpack(x)[0], tie, 0.5, 1, 6, size)
        costs.append(np.mean(np.sqrt(1.0 + (judged.error(zeros)[0] / size) ** 2) - 1.0))
    return np.array(costs)


def identify(logs: list[Log], start: Scenario, tick: Callable[[str], object] = str) -> Fit:
    """Return the arm of some logs, from the scenario of a similar one, whose lengths are true.

    The gain of joint 2 is that of `start`: masses, friction and gains share one scale.

    Args:
        logs: of one arm, at one rate.
        start: the arm to start from; its lengths, gravity and first rotor are kept.
        tick: called `len(TERMS) + 2` times with words for what is done next.
    """
    gravity, tie = start.arm.gravity, start.arm.L1 / start.arm.gravity if start.arm.gravity > 0 else 0.0
    core = ("p1", "p2", *(("p4", "p5") if gravity > 0 else ("p3",)), "coulomb 1", "coulomb 2", "delay")
    first = regress(logs, parameters_of(start), start.arm.L1, gravity)
    parts = logs if len(logs) > 2 else [part for log in logs for part in _thirds(log)]
    folds = [parts[i::FOLDS] for i in range(min(FOLDS, len(parts)))]
    tick("core")
    problem, (x, _, _, size) = _fit(logs, (*core, "rotor 2"), first, tie, 0.5)
    first, trials = problem.unpack(x)[0], {}
    free = (*core, *TERMS["rotor"], *TERMS["gain"], *TERMS["viscous"])
    bare = first.copy()
    bare[[INDEX[name] for term in TERMS.values() for name in term]] = parameters_of(start)[
        [INDEX[name] for term in TERMS.values() for name in term]
    ]
    least = _held_out(folds, free, bare, tie, size)
    for term, names in TERMS.items():
        tick(term)
        other = tuple(name for name in free if name not in names) if names[0] in free else (*free, *names)
        error = _held_out(folds, other, bare, tie, size)
        trials[term] = float(np.median(least / error if names[0] in free else error / least))
        if (names[0] in free) != (trials[term] < LOWERS):
            free, least = other, error
    tick("intervals")
    problem, (x, residual, table, size) = _fit(logs, free, bare, tie, 0.25)
    parameters, zero = problem.unpack(x)
    draws = np.array([problem.unpack(draw)[0] for draw in problem.draws(x, residual, table)])
    spread = draws.std(axis=0)
    weak = {
        name: EXCITE["p" if name[0] == "p" else name.split()[0]]
        for name in free
        if spread[INDEX[name]] > 0.3 * max(abs(parameters[INDEX[name]]), 1e-12 + 0.1 * problem.scale[INDEX[name]])
    }
    return Fit(parameters, free, draws, zero, weak, trials)


def _thirds(log: Log) -> list[Log]:
    """Return the three parts of a log."""
    cuts = np.array_split(np.arange(len(log.position)), 3)
    return [
        dataclasses.replace(log, **{name: getattr(log, name)[cut] for name in ("position", "smooth", "torque")})
        for cut in cuts
    ]


def stiffness(logs: Sequence[Log], start: Scenario) -> Array:
    """Return the stiffness of both joints and its 90 % interval, from motors and links [2 x 3].

    The commanded torque, delayed as in `start`, is linear in spring, rotor and friction of the
    motor (equation of `fbl_gym.options.joints`).

    Raises:
        ValueError: a log has no positions of the links.
    """
    blocks: list[tuple[Array, Array]] = []
    for log in logs:
        if log.link is None:
            raise ValueError(f"stiffness needs positions of motors and links, but {log.name} has one of them")
        width = 2 * max(3, round(0.04 / log.dt)) + 1
        late = round(float(parameters_of(start)[INDEX["delay"]]) / log.dt)
        stretch, v, a, u = (
            savgol_filter(x, width, 3, d, log.dt, axis=0)[width:-width]
            for x, d in (
                (log.position - log.link, 0),
                (log.position, 1),
                (log.position, 2),
                (np.roll(log.torque, late, 0), 0),
            )
        )
        table = np.stack([stretch, a, v, np.tanh(v / 0.05), np.ones_like(v)], axis=-1)
        seconds = np.array_split(np.arange(len(v)), max(2, round(len(v) * log.dt)))
        blocks += [(table[second], u[second]) for second in seconds]
    bends = np.array([np.einsum("njx,njy->jxy", table, table) for table, _ in blocks])
    slopes = np.array([np.einsum("njx,nj->jx", table, torque) for table, torque in blocks])
    counts = np.random.default_rng(0).multinomial(len(blocks), np.full(len(blocks), 1 / len(blocks)), size=400)
    counts = np.concatenate([np.ones((1, len(blocks)), int), counts])
    draws = np.linalg.solve(
        np.einsum("db,bjxy->djxy", counts, bends), np.einsum("db,bjx->djx", counts, slopes)[..., None]
    )
    return np.column_stack([draws[0, :, 0, 0], *np.quantile(draws[1:, :, 0, 0], (0.05, 0.95), axis=0)])


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
    data = windows([log], length)
    step, n = 0.01, len(data.start)
    shift = np.zeros((3, n, 2))
    shift[1, :, 0] = shift[2, :, 1] = step
    sim = data.simulate(np.tile(parameters, (3, 1)), shift)
    left = data.measured - sim[0]
    slope = np.moveaxis(sim[1:] - sim[0], 0, -1) / step  # [windows x k x 2 x 2]
    size = 1.4826 * np.median(np.abs(left), axis=0) + 1e-4
    zero = np.zeros((1, n, 2))
    for w in range(n if zeros else 0):
        before = data.time <= data.time[w] - length + 1e-9
        r, rows = (left[before] / size).ravel(), (slope[before] / size[..., None]).reshape(-1, 2)
        for _ in range(4):
            weight = 1.0 / np.sqrt(1.0 + (r - rows @ zero[0, w]) ** 2) / len(data.keep)
            bend = (rows * weight[:, None]).T @ rows + np.eye(2) / ZERO_SPREAD**2
            zero[0, w] = np.linalg.solve(bend, rows.T @ (weight * r))
    sim = data.simulate(parameters[None], zero)[0]
    return sim[:, -1] - data.measured[:, -1], data, sim
