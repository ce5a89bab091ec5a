"""References: each equals its definition, and the arm can follow the default within its torque limits."""

import itertools
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from fbl_gym import ArmParameters, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.model.arm import inverse_dynamics
from fbl_gym.options.references import HIGH, LOW
from tests.fbl_gym.episodes import play, started

# A long preview gives a whole motion at once, at 10 kHz.

H = 1e-4
MOTIONS = tomllib.loads(Path(__file__).with_name("references.toml").read_text(encoding="utf-8"))
POINTS = MOTIONS["points"]
WAVE, FAST = np.sin(np.outer(np.arange(501) / 80, [1, 2])), np.sin(np.outer(np.arange(40), [0.3, 0.5]))
DRAWN = {"kind": "sine", "phase": None}
SMOOTH = MOTIONS["smooth"] | {"sine": DRAWN, "array": {"kind": "array", "position": WAVE, "dt": 0.01}}
KINDS = SMOOTH | MOTIONS["more"] | {"array-fast": {"kind": "array", "position": FAST, "dt": 0.1}}
ANY = KINDS | MOTIONS["rough"]


def foreseen(reference, duration=2.5, seed=0):
    """Time, and the reference's position, velocity and acceleration, each [n x 2], from one observation at 10 kHz."""
    n = round(duration / H)
    env = TwoLinkArmEnv(reference=reference, duration=duration, control_dt=H, physics_dt=H, preview=n)
    rows = env.reset(seed=seed)[0][env.layout.reference].reshape(n + 1, 3, 2)
    return H * np.arange(n + 1), *rows.swapaxes(0, 1)


def test_steps_start_at_the_first_level_and_jump_at_each_period():
    reference = {"kind": "steps", "points": POINTS, "period": 1.0}
    np.testing.assert_allclose(started(reference=reference).truth.position, POINTS[0])
    _, r, v, a = foreseen(reference)
    assert np.all(r[:10_000] == POINTS[1])
    assert np.all(r[10_000:] == POINTS[2])
    assert not np.any([v, a])


