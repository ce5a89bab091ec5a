"""The references against their definitions, and the default one against the torque limits."""

import itertools

import numpy as np
import pytest

from fbl_gym import ArmParameters, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.arm import inverse_dynamics
from fbl_gym.references import HIGH, LOW

POINTS = ((-1.0, 0.2), (-0.4, -0.5), (-1.9, 0.8))
FINE = {"control_dt": 1e-3, "physics_dt": 1e-3}


def motion(reference, duration=5.0, seed=0, **options):
    """Reference position, velocity and acceleration, each [steps + 1 x 2], at 1 kHz."""
    env = TwoLinkArmEnv(reference=reference, duration=duration, **FINE, **options)
    rows = [env.reset(seed=seed)[0]]
    rows += [env.step((0, 0))[0] for _ in range(round(duration / 1e-3))]
    seen = np.array(rows)
    return [seen[:, env.layout[f"reference_{name}"]] for name in ("position", "velocity", "acceleration")]


SMOOTH = {
    "minimum-jerk": {"kind": "minimum-jerk"},
    "filtered-steps": {"kind": "filtered-steps"},
    "sine": {"kind": "sine", "phase": None},
    "fourier": {"kind": "fourier"},
    "array": {"kind": "array", "position": np.sin(np.outer(np.arange(501) / 80, [1, 2])), "dt": 0.01},
}


@pytest.mark.parametrize("reference", SMOOTH.values(), ids=SMOOTH.keys())
def test_velocity_and_acceleration_are_derivatives(reference):
    r, v, a = motion(reference)
    inside = slice(1, -1)
    np.testing.assert_allclose(np.gradient(r, 1e-3, axis=0)[inside], v[inside], atol=2e-2)
    assert np.median(np.abs(np.gradient(r, 1e-3, axis=0) - v)[inside]) < 2e-5
    assert np.median(np.abs(np.gradient(v, 1e-3, axis=0) - a)[inside]) < 2e-4


def test_minimum_jerk_moves_from_rest_to_rest_through_its_points():
    r, v, a = motion({"kind": "minimum-jerk", "points": POINTS, "move_time": 1.0, "hold_time": 0.5})
    for i, point in enumerate(POINTS):
        begin = 1500 * i if i < 2 else 2500
        np.testing.assert_allclose(r[begin], point, atol=1e-12)
        np.testing.assert_allclose(v[begin], 0.0, atol=1e-12)
        np.testing.assert_allclose(a[begin], 0.0, atol=1e-9)
        if i:
            rest = slice(1500 * i - 500, 1500 * i)
            assert np.all(r[rest] == r[1500 * i - 500])
    # Flash and Hogan: half way at half time, with 1.875 times the mean speed.
    np.testing.assert_allclose(r[500], np.mean(POINTS[:2], axis=0), atol=1e-12)
    np.testing.assert_allclose(v[500], 1.875 * np.subtract(POINTS[1], POINTS[0]), atol=1e-12)


def test_steps_jump_at_their_times_and_start_at_the_first_level():
    env = TwoLinkArmEnv(reference={"kind": "steps", "points": POINTS, "period": 1.0}, **FINE)
    env.reset(seed=0)
    np.testing.assert_allclose(env.truth.position, POINTS[0])
    r, v, a = motion({"kind": "steps", "points": POINTS, "period": 1.0})
    assert np.all(r[:1000] == POINTS[1])
    assert np.all(r[1000:] == POINTS[2])
    assert not v.any()
    assert not a.any()


