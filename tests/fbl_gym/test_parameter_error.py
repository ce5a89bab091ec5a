"""The options `arm` and `parameter_error` change the real arm's parameters, and nothing else."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from fbl_gym import SECTION_2_2, TABLE_1, ArmParameters, ParameterError, TwoLinkArmEnv
from fbl_gym.model.arm import forward_dynamics
from tests.fbl_gym.episodes import play, same, started, started_batch, truths_of


def ratios(error, lanes=64):
    """Return the real parameters over the nominal ones [lanes x 4]."""
    truth = started_batch(lanes, parameter_error=error).truth
    return np.hstack([truth.masses, truth.lengths]) / [TABLE_1.m1, TABLE_1.m2, TABLE_1.L1, TABLE_1.L2]


@pytest.mark.parametrize("error", [
    {"radius": 1.0},
    {"ratio": {"m1": 3.0, "L2": 0.5}, "radius": 0.25},
    {"radius": 1.0, "sampling": "together", "parameters": ("m2", "L1")},
], ids=str)  # fmt: skip
def test_a_radius_draws_factors_log_uniformly_around_the_ratio(error):
    """A factor for each parameter, or one for some of them; the others have none."""
    factors = ratios(error, 4096) / np.array(ParameterError(**error).ratio)
    drawn, together = np.log(factors) / np.log(1 + error["radius"]), "sampling" in error
    touched = [1, 2] if together else [0, 1, 2, 3]
    np.testing.assert_array_equal(np.delete(factors, touched, axis=1), 1.0)
    assert np.abs(drawn).max() < 1.0 + 1e-12
    assert min(stats.kstest(x, stats.uniform(-1, 2).cdf).pvalue for x in drawn[:, touched].T) > 1e-3
    if together:
        np.testing.assert_allclose(factors[:, 1], factors[:, 2], rtol=1e-14)
    else:
        assert np.abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 0.08


def test_the_factor_of_a_mass_does_not_depend_on_the_lengths_having_one():
    every, masses = (ratios({"radius": 1.0, **more}) for more in ({}, {"parameters": ("m1", "m2")}))
    np.testing.assert_array_equal(masses[:, :2], every[:, :2])


RODS, MOON, GEARED = TABLE_1.as_rods(), ArmParameters(gravity=1.6), ArmParameters(rotor=(6.0, 2.0))
SMALL = ArmParameters(m1=1.0, m2=2.0, L1=0.3, L2=0.4, centre=0.7, inertia=0.2)


@pytest.mark.parametrize("arm", [SECTION_2_2, RODS, MOON, GEARED, SMALL], ids=str)
def test_the_arm_reaches_the_plant_and_the_nominal_model(arm):
    env = started(arm=arm)
    assert env.interface.nominal == arm
    np.testing.assert_allclose(env.truth.lumped, arm.lumped, rtol=1e-15)
    for truth in truths_of(env, [(0.01, 0.02)] * 5)[1:]:
        expected = forward_dynamics(arm, truth.position, truth.velocity, truth.applied_torque)
        np.testing.assert_allclose(truth.acceleration, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["centre", "inertia", "rotor"])
def test_centres_inertias_and_rotors_reach_the_real_arm_alone(name):
    """Each changes the equations of motion as it does in an arm of its own, and nothing else."""
    nominal = ArmParameters(centre=(0.5, 0.4), inertia=(0.1, 0.05), rotor=(2.0, 0.5))
    ratio = np.array([1.25, 0.75])
    real = dataclasses.replace(nominal, **{name: tuple(ratio * getattr(nominal, name))})
    _, seen, truths = play(arm=nominal, parameter_error={name: tuple(ratio)})
    _, other, _ = play(arm=real)
    np.testing.assert_allclose(seen[..., :4], other[..., :4], rtol=0, atol=1e-11)
    np.testing.assert_allclose(truths[0].lumped[0], real.lumped, rtol=1e-14)
    np.testing.assert_allclose(truths[0].rotor[0], real.rotor, rtol=1e-14)
    assert not same(truths, play(arm=nominal)[2], "position")
    assert TwoLinkArmEnv(arm=nominal, parameter_error={name: tuple(ratio)}).interface.nominal == nominal


DRAWN = {"uniform": [0.5, 1.5]}


@pytest.mark.parametrize("centre", [None, 1.0, (1.25, 0.75), DRAWN], ids=str)
@pytest.mark.parametrize("inertia", [None, 1.0, (0.0, 2.0), DRAWN], ids=str)
def test_a_ratio_of_centre_or_inertia_is_real_over_nominal_whatever_lengths_and_masses(centre, inertia):
    """In m and kg m^2, by the lumped parameters; without one, both follow the real length and mass."""
    nominal = ArmParameters(centre=(0.5, -0.4), inertia=(0.1, 0.05))
    error = {"ratio": (2, 1, 1.5, 0.7), "radius": 0.5, "centre": centre, "inertia": inertia}
    env = started_batch(9, arm=nominal, parameter_error=error)
    truth, told = env.truth, {name: env._batch.field(f"{name}_ratio") for name in ("centre", "inertia")}
    mass, length = truth.masses, truth.lengths
    masses, lengths = np.array([nominal.m1, nominal.m2]), np.array([nominal.L1, nominal.L2])
    (m1, m2), (L1, _), (p1, p2, p3, p4, _) = mass.T, length.T, truth.lumped.T
    centres = np.stack([(p4 / nominal.gravity - m2 * L1) / m1, p3 / m2 / L1], -1)
    inertias = np.stack([p1 - m2 * L1**2, p2], -1) - mass * centres**2
    for name, given, seen, usual, follows in (
        ("centre", centre, centres, nominal.centre * lengths, length / lengths),
        ("inertia", inertia, inertias, nominal.inertia * masses * lengths**2, mass / masses * (length / lengths) ** 2),
    ):
        expected = follows if given is None else told[name] if given == DRAWN else np.broadcast_to(given, (9, 2))
        np.testing.assert_allclose(seen / usual, expected, rtol=1e-9, atol=1e-9)
        assert given != DRAWN or (np.ptp(expected) > 0.5 and expected.min() > 0.5 and expected.max() < 1.5)


def test_the_lightest_arms_bound_the_drawn_ones():
    error = ParameterError(ratio=(2, 1, 1.5, 0.7), radius=0.5, centre=DRAWN, inertia=DRAWN)
    nominal = ArmParameters(centre=(0.5, 0.4), inertia=(0.1, 0.05))
    lightest = np.array([arm.lumped for arm in error.lightest(nominal)])
    drawn = started_batch(64, arm=nominal, parameter_error=error).truth.lumped
    assert np.all(lightest.min(axis=0) <= drawn.min(axis=0))
