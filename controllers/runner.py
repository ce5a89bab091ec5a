"""A policy on a robot: `Runner` decides on a torque at each reading, as in the environment."""

import math
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike

from controllers.registry import factory, make
from fbl_gym.envs.robot import Robot
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import check_number
from fbl_gym.scenarios import Scenario, as_scenario

_UNITS = {"position": "rad", "velocity": "rad_s", "acceleration": "rad_s2", "reference": "rad", "torque": "Nm"}
"""The signals of a log, each with its unit in the names of the columns."""


class Runner:
    """A policy in a loop that reads a robot and commands its torques.

    Call `step` once each `control_dt`. The observation has the bits that the environment of the
    scenario would give for the same readings. Before the first one, the arm counts as at rest, or
    at its measured velocity, under the torque that holds the nominal arm still.

    A run stops for good when a reading is late, not finite or of another shape; when a joint is
    farther than `max_error` from its reference, beyond the scenario's `limits` of position and
    velocity, or beyond constraints with `violation="end"`; or when the policy fails. From then on,
    each step returns a torque that goes evenly to zero in the time `ramp`, then zeros. `stopped`
    says why. Only `reset` begins another run.

    Args:
        policy: as for `controllers.make`, such as "computed-torque-dob@my_gains".
        scenario: the task: a `Scenario`, its name or its file. Its reference is not used, nor any
            option that only an arm in simulation has.
        log: CSV file of the run, which `fbl-gym identify` reads; None: there is none. Each step
            writes its line before it returns, so that a process that ends leaves a whole log. It
            ends where the run stops. It replaces an older file.
        ramp: time from the last torque to zero [s].
        max_error: largest distance of a joint from its reference [rad].
        max_interval: longest time between two readings [s]; None: twice `control_dt`.

    Attributes:
        interface: all that the policy knows.
        policy: the policy.
        control_dt: time between two steps [s].
        rows: of the reference that `step` takes: 1, and the coming samples that the policy uses.
        stopped: reason why the run stopped; empty while it goes on.
    """

    def __init__(
        self,
        policy: str | Callable[..., Any],
        scenario: Scenario | str | Path,
        *,
        log: str | Path | None = None,
        ramp: float = 0.5,
        max_error: float = 0.5,
        max_interval: float | None = None,
    ) -> None:
        self._scenario = as_scenario(scenario)
        self.control_dt = self._scenario.control_dt
        build = factory(policy) if isinstance(policy, str) else policy
        self.rows = 1 + math.ceil(getattr(build, "preview", 0.0) / self.control_dt - 1e-9)
        self._robot = Robot(self._scenario, self.rows - 1)
        self.interface = self._robot.interface
        self.policy = make(policy, self.interface)
        self._ramp_steps = max(1, math.ceil(check_number("ramp", ramp, low=0) / self.control_dt - 1e-9))
        self._max_error = check_number("max_error", max_error, above=0)
        longest = 2 * self.control_dt if max_interval is None else max_interval
        self._max_interval = check_number("max_interval", longest, above=self.control_dt)
        self._observed = slice(0, 2 * len(self._scenario.sensors))
        self._file: TextIO | None = None
        self._state: Any = None
        at_rest = np.zeros(2 * len(self._robot.needs))
        self._robot.start(at_rest)
        for k in range(3):  # compile all code now: a robot does not wait
            self._act(self._robot.observe(at_rest, np.zeros(6 * self.rows)), k == 0)
        self.reset(log)

    def reset(self, log: str | Path | None = None) -> None:
        """Begin another run with the next step; the policy begins afresh.

        Args:
            log: of this run, as above.
        """
        self.close()
        self.stopped = ""
        self._last = math.nan
        self._torque, self._left = np.zeros(2), self._ramp_steps
        if log is not None:
            self._file = Path(log).open("w", encoding="utf-8", buffering=1)  # noqa: SIM115 - it is open between steps
            signals = (*self._scenario.sensors, "reference", "torque")
            columns = [f"{name}_{joint}_{_UNITS[name]}" for name in signals for joint in (1, 2)]
            self._file.write(",".join(["time_s", *columns]) + "\n")

    def close(self) -> None:
        """Close the log."""
        if self._file is not None:
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
        if not self.stopped:
            try:
                given = {"position": position, "velocity": velocity, "acceleration": acceleration}
                return self._decide(given, reference, perf_counter() if time is None else time)
            except Exception as problem:  # a loop that ends with an error leaves the last torque on the robot
                if math.isnan(self._last):
                    raise
                self.stopped = str(problem) or repr(problem)
                self.close()
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
        if not (math.isfinite(now) if begins else 0.0 < now - self._last <= self._max_interval):
            raise ValueError(
                f"time must go on by at most {self._max_interval:g} s from reading to reading, "
                f"got {now:g} s after {self._last:g} s"
            )
        if begins:
            self._begin, self._first = now, motion.tolist()
            self._before = self._first
            self._robot.start(motion)
        observation = self._robot.observe(motion, ahead)
        self._check(motion.tolist(), ahead.tolist(), observation)
        torque = self._act(observation, begins)
        if self._file is not None:
            signals = (observation[0, self._observed], ahead[:2], torque)
            values = [now - self._begin, *np.concatenate(signals).tolist()]
            self._file.write(",".join(map(repr, values)) + "\n")
        self._last, self._before, self._torque = now, motion.tolist(), torque
        return torque.copy()

    def _act(self, observation: Array, begins: bool) -> Array:
        """Return the torque of the policy, and let the control step pass."""
        state = None if begins else self._state
        action, self._state = self.policy.predict(observation, state, np.array([begins]), deterministic=True)
        return self._robot.command(_numbers("action", action, 2))

    def _check(self, position: list[float], reference: list[float], observation: Array) -> None:
        """Raise a ValueError where a reading is beyond a limit."""
        limits, constraints = self._scenario.limits, self._scenario.constraints
        places = {
            "reference (max_error)": (reference, self._max_error),
            "start (limits.position)": (self._first, limits.position),
            "last reading (limits.velocity times control_dt)": (self._before, limits.velocity * self.control_dt),
        }
        for place, (other, most) in places.items():
            for joint in (0, 1):
                if (far := abs(position[joint] - other[joint])) > most:
                    raise ValueError(f"joint {joint + 1} is {far:.3g} rad from its {place}, more than {most:.3g} rad")
        if constraints is not None and constraints.violation == "end":
            velocity = observation[0, 2:4] if "velocity" in self._scenario.sensors else np.zeros(2)
            if constraints.violated(np.array(position), velocity):
                raise ValueError(f"a constraint is violated at position {position} and velocity {velocity.tolist()}")


def _numbers(name: str, value: Any, size: int) -> Array:
    """Return finite numbers as a flat array [size]; refuse others."""
    array = np.asarray(value, dtype=float).ravel()
    if array.size != size or not all(map(math.isfinite, array.tolist())):
        raise ValueError(f"{name} must be {size} finite numbers, got {value!r}")
    return array
