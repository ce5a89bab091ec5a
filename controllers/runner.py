"""A policy on a robot: `Runner` decides on a torque at each reading, as in the environment."""

import contextlib
import math
import os
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from time import perf_counter, sleep
from typing import Any, Self, TextIO

import numpy as np
from numpy.typing import ArrayLike

from controllers.name import PolicyName
from controllers.numerics.dynamics import inverse_dynamics
from controllers.registry import as_name, factory, make
from fbl_gym.envs.robot import Robot
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array, inertia_matrix
from fbl_gym.options import Friction
from fbl_gym.records.checks import Pair, check_number, check_pair
from fbl_gym.records.record import ends
from fbl_gym.scenarios import Scenario, as_scenario

#: The signals of a log, each with its unit in the names of the columns.
_UNITS = {"position": "rad", "velocity": "rad_s", "acceleration": "rad_s2", "reference": "rad", "torque": "Nm"}

#: A reading that stays the same is a fault once its joint must have turned by `TURNED`, or its
#: reference has gone on by `LEFT`, as shares of `max_error`.
TURNED, LEFT = 1 / 5, 1 / 2

#: Dry friction that any joint may have, as a share of its torque limit.
LEAST_FRICTION = 1 / 4


class Runner:
    """A policy in a loop that reads a robot and commands its torques.

    Call `step` once each `control_dt`, and command the torque that it returns. The observation has
    the bits that the environment of the scenario would give for the same readings. Before the first
    one, the arm counts as at rest, or at its measured velocity, under the torque that holds the
    nominal arm still.

    A run stops for good when a reading is late, not finite or of another shape; when a reading
    jumps, or stays the same although its joint must have moved; when a joint is farther than
    `max_error` from its reference, beyond the scenario's `limits.position`, or beyond constraints
    with `violation="end"`; or when the policy raises an exception of any kind. From then on, each
    step returns a torque that goes evenly to zero in the time `ramp`, then zeros. `stopped` says
    why. Only `reset` begins another run.

    A robot keeps the last torque that it got. So use the runner in a `with` block: however the
    block ends, the rest of the ramp is sent by `send`. Without one, call `stop` at the end, and go
    on with `step` while `stopping`.

    Args:
        policy: as for `controllers.make`, such as "computed-torque-dob@my_gains".
        scenario: the task: a `Scenario`, its name or its file. Its reference is not used, nor any
            option that only an arm in simulation has.
        send: function that commands a torque [2] N m, for the ramp at the end of a `with` block.
        log: CSV file of the run, which `fbl-gym identify` reads; None: there is none. Each step
            writes its line before it returns, so that a process that ends leaves a whole log. It
            ends where the run stops. It replaces an older file.
        ramp: time from the last torque to zero [s].
        max_error: largest distance of a joint from its reference [rad].
        max_velocity: largest velocity of a joint beyond that of its reference, one or two numbers
            [rad/s]; None: the velocity that the nominal arm can gain at its torque limits within
            `max_error` on both sides of the reference, 2 sqrt(a max_error). `a` is its largest
            acceleration with its weight on the drives' side, in any pose. In both cases, no joint
            may be faster than `limits.velocity`.
        max_interval: longest time between two readings [s]; None: twice `control_dt`.

    Attributes:
        interface: all that the policy knows.
        policy: the policy.
        control_dt: time between two steps [s].
        rows: of the reference that `step` takes: 1, and the coming samples that the policy uses.
        max_velocity: see above [2] rad/s.
        stopped: reason why the run stopped; empty while it goes on, and after an end as planned.
        log_error: reason why the log ended before the run, such as a full disk; empty: it did not.
    """

    def __init__(
        self,
        policy: str | PolicyName | Callable[..., Any],
        scenario: Scenario | str | Path,
        *,
        send: Callable[[Array], Any] | None = None,
        log: str | Path | None = None,
        ramp: float = 0.5,
        max_error: float = 0.5,
        max_velocity: Pair | float | None = None,
        max_interval: float | None = None,
    ) -> None:
        policy, self._scenario, self._send = as_name(policy), as_scenario(scenario), send
        dt = self.control_dt = self._scenario.control_dt
        maker = factory(policy)  # perhaps a bound method, as of a resolved policy
        self.rows = 1 + math.ceil(getattr(getattr(maker, "__self__", maker), "preview", 0.0) / dt - 1e-9)
        self._robot = Robot(self._scenario, self.rows - 1)
        self.interface = self._robot.interface
        self.policy = make(policy, self.interface)
        for path in policy.gains_of_other_arms(self._scenario.arm) if isinstance(policy, PolicyName) else []:
            warnings.warn(f"{path} has the gains of another arm than that of {self._scenario.name}", stacklevel=2)
        self._ramp_steps = max(1, math.ceil(check_number("ramp", ramp, low=0) / dt - 1e-9))
        self._max_error = check_number("max_error", max_error, above=0)
        self._max_interval = check_number("max_interval", 2 * dt if max_interval is None else max_interval, above=dt)
        self._model = _Model(self._scenario.friction or Friction(), self.interface)
        fastest = 2 * np.sqrt(self._model.acceleration * self._max_error)
        given = fastest if max_velocity is None else check_pair("max_velocity", max_velocity, above=0)
        self.max_velocity = np.minimum(given, self._scenario.limits.velocity)
        encoder = self._scenario.encoder
        self._lost = encoder.dropout_length if encoder is not None and ends(encoder.dropout)[1] > 0 else 0
        self._file: TextIO | None = None
        self._state: Any = None
        self._torque, self._left, self._goes_on = np.zeros(2), 0, True
        at_rest = np.zeros(2 * len(self._robot.needs))
        self._robot.start(at_rest)
        for k in range(3):  # compile all code now: a robot does not wait
            self._act(self._robot.observe(at_rest, np.zeros(6 * self.rows)), k == 0)
        self.reset(log)

    def __enter__(self) -> Self:
        if self._send is None:
            raise ValueError("send must be given in a `with` block: it sends the ramp at the block's end")
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None, place: Any) -> None:
        """Send the rest of the ramp, and close the log.

        Raises:
            BaseException: what `send` raised, or Ctrl-C meanwhile, once the ramp has been sent.
        """
        self.stop("" if problem is None else str(problem) or repr(problem))
        failure = None
        for _ in range(2 * self._left):  # a torque whose sending failed is sent again
            if self.stopping:
                try:
                    sleep(self.control_dt)
                    self._send(self._torque * ((self._left - 1) / self._ramp_steps))  # type: ignore[misc]
                    self._left -= 1
                except BaseException as error:  # also Ctrl-C: nothing but a finished ramp ends with torque
                    failure = error
        if failure is not None:
            raise failure

    def reset(self, log: str | Path | None = None) -> None:
        """Begin another run with the next step; the policy begins afresh.

        Args:
            log: of this run, as above.
        """
        self.close()
        self.stopped = self.log_error = ""
        self._last = math.nan
        if not self._goes_on:  # else the robot keeps the last torque
            self._torque = self._torque * (self._left / self._ramp_steps)
        self._left, self._goes_on = 0, True
        if log is not None:
            self._file = Path(log).open("w", 1, "utf-8", newline="\n")  # noqa: SIM115 - it is open between steps
            self._logged = 0  # bytes, as all lines are ASCII
            signals = (*self._scenario.sensors, "reference", "torque")
            columns = [f"{name}_{joint}_{_UNITS[name]}" for name in signals for joint in (1, 2)]
            self._write(["time_s", *columns])

    def stop(self, reason: str = "") -> None:
        """End the run: from now on, `step` returns the ramp. Without effect on a run that ended.

        Args:
            reason: text of `stopped`; empty: an end as planned.
        """
        if self._goes_on:
            self.stopped, self._goes_on = reason, False
            commanded = self._torque.any() or not math.isnan(self._last)
            self._left = self._ramp_steps if commanded else 0
            self.close()

    @property
    def stopping(self) -> bool:
        """Return True from the end of a run until its ramp has reached zero."""
        return self._left > 0

    def close(self) -> None:
        """Close the log."""
        if self._file is not None:
            with contextlib.suppress(OSError):  # a disk that is full is so again
                self._file.close()
        self._file = None

    def step(
        self,
        position: ArrayLike,
        reference: ArrayLike,
        *,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        time: float | None = None,
    ) -> Array:
        """Return the torque to command until the next reading [2] N m.

        Args:
            position: the reading, with the zero of this package's angles [2] rad.
            reference: position, velocity and acceleration of both joints [6] rad, rad/s, rad/s^2;
                for a policy with preview [rows x 6], now and at the coming steps.
            velocity: measured [2] rad/s; only if the scenario has the sensor, and its encoder
                computes none.
            acceleration: measured [2] rad/s^2; only if the scenario has the sensor.
            time: of the reading [s]; None: the time of this call.

        Raises:
            ValueError: the first reading of a run is wrong. Later, nothing is raised; see above.
        """
        if self._goes_on:
            try:
                given = {"position": position, "velocity": velocity, "acceleration": acceleration}
                return self._decide(given, reference, perf_counter() if time is None else time)
            except BaseException as problem:  # a loop that ends with an error leaves the last torque on the robot
                if math.isnan(self._last):
                    raise
                self.stop(str(problem) or repr(problem))
        self._left = max(self._left - 1, 0)
        return self._torque * (self._left / self._ramp_steps)

    def _decide(self, given: dict[str, ArrayLike | None], reference: ArrayLike, now: float) -> Array:
        """Return the torque, and log it.

        Raises:
            ValueError: the run must stop.
        """
        begins, needs = math.isnan(self._last), self._robot.needs
        for name, value in given.items():
            if (value is not None) != (name in needs):
                right = "be given" if name in needs else "not be given"
                raise ValueError(f"{name} must {right}: this scenario needs {' and '.join(needs)}")
        motion = np.concatenate([_numbers(name, given[name], 2) for name in needs])
        ahead = _numbers("reference", reference, 6 * self.rows)
        check_number("time", now)
        rounding = 2.0 * float(np.spacing(now))  # of this time and the last one, in the clock's precision
        now, late = float(now), self._max_interval + 1e-3 * self.control_dt + rounding
        if not (begins or 0.0 < now - self._last <= late):
            right = f"time must go on by at most {self._max_interval:g} s from reading to reading"
            raise ValueError(f"{right}, got {now:g} s after {self._last:g} s")
        position = motion[:2]
        if begins:
            self._begin, self._first = now, position
            self._robot.start(motion)
            self._model.start(position, ahead)
        observation = self._robot.observe(motion, ahead)
        self._check_place(position, ahead, observation)
        if not begins:
            self._check_motion(position, ahead, now - self._last)
        signals = np.concatenate([observation[0, : 2 * len(self._scenario.sensors)], ahead[:2]])
        torque = self._act(observation, begins)
        self._write(map(repr, [now - self._begin, *signals.tolist(), *torque.tolist()]))
        self._last, self._torque = now, torque
        return torque.copy()

    def _act(self, observation: Array, begins: bool) -> Array:
        """Return the torque of the policy, and let the control step pass."""
        state = None if begins else self._state
        action, self._state = self.policy.predict(observation, state, np.array([begins]), deterministic=True)
        return self._robot.command(_numbers("action", action, 2))

    def _write(self, cells: Iterable[str]) -> None:
        """Write a line of the log; where that fails, the log ends before it, and not the run."""
        if self._file is not None:
            path, line = self._file.name, ",".join(cells) + "\n"
            try:
                self._file.write(line)
                self._logged += len(line)
            except OSError as problem:
                self.log_error = str(problem)
                self.close()
                with contextlib.suppress(OSError):
                    os.truncate(path, self._logged)

    def _check_place(self, position: Array, reference: Array, observation: Array) -> None:
        """Raise a ValueError where a joint is beyond a limit."""
        limits, constraints = self._scenario.limits, self._scenario.constraints
        start = "start (limits.position)", self._first, limits.position
        for place, other, most in (("reference (max_error)", reference, self._max_error), start):
            for joint in (0, 1):
                if (far := abs(position[joint] - other[joint])) > most:
                    raise ValueError(f"joint {joint + 1} is {far:.3g} rad from its {place}, more than {most:.3g} rad")
        if constraints is not None and constraints.violation == "end":
            velocity = observation[0, 2:4] if "velocity" in self._scenario.sensors else np.zeros(2)
            if constraints.violated(position, velocity):
                at = f"position {position.tolist()} and velocity {velocity.tolist()}"
                raise ValueError(f"a constraint is violated at {at}")

    def _check_motion(self, position: Array, reference: Array, elapsed: float) -> None:
        """Raise a ValueError where a reading jumps, or stays the same although its joint moves."""
        model = self._model
        fastest = np.minimum(abs(reference[2:4]) + self.max_velocity, self._scenario.limits.velocity)
        # Readings that may be lost come as one jump.
        most = fastest * elapsed * (1 + np.minimum(model.same, self._lost)) + model.blur
        jump = abs(position - model.position)
        model.go_on(position, reference, self._torque, elapsed)
        for joint in (0, 1):
            if jump[joint] > most[joint]:
                limit = f"{most[joint]:.3g} rad (max_velocity {self.max_velocity[joint]:.3g} rad/s)"
                raise ValueError(f"joint {joint + 1} is {jump[joint]:.3g} rad from its last reading, more than {limit}")
            turned, left = abs(model.turned[joint]) - model.blur[joint], abs(reference[joint] - model.reference[joint])
            is_fault = turned > TURNED * self._max_error or left > LEFT * self._max_error
            if is_fault and model.same[joint] > 1 + self._lost:  # a bus may repeat a reading once
                self._torque = model.torque[joint]  # later ones answer to a false reading
                same = f"joint {joint + 1} has the same reading for {model.same[joint] + 1} samples"
                turns = f"its torque must have turned it by {turned:.2g} rad and its reference by {left:.2g} rad"
                raise ValueError(f"{same}, in which {turns}: its encoder is stuck")


