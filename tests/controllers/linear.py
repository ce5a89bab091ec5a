"""Linear systems, against which laws on an exact model are compared."""

import numpy as np
from scipy.linalg import expm


def response(a, x0, dt, steps):
    """First component of x' = a x from x0, at each sample."""
    step, x, log = expm(np.array(a) * dt), np.array(x0), []
    for _ in range(steps + 1):
        log.append(x[0])
        x = step @ x
    return np.array(log)
