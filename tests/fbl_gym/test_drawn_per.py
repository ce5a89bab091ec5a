"""`drawn_per`: with "seed", every episode has the arm and the reference of its seed's first one, and nothing else."""

import numpy as np
import pytest

from fbl_gym import TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import started
from tests.fbl_gym.paired_runs import torques

OPTIONS = {
    "parameter_error": {"radius": 0.5, "payload": {"mass": {"uniform": [1, 4]}, "pick_up": {"uniform": [0, 0.02]}}},
    "noise": {"position": {"sigma": 0.01, "bias": {"uniform": [0, 1]}}}, "friction": {"coulomb": {"uniform": [0, 20]}},
    "disturbance": {"kind": "piecewise-constant", "amplitude": {"uniform": [5, 20]}, "period": 0.02},
    "actuator": {"gain": {"uniform": [0.8, 1.2]}}, "initial_error": {"uniform": [-0.1, 0.1]},
}  # fmt: skip
DRAWN = ("masses", "lengths", "payload", "coulomb", "gain", "reference")


def episodes(**options):
    """Return the readings, and the truth of each step, of two episodes in a row."""
    env = TwoLinkArmVectorEnv(17, action="torque", **(OPTIONS | options))
    runs = []
    for seed in (3, None):
        readings, truths = [env.reset(seed=seed)[0]], [env.truth]
        for k in range(6):
            readings.append(env.step(torques(k, 17))[0])
            truths.append(env.truth)
        runs.append((np.array(readings), truths))
    return runs


@pytest.mark.parametrize("reference", ["minimum-jerk", "steps", "filtered-steps", "fourier"])
def test_arm_and_reference_stay_and_noise_and_disturbance_are_new(reference):
    (seen, first), (seen_again, second) = episodes(drawn_per="seed", reference=reference)
    for one, other in zip(first, second, strict=True):
        for name in DRAWN:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    np.testing.assert_array_equal(first[0].position, second[0].position)
    assert (first[3].disturbance != second[3].disturbance).all()
    (usual, usual_first), (usual_again, usual_second) = episodes(reference=reference)
    np.testing.assert_array_equal(seen, usual)
    assert not np.array_equal(usual_first[0].masses, usual_second[0].masses)
    assert not np.array_equal(usual_first[0].reference, usual_second[0].reference)
    noise, new, usual_new = (
        readings[..., :2] - [truth.position for truth in truths]
        for readings, truths in ((seen, first), (seen_again, second), (usual_again, usual_second))
    )
    assert np.std(noise - new) == pytest.approx(0.01 * np.sqrt(2), rel=0.2)  # the bias stays
    np.testing.assert_allclose(np.diff(new, axis=0), np.diff(usual_new, axis=0), atol=1e-12)


def test_another_seed_has_another_arm():
    env = started(drawn_per="seed", parameter_error={"radius": 0.5}, seed=1)
    masses = env.truth.masses
    env.reset(seed=2)
    assert not np.array_equal(env.truth.masses, masses)
