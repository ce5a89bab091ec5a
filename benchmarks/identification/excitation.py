"""An exciting motion: Fourier series whose regressor has a small condition number.

Swevers et al., "Optimal robot excitation and identification", IEEE Trans. Robotics and Automation
13(5), 1997. The motion starts at rest, and repeats itself after its period.
"""

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import minimize

from benchmarks.identification.model import INDEX, parameters_of, torque_columns
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import Pair, check_number, check_pair
from fbl_gym.scenarios import Scenario

HARMONICS = 5
PERIOD = 10.0  # of the motion [s]
SHARE = 0.7  # largest torque of a planned motion, as a share of the limit


def plan(start: Scenario, centre: Pair, amplitude: Pair, speed: float) -> tuple[dict[str, Array], float]:
    """Return position, velocity, acceleration and torque [n x 2] of a period, and the condition.

    The condition number is that of the torques' regressor, each column times the number that it
    stands for, so that all are told with the same relative precision.

    Args:
        start: a scenario of a similar arm, whose torque limits and control rate hold.
        centre: of the motion, where it starts at rest [rad].
        amplitude: largest distance from the centre [rad], within `limits.position` of the scenario.
        speed: largest velocity [rad/s], within `limits.velocity`.
    """
    amplitude = check_pair("amplitude", amplitude, above=0, high=start.limits.position)
    speed = check_number("speed", speed, above=0, high=start.limits.velocity)
    rate = 2 * np.pi / PERIOD * np.arange(1, HARMONICS + 1)

    def series(time: Array) -> Array:
        """Return position, velocity and acceleration of each coefficient [3 x n x 2 HARMONICS]."""
        sine, cosine = np.sin(np.outer(time, rate)), np.cos(np.outer(time, rate))
        pairs = ((sine, cosine), (cosine * rate, -sine * rate), (-sine * rate**2, -cosine * rate**2))
        return np.array([np.hstack(pair) for pair in pairs])

    rest = null_space(series(np.zeros(1))[:, 0])
    coarse = series(np.linspace(0.0, PERIOD, 201)) @ rest
    parameters = parameters_of(start)
    limit = np.inf if start.actuator.torque_limit is None else SHARE * np.array(start.actuator.torque_limit)
    own = parameters[:10]
    weights = np.maximum(own, 0.05 * np.abs(own).max())

    def motion(x: Array, bases: Array = coarse) -> tuple[Array, ...]:
        """Return the largest feasible motion with these coefficients, and its torques' columns."""
        shape = bases @ x.reshape(2, -1).T
        scale = min(*(amplitude / np.abs(shape[0]).max(axis=0)), *(speed / np.abs(shape[1]).max(axis=0)))
        while True:
            q, v, a = centre + scale * shape[0], scale * shape[1], scale * shape[2]
            columns = torque_columns(q, v, a)
            torque = columns @ parameters[:10] / parameters[[INDEX["gain 1"], INDEX["gain 2"]]]
            if (np.abs(torque) <= limit).all() or scale < 1e-6:
                return q, v, a, torque, columns
            scale *= 0.95

    def condition(x: Array) -> float:
        columns = motion(x)[-1].reshape(-1, 10) * weights
        return float(np.linalg.cond(np.delete(columns, (3, 4), axis=1) if start.arm.gravity == 0 else columns))

    tries = np.random.default_rng(0).normal(size=(60, 2 * rest.shape[1]))
    best = minimize(condition, min(tries, key=condition), method="Nelder-Mead", options={"maxfev": 400}).x
    time = np.arange(0.0, PERIOD + start.control_dt / 2, start.control_dt)
    q, v, a, torque, _ = motion(best, series(time) @ rest)
    if np.ptp(q, axis=0).max() < 0.05 * min(amplitude):
        raise ValueError(
            f"actuator.torque_limit must leave some motion on both joints, got {start.actuator.torque_limit}"
        )
    return {"time": time, "position": q, "velocity": v, "acceleration": a, "torque": torque}, condition(best)
