"""Each option reaches the plant or the observation where it should, and nothing else.

The measure is a twin: the same environment without the option, with the same seed and the same torques.
"""

import numpy as np
import pytest
from scipy import stats

from fbl_gym import TABLE_1, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.arm import gravity_torque

LANES = 64
WAYS = ("position", "velocity", "acceleration")
PLANT = (
    "position",
    "velocity",
    "acceleration",
    "applied_torque",
    "disturbance",
    "friction_torque",
    "lumped",
    "reference",
)


def torques(k, lanes=LANES):
    """Torques [lanes x 2] that move the arm about, a function of the step."""
    phase = np.arange(lanes)[:, None] + np.array([0.0, 1.0])
    return np.array([150.0, 40.0]) * np.sin(0.05 * k + phase) + np.array([-50.0, -10.0])


def play(steps=100, lanes=LANES, seed=0, **options):
    """Observations [steps + 1 x lanes x size] and truths of a run under `torques`."""
    env = TwoLinkArmVectorEnv(lanes, action="torque", limits={"position": 100.0}, **options)
    observations, truths = [env.reset(seed=seed)[0]], [env.truth]
    for k in range(steps):
        observations.append(env.step(torques(k, lanes))[0])
        truths.append(env.truth)
    return env.layout, np.array(observations), truths


def same(ours, theirs, *names):
    """Whether two runs' truths agree to the bit in the named fields."""
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for a, b in zip(ours, theirs, strict=True) for name in names
    )


PLAIN = play()


# Noise: the observation, and only there.


@pytest.mark.parametrize("sensor", WAYS)
def test_noise_is_white_has_its_sigma_and_touches_only_its_sensor(sensor):
    sigma = (0.02, 0.05)
    layout, seen, truths = play(noise={sensor: sigma})
    assert same(truths, PLAIN[2], *PLANT)
    noise = (seen - PLAIN[1])[..., layout[sensor]]
    for other in set(WAYS) - {sensor}:
        assert np.array_equal(seen[..., layout[other]], PLAIN[1][..., layout[other]])
    for joint in (0, 1):
        x = noise[..., joint]
        assert x.std() == pytest.approx(sigma[joint], rel=0.03)
        assert abs(x.mean()) < 4 * sigma[joint] / np.sqrt(x.size)
        assert stats.kstest(x.ravel() / sigma[joint], "norm").pvalue > 1e-3
        assert abs(np.corrcoef(x[1:].ravel(), x[:-1].ravel())[0, 1]) < 0.05
        assert abs(np.corrcoef(x[:, 1:].ravel(), x[:, :-1].ravel())[0, 1]) < 0.05
    assert abs(np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1]) < 0.05


def test_sensors_have_noises_of_their_own():
    layout, seen, _ = play(noise={"position": 0.1, "velocity": 0.1, "acceleration": 0.1})
    noises = [(seen - PLAIN[1])[..., layout[sensor]][..., 0].ravel() for sensor in WAYS]
    assert np.abs(np.corrcoef(noises) - np.eye(3)).max() < 0.05


def test_bias_and_quantization_are_exact():
    layout, seen, truths = play(noise={"velocity": {"bias": (0.5, -1.0)}, "position": {"quantization": (0.01, 0.25)}})
    assert same(truths, PLAIN[2], *PLANT)
    np.testing.assert_allclose(
        (seen - PLAIN[1])[..., layout["velocity"]], np.broadcast_to([0.5, -1.0], (101, LANES, 2)), atol=1e-12
    )
    read, true = seen[..., layout["position"]], PLAIN[1][..., layout["position"]]
    step = np.array([0.01, 0.25])
    np.testing.assert_allclose(read / step, np.round(read / step), atol=1e-9)
    assert np.all(np.abs(read - true) <= step / 2 + 1e-12)


def test_signal_to_noise_ratio():
    """1 dB against unit power is variance 0.794, and 10 dB is 0.1, as the errata reckon."""
    for snr, variance in ((1.0, 0.794), (10.0, 0.1)):
        layout, seen, _ = play(noise={"position": {"snr_db": snr}})
        assert (seen - PLAIN[1])[..., layout["position"]].var() == pytest.approx(variance, rel=0.05)


