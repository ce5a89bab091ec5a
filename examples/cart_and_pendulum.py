"""The cascade, mapping and estimator of the paper on another plant: a cart and a pendulum."""

import numpy as np

GRAVITY, DT = 9.81, 1e-3
VELOCITY_P, VELOCITY_I, KP = 30.0, 13.0, 10.0  # the inner loop of the paper; Kp is ours


def regressor(q, v, a):
    """Rows of Y(q, v, a) p = torque, with p = (cart + bob, bob * length, bob * length^2)."""
    c, s = np.cos(q[1]), np.sin(q[1])
    return np.array([[a[0], c * a[1] - s * v[1] ** 2, 0.0], [0.0, c * a[0] + GRAVITY * s, a[1]]])


def acceleration(p, q, v, torque):
    """M^-1 (torque - the rest): the motion of a plant with parameters p."""
    rest = regressor(q, v, np.zeros(2)) @ p
    M = np.stack([regressor(q, v, unit) @ p - rest for unit in np.eye(2)], axis=1)
    return np.linalg.solve(M, torque - rest)


def mean_error(p, estimate, adapt=False):
    """Cascade and mapping in closed loop for 4 s; the mean error in % of the amplitude."""
    q, v, integral, samples, errors = np.zeros(2), np.zeros(2), np.zeros(2), [], []
    for k in range(4000):
        t = k * DT
        r, r_dot = 0.5 * (1.0 - np.cos(2.0 * t)) * np.ones(2), np.sin(2.0 * t) * np.ones(2)
        e_v = r_dot + KP * (r - q) - v
        integral += DT * e_v
        torque = regressor(q, v, VELOCITY_P * e_v + VELOCITY_I * integral) @ estimate  # the mapping
        a = acceleration(p, q, v, torque)
        samples = [*samples[-2:], (regressor(q, v, a), torque)]
        if adapt and k >= 3:
            estimate = np.linalg.pinv(np.vstack([Y for Y, _ in samples])) @ np.hstack([x for _, x in samples])
        q, v = q + DT * v + 0.5 * DT**2 * a, v + DT * a
        errors.append(np.abs(r - q).mean())
    return 100.0 * np.mean(errors)


cart, bob, length = 2.0, 0.5, 0.7
real = np.array([cart + bob, bob * length, bob * length**2])
for factor in (1.0, 0.5, 2.0, 0.1):
    print(f"estimates x{factor:g}: {mean_error(real, factor * real):.2f} %")
print(f"estimates x0.1, three-sample estimator: {mean_error(real, 0.1 * real, adapt=True):.2f} %")
