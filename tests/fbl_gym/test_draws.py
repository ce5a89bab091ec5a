"""Numbers that vary: their distributions, independence of other options, `drawn_per`; wrong arms and disturbances.

`test_options.py` checks for every number that an arm which draws a value is the arm with that value.
"""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from fbl_gym import Distribution, ParameterError, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.model.arm import SECTION_2_2, TABLE_1, ArmParameters, forward_dynamics
from fbl_gym.records.record import ends, middle
from tests.fbl_gym.episodes import play, run, same, started, started_batch, truths_of

LANES = 4000


def test_numbers_have_their_distributions():
    friction = {"viscous": {"uniform": [1, 5]}, "coulomb": [{"log_uniform": [0.1, 10]}, {"uniform": [0, 2]}]}
    start = started_batch(LANES, friction=friction, actuator={"gain": {"uniform": [0.5, 1.5]}}).truth
    drawn = np.hstack([start.viscous, start.gain, start.coulomb]).T
    viscous, gain, coulomb_2 = stats.uniform(1, 4), stats.uniform(0.5, 1), stats.uniform(0, 2)
    expected = [viscous, viscous, gain, gain, stats.loguniform(0.1, 10), coulomb_2]
    for values, distribution in zip(drawn, expected, strict=True):
        assert stats.kstest(values, distribution.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(start.viscous.T)[0, 1]) < 0.06
    assert abs(np.corrcoef(start.viscous[:, 0], start.gain[:, 0])[0, 1]) < 0.06


def test_a_choice_has_equal_chances():
    start = started_batch(LANES, friction={"stiction": {"choice": [1.0, 2.0, 5.0, 2.5]}}).truth
    values, counts = np.unique(start.stiction, return_counts=True)
    np.testing.assert_array_equal(values, [1.0, 2.0, 2.5, 5.0])
    assert stats.chisquare(counts).pvalue > 1e-3


def test_ends_and_middle():
    assert ends((Distribution(uniform=(1, 2)), 5.0)) == (1.0, 5.0)
    numbers = Distribution(log_uniform=(1, 4)), Distribution(choice=(1, 4, 6)), 3.0
    assert [*map(middle, numbers)] == [2.0, 3.5, 3.0]


UNRELATED = ("applied_torque", "disturbance", "masses", "lengths", "payload")
CROWDED = {
    "parameter_error": {"radius": 0.5, "payload": {"mass": 3.0, "pick_up": 0.3}},
    "disturbance": {"kind": "piecewise-constant", "amplitude": 20.0, "period": 0.07},
    "noise": {"position": 0.01, "velocity": 0.1},
    "friction": {"coulomb": 3.0},
}


def readings(layout, seen, truths):
    """Return the errors of the sensors [steps + 1 x lanes x 4]."""
    added = [seen[..., layout[name]] - [getattr(truth, name) for truth in truths] for name in ("position", "velocity")]
    return np.concatenate(added, axis=-1)


@pytest.mark.parametrize("change", [
    {"reference": {"kind": "fourier"}}, {"reference": {"kind": "steps", "period": 0.3}},
    {"reference": {"kind": "minimum-jerk", "low": 0.0, "high": 1.0}}, {"initial_error": (0.2, -0.1)},
    {"friction": None}, {"arm": {"gravity": 0.0}},
], ids=str)  # fmt: skip
def test_another_task_has_the_same_random_numbers(change):
    ours, theirs = play(**{**CROWDED, **change}), play(**CROWDED)
    np.testing.assert_allclose(readings(*ours), readings(*theirs), atol=1e-11)
    assert same(ours[2][1:], theirs[2][1:], *UNRELATED)
    assert not same(ours[2][5:], theirs[2][5:], "position", "reference")


@pytest.mark.parametrize("change", [
    {"reward": {"tracking": "l1", "weight_effort": 3.0}}, {"preview": 4}, {"duration": 4.0},
    {"limits": {"position": 50.0, "velocity": 200.0, "command": 5.0}},
    {"name": "another", "description": "of the same"},
], ids=str)  # fmt: skip
def test_options_outside_the_arm_do_not_move_it(change):
    """All readings and the whole truth are the same to the bit."""
    (_, seen, truths), (_, others, plain) = (play(60, 20, **{**CROWDED, **more}) for more in (change, {}))
    np.testing.assert_array_equal(seen[..., :12], others[..., :12])
    for one, other in zip(truths, plain, strict=True):
        np.testing.assert_equal(vars(one), vars(other))


OPTIONS = {
    "parameter_error": {"radius": 0.5, "payload": {"mass": {"uniform": [1, 4]}, "pick_up": {"uniform": [0, 0.02]}}},
    "noise": {"position": {"sigma": 0.01, "bias": {"uniform": [0, 1]}}}, "friction": {"coulomb": {"uniform": [0, 20]}},
    "disturbance": {"kind": "piecewise-constant", "amplitude": {"uniform": [5, 20]}, "period": 0.02},
    "actuator": {"gain": {"uniform": [0.8, 1.2]}}, "initial_error": {"uniform": [-0.1, 0.1]},
}  # fmt: skip
DRAWN = ("masses", "lengths", "payload", "coulomb", "gain", "reference")