def test_filtered_steps_solve_the_filters_equation():
    """r'' = w^2 (s - r) - 2 w r', through every jump of s."""
    w = 6.0
    _, r, v, a = foreseen({"kind": "filtered-steps", "points": POINTS, "period": 0.7, "bandwidth": w}, duration=5.0)
    target = np.array(POINTS)[np.minimum(np.arange(50_001) // 7000 + 1, 2)]
    np.testing.assert_allclose(a, w * w * (target - r) - 2 * w * v, atol=1e-9)
    np.testing.assert_allclose([r[0], v[0], r[-1]], [POINTS[0], (0.0, 0.0), POINTS[2]], atol=1e-6)
    assert np.abs(np.diff(v, axis=0)).max() < 0.01  # no jump in velocity where the level jumps


def test_a_sine_reference_is_its_formula():
    sine = {"centre": (-1.0, 0.5), "amplitude": (0.3, 0.6), "frequency": 0.4, "phase": (0.0, 1.0)}
    t, r, _, _ = foreseen({"kind": "sine", **sine})
    expected = np.array([-1.0, 0.5]) + np.array([0.3, 0.6]) * np.sin(2 * np.pi * 0.4 * t[:, None] + [0.0, 1.0])
    np.testing.assert_allclose(r, expected, atol=1e-12)


def test_an_array_reference_has_its_samples_rate_and_derivatives_and_holds_the_last():
    """Samples at 20 ms are read at 0.1 ms."""
    position, velocity, acceleration = samples = np.random.default_rng(0).normal(size=(3, 51, 2))
    array = {"kind": "array", "position": position, "velocity": velocity, "acceleration": acceleration, "dt": 0.02}
    _, *motion = foreseen(array, duration=1.5)
    np.testing.assert_allclose(np.array(motion)[:, :10_001:200], samples, atol=1e-12)
    np.testing.assert_allclose(motion[0][10_000:], np.broadcast_to(position[-1], (5001, 2)), atol=1e-12)
    assert not motion[1][10_001:].any()


@pytest.mark.parametrize("reference", KINDS.values(), ids=KINDS.keys())
def test_finite_differences_give_velocity_and_acceleration(reference):
    """Central differences of 0.1 ms, except next to the jumps of filtered steps."""
    t, r, v, a = foreseen(reference)
    smooth = np.ones(len(t) - 2, dtype=bool)
    if reference["kind"] == "filtered-steps":
        since = t[1:-1] / reference.get("period", 2.0)
        smooth = np.abs(since - np.round(since)) > 1e-3
    third = np.abs(np.diff(a[1:-1], axis=0)).max(axis=0, where=smooth[1:, None] & smooth[:-1, None], initial=0.0) / H
    for value, slope, error in ((r, v, H * third / 2), (v, a, third)):
        difference = (value[2:] - value[:-2]) / (2 * H)
        worst = np.abs(difference - slope[1:-1])[smooth].max(axis=0)
        assert np.all(worst <= H * error + 1e-8 * (1 + np.abs(slope).max(axis=0)))
    assert np.abs(v).max() > 0.1
    assert np.abs(a).max() > 0.1


@pytest.mark.parametrize("hold", [0.3, 0.0])
def test_minimum_jerk_is_the_polynomial_of_flash_and_hogan(hold):
    t, r, _, _ = foreseen({"kind": "minimum-jerk", "points": POINTS, "move_time": 0.8, "hold_time": hold})
    for i in (0, 1):
        begin = (0.8 + hold) * i
        part = (t >= begin - 1e-9) & (t <= begin + 0.8 + 1e-9)
        s = ((t[part] - begin) / 0.8)[:, None]
        way = np.subtract(POINTS[i + 1], POINTS[i])
        np.testing.assert_allclose(r[part], POINTS[i] + way * (10 * s**3 - 15 * s**4 + 6 * s**5), atol=1e-12)
    rest = t > 1.6 + hold + 1e-9
    np.testing.assert_allclose(r[rest], np.broadcast_to(POINTS[2], r[rest].shape), atol=1e-14)


@pytest.mark.parametrize("centre", [(0.5, -0.5), 0.0])
def test_fourier_is_a_sum_of_sines_with_amplitudes_in_proportion_to_one_over_h(centre):
    h, amplitude = np.arange(1, 6)[:, None], np.array([1.0, 0.4])
    reference = {"kind": "fourier", "frequency": 1.0, "harmonics": 5, "amplitude": amplitude, "centre": centre}
    t, r, _, _ = foreseen(reference, duration=2.0)
    size = amplitude / h / (1 / h).sum()
    spectrum = np.fft.rfft(r[:10000] - np.array(centre), axis=0)[1:6] / 5000
    np.testing.assert_allclose(np.abs(spectrum), size, atol=1e-10)
    phase = np.angle(spectrum) + np.pi / 2
    turn = 2 * np.pi * h * t[:, None, None] + phase
    np.testing.assert_allclose(r, centre + (size * np.sin(turn)).sum(axis=1), atol=1e-9)
    assert np.ptp(phase) > 0.5


@pytest.mark.parametrize("reference", [DRAWN, {"kind": "fourier"}], ids=["sine", "fourier"])
def test_drawn_phases_depend_on_the_seed(reference):
    env = TwoLinkArmVectorEnv(64, reference=reference)
    first, again, other = (env.reset(seed=seed)[0][:, env.layout["reference_position"]] for seed in (0, 0, None))
    assert len(np.unique(first[:, 0])) == len(np.unique(first[:, 1])) == 64
    assert np.array_equal(first, again)
    assert not np.any(first == other)
    assert np.abs(np.corrcoef(first.T)[0, 1]) < 0.4


@pytest.mark.parametrize("reference", ANY.values(), ids=ANY.keys())
def test_preview_observation_and_truth_have_one_reference(reference):
    """To the bit, and whatever the duration of the episode."""
    motions, limits = [], {"position": 1e3, "velocity": 1e4}
    for duration in (5.0, 1.0):
        layout, seen, truths = play(100, 1, 4, reference=reference, duration=duration, preview=7, limits=limits)
        true = [[t.reference, t.reference_velocity, t.reference_acceleration] for t in truths]
        motions.append(np.reshape(true, (101, 6)))
    np.testing.assert_array_equal(*motions)
    shown = seen[:, 0, layout.reference].reshape(101, 8, 6)
    for k in range(8):
        np.testing.assert_array_equal(shown[: 101 - k, k], motions[-1][k:])


@pytest.mark.parametrize("path", ["sine.frequency", "fourier.centre", "fourier.amplitude", "filtered-steps.bandwidth"])
def test_a_lane_that_draws_a_number_follows_the_motion_of_that_number(path):
    """To the bit, with its preview, and for each joint that draws."""
    kind, name = path.split(".")

    def motions(value):
        env = TwoLinkArmVectorEnv(16, reference={"kind": kind, name: value}, preview=20)
        return env.reset(seed=2)[0][:, env.layout.reference].reshape(16, 63, 2)

    first, second, drawn = map(motions, (0.6, 1.3, {"choice": (0.6, 1.3)}))
    is_first, is_second = ((drawn == each).all(axis=1) for each in (first, second))
    assert np.all(is_first != is_second)
    assert 0 < is_first.sum() < 32
    if kind != "fourier":
        assert np.all(is_first[:, 0] == is_first[:, 1])


@pytest.mark.parametrize("kind", ["minimum-jerk", "steps", "filtered-steps"])
def test_all_levels_of_an_episode_are_drawn_uniformly_from_the_box(kind):
    low, high = np.array([-2.0, 0.1]), np.array([-1.0, 0.3])
    times = {"move_time": 0.02, "hold_time": 0.02} if kind == "minimum-jerk" else {"period": 0.04}
    times |= {"bandwidth": 2000.0} if kind == "filtered-steps" else {}
    reference = {"kind": kind, "low": low, "high": high, **times}
    env = TwoLinkArmVectorEnv(256, reference=reference, duration=0.4, control_dt=0.02, preview=19)
    ahead = env.reset(seed=0)[0][:, env.layout["preview"]].reshape(256, 19, 6)[:, :, :2]
    levels = ((ahead[:, 0::2] - low) / (high - low)).reshape(256, -1).T  # 20 ms after each jump or start
    assert np.all((levels > -1e-9) & (levels < 1 + 1e-9))
    assert min(stats.kstest(each, "uniform").pvalue for each in levels) > 1e-3
    assert np.abs(np.corrcoef(levels) - np.eye(len(levels))).max() < 0.3


def test_the_arm_starts_at_its_reference_plus_the_initial_error():
    for name, reference in ANY.items():
        plain = started(reference=reference, seed=3)
        env = started(reference=reference, initial_error=(0.1, -0.2), seed=3)
        np.testing.assert_array_equal(env.truth.position, plain.truth.position + [0.1, -0.2], err_msg=name)
        np.testing.assert_array_equal(env.truth.velocity, plain.truth.velocity, err_msg=name)
        if name in SMOOTH:
            np.testing.assert_array_equal(plain.truth.position, plain.truth.reference)
            np.testing.assert_array_equal(plain.truth.velocity, plain.truth.reference_velocity)


def test_a_single_point_is_a_constant_reference():
    for name in ("one-point", "one-level", "one-filtered-level", "one-sample"):
        _, r, v, a = foreseen(ANY[name], duration=0.5)
        assert np.all(r == POINTS[0]), name
        assert not np.any([v, a]), name


@pytest.mark.parametrize(("arm", "load", "stated", "limit"), [
    (ArmParameters(), 15.0, (1683, 749), (2000, 800)),
    (ArmParameters(0.7, 0.5, 20.0, 15.0), 0.5, (62300, 19700), (70000, 22000)),
], ids=["table-1", "section-2-2"])  # fmt: skip
def test_no_move_in_the_box_needs_more_than_the_stated_torque(arm, load, stated, limit):
    """Between any two points of a 7 x 7 grid over the box, at the uncertainty's corners: torque is linear in each mass.

    `references.py` and `scenarios/ideal.toml` state the numbers.
    """
    s = np.linspace(0, 1, 61)
    share, rate, bend = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
    grid = np.array(list(itertools.product(*np.linspace(LOW, HIGH, 7).T)))
    ends = np.array(list(itertools.product(grid, grid)))
    begin, way = ends[:, 0], ends[:, 1] - ends[:, 0]
    q = begin[:, None] + way[:, None] * share[:, None]
    v, a = way[:, None] * rate[:, None] / 1.5, way[:, None] * bend[:, None] / 1.5**2
    largest = np.zeros(2)
    for f in itertools.product((0.5, 2), repeat=4):
        real = ArmParameters(arm.m1 * f[0], arm.m2 * f[1], arm.L1 * f[2], arm.L2 * f[3])
        carried = np.array([real.L1**2, real.L2**2, real.L1 * real.L2, real.L1 * 9.81, real.L2 * 9.81])
        for mass in (0.0, load):
            torque = inverse_dynamics(real.lumped + mass * carried, q, v, a)
            largest = np.maximum(largest, np.abs(torque).max(axis=(0, 1)))
    assert np.all(largest < limit)
    np.testing.assert_array_less(largest, np.array(stated) + 1.0)