def test_a_sensor_that_is_missing_leaves_its_slot_out():
    layout, seen, truths = play(sensors=("position",))
    assert same(truths, PLAIN[2], *PLANT)
    assert "velocity" not in layout
    assert "acceleration" not in layout
    assert layout.size == 8
    assert np.array_equal(seen[..., layout["position"]], PLAIN[1][..., PLAIN[0]["position"]])
    assert np.array_equal(seen[..., layout["reference_velocity"]], PLAIN[1][..., PLAIN[0]["reference_velocity"]])
    with pytest.raises(ValueError, match="unknown slot of the observation 'velocity'"):
        layout["velocity"]


def test_preview_is_the_reference_to_come():
    layout, seen, truths = play(preview=3)
    assert same(truths, PLAIN[2], *PLANT)
    reference = seen[..., layout["reference_position"].start : layout["reference_acceleration"].stop]
    for ahead in range(3):
        shown = seen[..., layout["preview"]][..., 6 * ahead : 6 * ahead + 6]
        assert np.array_equal(shown[: -ahead - 1], reference[ahead + 1 :])


# Parameters: the plant, and only its parameters.


def ratios(truths, index=0):
    truth = truths[index]
    return np.hstack([truth.masses, truth.lengths]) / [TABLE_1.m1, TABLE_1.m2, TABLE_1.L1, TABLE_1.L2]


def test_fixed_ratios():
    _, _, truths = play(parameter_error={"ratio": {"m2": 2.0, "L1": 0.5}})
    np.testing.assert_allclose(ratios(truths), np.broadcast_to([1, 2, 0.5, 1], (LANES, 4)), rtol=1e-15)
    assert same(truths, PLAIN[2], "reference", "applied_torque", "disturbance")
    assert not same(truths[5:], PLAIN[2][5:], "position")
    np.testing.assert_allclose(ratios(play(parameter_error=0.5, steps=1)[2]), 0.5)
    np.testing.assert_allclose(ratios(play(parameter_error={"ratio": (1, 2, 3, 4)}, steps=1)[2])[0], [1, 2, 3, 4])


def test_radius_draws_log_uniformly_from_half_to_double():
    _, _, truths = play(steps=1, lanes=4096, parameter_error={"radius": 1.0})
    found = ratios(truths)
    assert found.min() > 0.5
    assert found.max() < 2.0
    for column in np.log2(found).T:
        assert stats.kstest(column, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(found.T) - np.eye(4)).max() < 0.08


def test_radius_together_and_on_some_parameters():
    found = ratios(play(steps=1, parameter_error={"radius": 1.0, "sampling": "together"})[2])
    assert np.allclose(found, found[:, :1])
    assert len(np.unique(found[:, 0])) == LANES
    found = ratios(play(steps=1, parameter_error={"radius": 1.0, "parameters": ("m1", "m2")})[2])
    assert np.all(found[:, 2:] == 1.0)
    assert np.all(found[:, :2] != 1.0)


def test_payload_is_carried_from_pick_up_to_drop():
    _, _, truths = play(parameter_error={"payload": {"mass": 6.0, "pick_up": 0.25, "drop": 0.6}})
    assert [truth.payload[0] for truth in truths] == [6.0 if 25 < k <= 60 else 0.0 for k in range(101)]
    assert same(truths[:26], PLAIN[2][:26], *PLANT)
    L1, L2, g = TABLE_1.L1, TABLE_1.L2, TABLE_1.gravity
    extra = truths[40].lumped[0] - PLAIN[2][40].lumped[0]
    np.testing.assert_allclose(extra, 6.0 * np.array([L1 * L1, L2 * L2, L1 * L2, L1 * g, L2 * g]), rtol=1e-12)
    assert same(truths[61:], PLAIN[2][61:], "lumped")
    _, _, always = play(steps=1, parameter_error={"payload": 6.0})
    assert np.all(always[0].payload == 6.0)


# Friction, disturbance, actuator: the plant, and only there.


@pytest.mark.parametrize("law", ["exact", "literal"])
def test_each_part_of_friction(law):
    for part, expected in (
        ({"viscous": (4.0, 2.0)}, lambda v: np.array([4.0, 2.0]) * v),
        ({"coulomb": (4.0, 2.0)}, lambda v: np.array([4.0, 2.0]) * np.sign(v)),
        (
            {"stiction": (4.0, 2.0), "v_s": (0.1, 0.5)},
            lambda v: np.array([4.0, 2.0]) * np.exp(-(v**2) / [0.1, 0.5]) * np.sign(v),
        ),
    ):
        _, _, truths = play(friction={**part, "law": law})
        assert same(truths, PLAIN[2], "reference", "applied_torque", "lumped", "disturbance")
        assert not same(truths[5:], PLAIN[2][5:], "position")
        for truth in truths[1:]:
            moving = truth.velocity != 0.0
            np.testing.assert_allclose(
                truth.friction_torque[moving], expected(truth.velocity)[moving], rtol=1e-9, atol=1e-12
            )


