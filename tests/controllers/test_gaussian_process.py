"""The online Gaussian process against its textbook form, and what it learns."""

import numpy as np

import controllers
from controllers.laws.gaussian_process import SIGNAL
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.model.arm import inverse_dynamics
from tests.controllers.closed_loop import loop, tracking

EXCITING = {"kind": "fourier", "centre": (-np.pi / 2, 0.0), "frequency": 0.2}


def test_the_torque_has_the_mean_of_a_gaussian_process():
    """k' (K + s^2 I)^-1 y over all samples, kernel of random cosines and time (Rasmussen and Williams 2006, (2.25))."""
    env = TwoLinkArmEnv(parameter_error={"radius": 0.3}, actuator=None, action="torque", reference=EXCITING)
    policy = controllers.make("computed-torque-gp", env, memory=0.5, noise=0.2)
    frequencies, phases = policy.spectrum
    rows, targets = [], []
    before, last = None, None
    for observation, _, torque, _ in loop(policy, env, 60):
        names = ("reference_position", "reference_velocity", "reference_acceleration")
        q, v, *reference = policy.read(observation, "position", "velocity", *names)
        rows.append(np.cos(np.concatenate(reference) @ frequencies + phases) * np.sqrt(2 / len(phases)))
        if before is not None:
            model = inverse_dynamics(env.interface.nominal, q, 0.5 * (v + last), (v - last) / 0.01)
            targets.append((before - model) / policy.weight)
        else:
            targets.append(np.zeros(2))
        z, before, last = np.array(rows), torque, v
        time = 0.01 * np.arange(len(z))
        kernel = SIGNAL**2 * z @ z.T * np.exp(-np.abs(time[:, None] - time) / 0.5)
        mean = kernel[-1] @ np.linalg.solve(kernel + 0.2**2 * np.eye(len(z)), np.array(targets))
        wanted = policy.acceleration(observation[None], q[None], v[None])[0]
        plain = inverse_dynamics(env.interface.nominal, q, v, wanted)
        np.testing.assert_allclose(torque, plain + policy.weight * mean, rtol=1e-6, atol=1e-6)


def test_it_learns_what_the_model_misses():
    """On a wrong arm behind a delayed drive, the error falls to a fraction of that of computed torque."""
    wrong = {"parameter_error": {"radius": 0.2}, "friction": {"viscous": 10.0}}
    late = {"actuator": {"delay_samples": 1, "lag": 0.01}}
    env = TwoLinkArmVectorEnv(2, reference=EXCITING, duration=15.0, **wrong, **late)
    laws = (controllers.make(name, env, frequency=10.0) for name in ("computed-torque", "computed-torque-gp"))
    plain, learned = (np.abs(tracking(law, env, 1400)[0][-500:]).mean() for law in laws)
    assert learned < 0.4 * plain