class _Model:
    """The nominal arm, which tells how far a joint must have turned whose reading stays the same.

    Such a joint goes on with the least velocity that its last readings allow. The torque beyond the
    one that keeps it still in the nominal arm drives it. Twice the dry friction of the scenario,
    and no less than `LEAST_FRICTION`, brakes it: a joint that sticks, or whose model is wrong, has
    not turned.

    Attributes:
        acceleration: the largest of each joint, at the torque limits and with all weight on their
            side, in any pose [2] rad/s^2.
        blur: a count of each encoder, and 4 standard deviations of its noise [2] rad.
        position: the last reading [2] rad.
        same: samples since each reading changed [2].
        turned: angle by which each joint must have turned since then [2] rad.
        reference: position [2] rad, when each reading changed.
        torque: the last one before that, a row for each reading [2 x 2] N m.
    """

    def __init__(self, friction: Friction, interface: Interface) -> None:
        self._arm = interface.nominal
        limit = np.full(2, 1e30) if interface.torque_limit is None else np.array(interface.torque_limit)
        self.blur = np.array(interface.resolution) + 4.0 * np.array(interface.noise_std[0])
        poses = inertia_matrix(self._arm, np.column_stack([np.zeros(50), np.linspace(0.0, np.pi, 50)]))
        *_, p4, p5 = np.abs(self._arm.lumped)
        self.acceleration = (np.abs(np.linalg.inv(poses)) @ (limit + np.array([p4 + p5, p5]))).max(axis=0)
        self._inertia = np.diagonal(poses[0])
        dry = [[ends(x)[1] for x in joints] for joints in (friction.coulomb, friction.stiction)]  # type: ignore[union-attr]
        self._dry, self._least = np.sum(dry, axis=0), LEAST_FRICTION * limit
        self._load = np.array([ends(x)[1] for x in friction.load])  # type: ignore[union-attr]

    def start(self, position: Array, reference: Array) -> None:
        """Begin at rest."""
        self.position, self.reference, self.same = position, reference[:2], np.zeros(2, dtype=int)
        self.turned, self._velocity, self.torque = np.zeros(2), np.zeros(2), np.zeros((2, 2))

    def go_on(self, position: Array, reference: Array, torque: Array, elapsed: float) -> None:
        """Go on to a new reading.

        Args:
            position: the reading [2] rad.
            reference: position, velocity and acceleration [6].
            torque: since the last reading [2] N m.
            elapsed: time since then [s].
        """
        other = 1.0 - np.eye(2)  # a row for each joint, which rests while the other one follows the reference
        still = inverse_dynamics(self._arm, position + 0.0 * other, reference[2:4] * other, reference[4:6] * other)
        per_torque = elapsed / self._inertia
        velocity = self._velocity + per_torque * (torque - np.diagonal(still))
        braked = per_torque * np.maximum(2 * (self._dry + self._load * np.abs(torque)), self._least)
        velocity = np.sign(velocity) * np.maximum(np.abs(velocity) - braked, 0.0)
        same, moved = position == self.position, position - self.position
        seen = np.sign(moved) * np.maximum(np.abs(moved) - self.blur, 0.0) / elapsed
        self._velocity = np.where(same, velocity, seen)
        self.turned = np.where(same, self.turned + elapsed * velocity, 0.0)
        self.reference = np.where(same, self.reference, reference[:2])
        self.torque = np.where(same[:, None], self.torque, torque)
        self.same, self.position = np.where(same, self.same + 1, 0), position


def _numbers(name: str, value: Any, size: int) -> Array:
    """Return finite numbers as a flat array [size]; refuse others."""
    array = np.asarray(value, dtype=float).ravel()
    if array.size != size or not all(map(math.isfinite, array.tolist())):
        raise ValueError(f"{name} must be {size} finite numbers, got {value!r}")
    return array