def levels(**options):
    """The disturbance [steps + 1 x lanes x 2] and the truths of a run."""
    _, _, truths = play(steps=200, **options)
    reference = play(steps=200)[2]
    assert same(truths, reference, "reference", "applied_torque", "lumped")
    assert not same(truths[5:], reference[5:], "position")
    return np.array([truth.disturbance for truth in truths]), truths


def test_piecewise_constant_disturbance():
    push, _ = levels(disturbance={"kind": "piecewise-constant", "amplitude": (20.0, 5.0), "period": 0.2})
    change = np.any(np.diff(push, axis=0) != 0, axis=(1, 2))
    # Sample k tells of the interval that ended there, so that the level of [0.2 i, 0.2 (i + 1)) is seen from 20 i + 1 on.
    assert set(np.flatnonzero(change)) == {20 * i for i in range(1, 10)}
    levels_seen = push[1::20].reshape(-1, 2) / [20.0, 5.0]
    assert np.abs(levels_seen).max() <= 1.0
    for joint in (0, 1):
        assert stats.kstest(levels_seen[:, joint], stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_a_period_that_is_no_multiple_of_the_control_interval():
    env = TwoLinkArmEnv(
        control_dt=0.001, disturbance={"kind": "piecewise-constant", "amplitude": 20.0, "period": 0.003}
    )
    coarse = TwoLinkArmEnv(disturbance={"kind": "piecewise-constant", "amplitude": 20.0, "period": 0.003})
    env.reset(seed=0)
    coarse.reset(seed=0)
    for _ in range(10):
        for _ in range(10):
            env.step((0.1, 0.1))
        coarse.step((0.1, 0.1))
        np.testing.assert_array_equal(env.truth.disturbance, coarse.truth.disturbance)
        np.testing.assert_allclose(env.truth.position, coarse.truth.position, atol=1e-13)


def test_sine_disturbance():
    push, truths = levels(
        disturbance={"kind": "sine", "amplitude": (20.0, 5.0), "frequency": (1.0, 3.0), "phase": (0.5, 1.0)}
    )
    for k, truth in enumerate(truths):
        expected = np.array([20.0, 5.0]) * np.sin(2 * np.pi * np.array([1.0, 3.0]) * truth.time[0] + [0.5, 1.0])
        np.testing.assert_allclose(push[k], np.broadcast_to(expected, (LANES, 2)), atol=1e-10)
    drawn, _ = levels(disturbance={"kind": "sine", "amplitude": 20.0})
    assert len(np.unique(drawn[0, :, 0])) == LANES


def test_pulses():
    push, _ = levels(
        disturbance={"kind": "pulses", "amplitude": (20.0, -5.0), "period": 0.5, "width": 0.1, "start": 0.3}
    )
    on = np.array([k - 1 >= 30 and (k - 1 - 30) % 50 < 10 for k in range(1, 201)])
    assert np.array_equal(push[1:, 0], on[:, None] * np.array([20.0, -5.0]))


def test_an_array_of_ones_own():
    table = np.random.default_rng(0).uniform(-9, 9, (4, 2))
    push, _ = levels(disturbance={"kind": "array", "torque": table, "dt": 0.25})
    for k in range(1, 201):
        assert np.array_equal(push[k, 3], table[min((k - 1) // 25, 3)])


def test_torque_limit():
    _, _, truths = play(actuator={"torque_limit": (100.0, 30.0)})
    for k, truth in enumerate(truths[1:]):
        assert np.array_equal(truth.applied_torque, np.clip(torques(k), [-100.0, -30.0], [100.0, 30.0]))


@pytest.mark.parametrize("delay", [0.001, 0.01, 0.013, 0.02, 0.035])
def test_delay(delay):
    layout, seen, truths = play(actuator={"delay": delay})
    late = round(delay / 0.001)
    held = gravity_torque(TABLE_1, truths[0].position)
    for k in range(1, 101):
        # The torque at the interval's last millisecond was commanded `delay` before.
        step = (10 * k - 1 - late) // 10
        np.testing.assert_allclose(truths[k].applied_torque, held if step < 0 else torques(step), rtol=1e-12)
        np.testing.assert_allclose(seen[k][..., layout["previous_action"]], torques(k - 1))
    assert "previous_action" not in PLAIN[0]


def test_lag():
    layout, _, truths = play(actuator={"lag": 0.05})
    assert "previous_action" in layout
    torque = gravity_torque(TABLE_1, truths[0].position)
    for k in range(100):
        torque = torques(k) + (torque - torques(k)) * np.exp(-0.01 / 0.05)
        np.testing.assert_allclose(truths[k + 1].applied_torque, torque, rtol=1e-11)


# Streams: one option does not shift another.


def test_adding_noise_friction_and_error_shifts_no_other_number():
    push = {"kind": "piecewise-constant", "amplitude": 20.0}
    _, _, alone = play(disturbance=push)
    _, _, crowd = play(
        disturbance=push,
        noise={"position": 0.01, "velocity": 0.1},
        friction={"coulomb": 3.0},
        parameter_error={"radius": 0.5},
    )
    assert same(alone, crowd, "disturbance", "reference")
    _, _, error = play(parameter_error={"radius": 0.5})
    assert same(error, crowd, "masses", "lengths")


# Rates, start, limits.


def test_rates():
    """The same held torque at 5 times the control rate, or with a finer physics step, is the same motion."""
    ends = []
    for control_dt, physics_dt in ((0.01, 0.001), (0.002, 0.001), (0.01, 0.0005)):
        env = TwoLinkArmEnv(control_dt=control_dt, physics_dt=physics_dt)
        env.reset(seed=0)
        for _ in range(round(1.0 / control_dt)):
            env.step((0.05, -0.02))
        ends.append(env.truth.position)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-12)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-8)


def test_duration_and_initial_error():
    env = TwoLinkArmEnv(duration=0.05, initial_error=(0.1, -0.2))
    plain = TwoLinkArmEnv()
    env.reset(seed=0)
    plain.reset(seed=0)
    np.testing.assert_allclose(env.truth.position - plain.truth.position, [0.1, -0.2])
    assert [env.step((0, 0))[3] for _ in range(5)] == [False] * 4 + [True]


def test_limits_end_an_episode_and_bound_the_sensors():
    env = TwoLinkArmEnv(limits={"position": 0.5, "velocity": 3.0}, action="torque", actuator=None)
    env.reset(seed=0)
    start = env.truth.position
    for _ in range(1000):
        observation, reward, terminated, _, _ = env.step((2000.0, 0.0))
        if terminated:
            break
    assert terminated
    assert reward == 0.0
    assert np.abs(env.truth.position - start).max() > 0.5 or np.abs(env.truth.velocity).max() > 3.0
    assert observation in env.observation_space
    assert env.observation_space.high[env.layout["velocity"]] == pytest.approx([6.0, 6.0])


def test_three_kinds_of_action_are_one_plant():
    """The same wish as fraction, torque and acceleration moves the arm alike."""
    ends = []
    for action in ("fraction", "torque", "acceleration"):
        env = TwoLinkArmEnv(action=action, parameter_error=1.3)
        observation, _ = env.reset(seed=2)
        rng = np.random.default_rng(0)
        for _ in range(100):
            q, v = observation[env.layout["position"]], observation[env.layout["velocity"]]
            torque = gravity_torque(env.nominal, q) + rng.normal(size=2) * (40.0, 10.0)
            wish = env.interface.action_from_torque(torque, q, v)
            np.testing.assert_allclose(env.interface.torque_from_action(wish, q, v), torque, rtol=1e-9)
            observation = env.step(wish)[0]
        ends.append(env.truth.position)
    np.testing.assert_allclose(ends, np.broadcast_to(ends[0], (3, 2)), atol=1e-9)


def test_an_action_beyond_the_box_acts_as_its_edge():
    one, two = TwoLinkArmEnv(), TwoLinkArmEnv()
    one.reset(seed=0)
    two.reset(seed=0)
    np.testing.assert_array_equal(one.step((7.0, -3.0))[0], two.step((1.0, -1.0))[0])
