"""The paper's parameter estimator: three samples and the pseudo-inverse (§4.1).

The paper solves K_t X = -M_t e_t for the errors X of seven products of parameters, equations
(32)-(37). Two pairs of its seven columns are equal, so at most five combinations can be estimated
(its equation (38)): the five lumped parameters of `arm.py`. With the applied torque on the right
the same equations read Y p = torque. Unlike (36), that also holds under saturation, where the
torque cannot give the commanded acceleration.
"""

import numpy as np
from numpy.typing import NDArray

from controllers.numerics.solving import least_squares
from fbl_gym.model.arm import STANDARD_GRAVITY, Array


def estimate(y: Array, torque: Array, weakest: float, hangs: bool = True) -> tuple[Array, NDArray[np.bool_]]:
    """Return p1 to p5 of least squares [n x 5], in kg m^2 and N m, and where to accept them [n].

    y [n x s x 2 x 5] is the regressor of the measured motion at each sample (`arm.regressor`), and
    the torque [n x s x 2] N m that applied in it. An estimate is accepted where the parameters are
    physical and the samples tell all five apart: the smallest singular value of the regressor
    (columns scaled to length one) exceeds `weakest`. At rest the rank is 2, and (39) would return
    nonsense.
    """
    # At full rank the pseudo-inverse (Y'Y)^-1 Y' gives the solution of least squares.
    lumped, rich = least_squares(y.reshape(len(y), -1, 5), torque.reshape(len(y), -1), weakest)
    return lumped, rich & plausible(lumped if hangs else lumped[..., :3])


def plausible(lumped: Array) -> NDArray[np.bool_]:
    """Return where p1 to p3, or p5, [n x 3] are positive, with positive definite inertia, [n]."""
    p1, p2, p3 = (lumped[..., i] for i in range(3))
    return np.all(np.isfinite(lumped) & (lumped > 0.0), axis=-1) & (p1 * p2 > p3 * p3)


def point_masses(lumped: Array, total_mass: Array | float | None = None, gravity: float = STANDARD_GRAVITY) -> Array:
    """Return m1, m2 [kg], L1 and L2 [m] [n x 4] of point masses, from lumped parameters [n x 5].

    With the total mass m1 + m2 known, equation (39): L2 = Y1 / Y3, L1 = Y2 / Y3, m2 = Y3^2 / Y1 and
    m1 = mass - m2, for Y1 = p2, Y2 = p3 and Y3 = p5 / g. Without it, from the rest of the same
    regression: L1 = g p1 / p4 and m1 + m2 = (p4 / g)^2 / p1.
    """
    y1, y2, y3 = lumped[..., 1], lumped[..., 2], lumped[..., 4] / gravity
    m2, L2 = y3**2 / y1, y1 / y3
    if total_mass is None:
        L1 = gravity * lumped[..., 0] / lumped[..., 3]
        return np.stack([(lumped[..., 3] / gravity) ** 2 / lumped[..., 0] - m2, m2, L1, L2], axis=-1)
    return np.stack([total_mass - m2, m2, y2 / y3, L2], axis=-1)


def lumped_of(parameters: Array, gravity: float = STANDARD_GRAVITY) -> Array:
    """Return the lumped parameters [n x 5] of point masses m1, m2 [kg], L1, L2 [m] [n x 4]."""
    m1, m2, L1, L2 = (parameters[..., i] for i in range(4))
    both = m1 + m2
    return np.stack([both * L1**2, m2 * L2**2, m2 * L1 * L2, both * L1 * gravity, m2 * L2 * gravity], axis=-1)