def test_filtered_steps_obey_their_filter():
    """r'' = w^2 (s - r) - 2 w r', through every jump of s."""
    w = 6.0
    r, v, a = motion({"kind": "filtered-steps", "points": POINTS, "period": 0.7, "bandwidth": w})
    target = np.array([POINTS[min(k // 700 + 1, 2)] for k in range(5001)])
    np.testing.assert_allclose(a, w * w * (target - r) - 2 * w * v, atol=1e-9)
    np.testing.assert_allclose(r[0], POINTS[0])
    np.testing.assert_allclose(v[0], 0.0)
    assert np.abs(np.diff(v, axis=0)).max() < 0.1  # no jump in velocity where the level jumps
    np.testing.assert_allclose(r[-1], POINTS[2], atol=1e-6)


def test_sine():
    t = 1e-3 * np.arange(5001)[:, None]
    r, _, _ = motion(
        {"kind": "sine", "centre": (-1.0, 0.5), "amplitude": (0.3, 0.6), "frequency": 0.4, "phase": (0.0, 1.0)}
    )
    expected = np.array([-1.0, 0.5]) + np.array([0.3, 0.6]) * np.sin(2 * np.pi * 0.4 * t + [0.0, 1.0])
    np.testing.assert_allclose(r, expected, atol=1e-12)


def test_fourier_series_has_its_harmonics_and_bound():
    r, _, _ = motion({"kind": "fourier", "frequency": 0.2, "harmonics": 4, "amplitude": (1.0, 0.5), "centre": 0.0}, 5.0)
    assert np.all(np.abs(r) <= [1.0, 0.5])
    spectrum = np.abs(np.fft.rfft(r[:-1], axis=0)) / 2500  # one period
    weights = 1 / np.arange(1, 5)
    np.testing.assert_allclose(spectrum[1:5, 0], weights / weights.sum(), atol=1e-9)
    assert spectrum[5:].max() < 1e-9


def test_an_array_is_reproduced_and_its_end_held():
    position = np.cumsum(np.random.default_rng(0).normal(size=(101, 2)) * 0.01, axis=0) - [1.5, 0.0]
    env = TwoLinkArmEnv(reference={"kind": "array", "position": position, "dt": 0.01}, duration=1.5)
    rows = [env.reset(seed=0)[0]] + [env.step((0, 0))[0] for _ in range(150)]
    seen = np.array(rows)[:, env.layout["reference_position"]]
    np.testing.assert_allclose(seen[:101], position, atol=1e-12)
    np.testing.assert_allclose(seen[101:], np.broadcast_to(position[-1], (50, 2)), atol=1e-12)
    assert not np.array(rows)[102:, env.layout["reference_velocity"]].any()
    given = {"kind": "array", "position": np.zeros((3, 2)), "velocity": np.ones((3, 2)), "dt": 0.01}
    assert TwoLinkArmEnv(reference=given).reset(seed=0)[0][8:10] == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("kind", ["minimum-jerk", "steps", "filtered-steps"])
def test_drawn_points_fill_their_box_and_follow_the_seed(kind):
    env = TwoLinkArmVectorEnv(512, reference={"kind": kind, "low": (-2.0, 0.1), "high": (-1.0, 0.3)})
    first = env.reset(seed=0)[0][:, env.layout["position"]]
    assert np.all((first >= (-2.0, 0.1)) & (first <= (-1.0, 0.3)))
    assert np.ptp(first, axis=0) == pytest.approx((1.0, 0.2), rel=0.05)
    again = env.reset(seed=0)[0][:, env.layout["position"]]
    other = env.reset()[0][:, env.layout["position"]]
    assert np.array_equal(first, again)
    assert not np.any(first == other)


def test_an_arm_starts_on_its_reference():
    for reference in SMOOTH.values():
        env = TwoLinkArmEnv(reference=reference)
        env.reset(seed=3)
        np.testing.assert_array_equal(env.truth.position, env.truth.reference)
        np.testing.assert_array_equal(env.truth.velocity, env.truth.reference_velocity)


@pytest.mark.parametrize(
    ("arm", "load", "worst", "limit"),
    [
        (ArmParameters(), 15.0, (1683, 749), (2000, 800)),
        (ArmParameters(0.7, 0.5, 20.0, 15.0), 0.5, (62271, 18269), (70000, 22000)),
    ],
    ids=["table-1", "section-2-2"],
)
def test_the_default_motion_is_feasible_over_the_whole_default_uncertainty(arm, load, worst, limit):
    """Every mass and length half, right or double, with and without the payload, between all corners of the box."""
    s = np.linspace(0, 1, 81)
    share, rate, bend = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
    rng = np.random.default_rng(0)
    corners = np.array(list(itertools.product(*zip(LOW, HIGH, strict=True))))
    ends = np.array(list(itertools.product(corners, corners)))
    begin = np.concatenate([ends[:, 0], rng.uniform(LOW, HIGH, (1000, 2))])
    way = np.concatenate([ends[:, 1], rng.uniform(LOW, HIGH, (1000, 2))]) - begin
    q = begin[:, None] + way[:, None] * share[:, None]
    v, a = way[:, None] * rate[:, None] / 1.5, way[:, None] * bend[:, None] / 1.5**2
    found = np.zeros(2)
    for f in itertools.product((0.5, 1, 2), repeat=4):
        real = ArmParameters(arm.m1 * f[0], arm.m2 * f[1], arm.L1 * f[2], arm.L2 * f[3])
        carried = np.array([real.L1**2, real.L2**2, real.L1 * real.L2, real.L1 * 9.81, real.L2 * 9.81])
        for mass in (0.0, load):
            torque = inverse_dynamics(real.lumped + mass * carried, q, v, a)
            found = np.maximum(found, np.abs(torque).max(axis=(0, 1)))
    np.testing.assert_allclose(found, worst, rtol=5e-3)
    assert np.all(found < limit)