def episodes(**options):
    """Return the readings, and the truth of each step, of two episodes in a row and of one of another seed."""
    env = TwoLinkArmVectorEnv(17, action="torque", **(OPTIONS | options))
    return [run(env, 6, seed=seed) for seed in (3, None, 4)]


@pytest.mark.parametrize("reference", ["minimum-jerk", "steps", "filtered-steps", "fourier"])
def test_arm_and_reference_stay_and_noise_and_disturbance_are_new(reference):
    (seen, first), (seen_again, second), (_, other) = episodes(drawn_per="seed", reference=reference)
    assert (other[0].masses != first[0].masses).all()
    for one, two in zip(first, second, strict=True):
        for name in DRAWN:
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)
    np.testing.assert_array_equal(first[0].position, second[0].position)
    assert (first[3].disturbance != second[3].disturbance).all()
    (usual, usual_first), (usual_again, usual_second), _ = episodes(reference=reference)
    np.testing.assert_array_equal(seen, usual)
    assert not np.array_equal(usual_first[0].masses, usual_second[0].masses)
    assert not np.array_equal(usual_first[0].reference, usual_second[0].reference)
    pairs = ((seen, first), (seen_again, second), (usual_again, usual_second))
    noise, new, usual_new = (rows[..., :2] - [truth.position for truth in truths] for rows, truths in pairs)
    assert np.std(noise - new) == pytest.approx(0.01 * np.sqrt(2), rel=0.2)  # the bias stays
    np.testing.assert_allclose(np.diff(new, axis=0), np.diff(usual_new, axis=0), atol=1e-12)


# The options `arm` and `parameter_error` change the real arm's parameters, and nothing else.


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


UNIFORM = {"uniform": [0.5, 1.5]}


@pytest.mark.parametrize("centre", [None, 1.0, (1.25, 0.75), UNIFORM], ids=str)
@pytest.mark.parametrize("inertia", [None, 1.0, (0.0, 2.0), UNIFORM], ids=str)
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
        expected = follows if given is None else told[name] if given == UNIFORM else np.broadcast_to(given, (9, 2))
        np.testing.assert_allclose(seen / usual, expected, rtol=1e-9, atol=1e-9)
        assert given != UNIFORM or (np.ptp(expected) > 0.5 and expected.min() > 0.5 and expected.max() < 1.5)


def test_the_lightest_arms_bound_the_drawn_ones():
    error = ParameterError(ratio=(2, 1, 1.5, 0.7), radius=0.5, centre=UNIFORM, inertia=UNIFORM)
    nominal = ArmParameters(centre=(0.5, 0.4), inertia=(0.1, 0.05))
    lightest = np.array([arm.lumped for arm in error.lightest(nominal)])
    drawn = started_batch(64, arm=nominal, parameter_error=error).truth.lumped
    assert np.all(lightest.min(axis=0) <= drawn.min(axis=0))


# The option `disturbance`: its torques reach the plant at their times, and only there.


def test_a_piecewise_constant_disturbance_has_levels_of_its_period_and_amplitude():
    *_, truths = play(200, disturbance={"kind": "piecewise-constant", "amplitude": (20.0, 5.0), "period": 0.2})
    *_, others = play(200)
    assert same(truths, others, "reference", "applied_torque", "lumped")
    assert not same(truths[5:], others[5:], "position")
    disturbance = np.array([truth.disturbance for truth in truths])
    change = np.any(np.diff(disturbance, axis=0) != 0, axis=(1, 2))
    # Sample k belongs to the step that ends there: the level of [0.2 i, 0.2 (i + 1)) begins at 20 i + 1.
    assert set(np.flatnonzero(change)) == {20 * i for i in range(1, 10)}
    for joint, amplitude in ((0, 20.0), (1, 5.0)):
        assert 0.9 * amplitude < np.abs(disturbance[..., joint]).max() <= amplitude


def test_levels_of_a_disturbance_are_new_in_each_lane_and_episode():
    env = TwoLinkArmVectorEnv(512, disturbance={"kind": "piecewise-constant", "amplitude": 1.0, "period": 0.01})
    truths = [truth for seed in (0, None) for truth in run(env, 3, seed=seed)[1][1:]]
    levels = np.concatenate([truth.disturbance.T for truth in truths])
    assert len(levels) == 12
    assert np.abs(np.corrcoef(levels) - np.eye(12)).max() < 0.2
    assert stats.kstest(np.concatenate(levels), stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_the_phases_of_a_sine_disturbance_are_uniform():
    env = started_batch(4096, disturbance={"kind": "sine", "amplitude": (3.0, 5.0)})
    for joint, amplitude in ((0, 3.0), (1, 5.0)):
        values = env.truth.disturbance[:, joint] / amplitude
        assert stats.kstest(values, stats.arcsine(-1, 2).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(env.truth.disturbance.T)[0, 1]) < 0.06
