"""Each option reaches the plant or the observation where it should, and nothing else.

The measure is a twin: the same environment without the option, with the same seed and the same torques.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from fbl_gym import SECTION_2_2, TABLE_1, ArmParameters, SensorError, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.arm import forward_dynamics, gravity_torque, inertia_matrix

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


# The control rate: what happens between two decisions does not depend on how often one decides.

STEPS = st.integers(1, 60)
WORLDS = st.fixed_dictionaries(
    {},
    optional={
        "parameter_error": st.fixed_dictionaries(
            {"radius": st.just(0.5), "mass": st.just(5.0), "pick_up": st.integers(0, 50), "carry": st.integers(1, 50)}
        ),
        "friction": st.sampled_from(
            [
                {"viscous": 4.0},
                {"coulomb": 30.0, "stiction": (10.0, 3.0)},
                {"coulomb": 3.0, "law": "literal", "viscous": (0.0, 2.0)},
            ]
        ),
        "disturbance": st.one_of(
            st.fixed_dictionaries({"kind": st.just("piecewise-constant"), "period": STEPS}),
            st.fixed_dictionaries(
                {"kind": st.just("pulses"), "period": STEPS, "width": st.integers(1, 60), "start": st.integers(0, 60)}
            ).filter(lambda push: push["width"] <= push["period"]),
            st.fixed_dictionaries({"kind": st.just("sine")}),
            st.fixed_dictionaries({"kind": st.just("array"), "dt": STEPS}),
        ),
        "actuator": st.fixed_dictionaries({"delay": st.integers(0, 40), "lag": st.sampled_from([0.0, 0.02])}),
    },
)


def in_seconds(world):
    """Options of an environment from those drawn above, whose times are whole physics steps of 1 ms."""
    options = {name: dict(value) for name, value in world.items()}
    if "parameter_error" in options:
        load = options["parameter_error"]
        begin = load.pop("pick_up")
        load["payload"] = {
            "mass": load.pop("mass"),
            "pick_up": begin * 1e-3,
            "drop": (begin + load.pop("carry")) * 1e-3,
        }
    if "disturbance" in options:
        push = options["disturbance"]
        push.update({name: push[name] * 1e-3 for name in ("period", "width", "start", "dt") if name in push})
        if push["kind"] == "array":
            push["torque"] = np.random.default_rng(0).uniform(-90, 90, (7, 2)).tolist()
        else:
            push["amplitude"] = (90.0, 30.0)
    if "actuator" in options:
        options["actuator"]["delay"] *= 1e-3
    return options


@settings(max_examples=80, deadline=None)
@given(WORLDS, st.sampled_from([2, 5, 7, 10]), st.integers(0, 1000))
def test_a_decision_held_is_the_same_decision_taken_again(world, substeps, seed):
    """To the bit: n physics steps under one command are n intervals of one step under the same command.

    So delay, lag, payload and every disturbance act at their own times, whether they are multiples of control_dt or not.
    """
    options = in_seconds(world)
    coarse = TwoLinkArmEnv(action="torque", control_dt=substeps * 1e-3, duration=substeps, **options)
    fine = TwoLinkArmEnv(action="torque", control_dt=1e-3, **options)
    coarse.reset(seed=seed)
    fine.reset(seed=seed)
    for k in range(100 // substeps):
        torque = torques(7 * k, 1)[0]
        coarse.step(torque)
        for _ in range(substeps):
            fine.step(torque)
        for name in (
            "position",
            "velocity",
            "acceleration",
            "applied_torque",
            "disturbance",
            "friction_torque",
            "lumped",
        ):
            np.testing.assert_array_equal(getattr(coarse.truth, name), getattr(fine.truth, name), err_msg=name)


# And each time to the physics step, seen at 1 kHz.


def watch(*names, steps=150, torque=(-50.0, -10.0), seed=0, **options):
    """Fields of the truth, each [steps + 1 x ...], of one arm at control_dt = physics_dt = 1 ms under a held torque."""
    env = TwoLinkArmEnv(action="torque", control_dt=1e-3, physics_dt=1e-3, **options)
    env.reset(seed=seed)
    truths = [env.truth]
    for k in range(steps):
        env.step(torque(k) if callable(torque) else torque)
        truths.append(env.truth)
    return tuple(np.array([getattr(truth, name) for truth in truths]) for name in names)


def test_a_payload_acts_from_its_physics_step_on():
    """Picked up at 23 ms, it first moves the arm in the step from 23 to 24 ms; dropped at 71 ms, it last does before."""
    load = {"mass": 6.0, "pick_up": 0.0231, "drop": 0.0709}
    payload, lumped, velocity = watch("payload", "lumped", "velocity", parameter_error={"payload": load})
    plain_lumped, plain_velocity = watch("lumped", "velocity")
    carried = np.zeros(151, dtype=bool)
    carried[24:72] = True
    np.testing.assert_array_equal(payload, np.where(carried, 6.0, 0.0))
    np.testing.assert_array_equal(lumped[~carried], plain_lumped[~carried])
    L1, L2, g = TABLE_1.L1, TABLE_1.L2, TABLE_1.gravity
    extra = 6.0 * np.array([L1**2, L2**2, L1 * L2, L1 * g, L2 * g])
    np.testing.assert_allclose(lumped[carried] - plain_lumped[carried], np.tile(extra, (48, 1)), rtol=1e-12)
    np.testing.assert_array_equal(velocity[:24], plain_velocity[:24])
    assert np.any(velocity[24] != plain_velocity[24])
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.1  # it does not jump


def test_a_payload_from_the_start_is_there_at_the_start():
    payload, lumped = watch("payload", "lumped", steps=1, parameter_error={"payload": 2.0})
    np.testing.assert_array_equal(payload, [2.0, 2.0])
    assert np.all(lumped > TABLE_1.lumped)


@pytest.mark.parametrize("start", [0.0, 0.017, 0.05])
def test_pulses_go_on_and_off_at_their_physics_steps(start):
    push = {"kind": "pulses", "amplitude": (20.0, -5.0), "period": 0.03, "width": 0.007, "start": start}
    (seen,) = watch("disturbance", disturbance=push)
    first = round(start * 1000)
    on = [k >= first and (k - first) % 30 < 7 for k in range(150)]
    # Sample k + 1 tells what acted in the step from k to k + 1 ms.
    np.testing.assert_array_equal(seen[1:], np.outer(on, [20.0, -5.0]))


def test_a_piecewise_constant_disturbance_changes_at_its_physics_steps():
    (seen,) = watch(
        "disturbance", disturbance={"kind": "piecewise-constant", "amplitude": (20.0, 5.0), "period": 0.013}
    )
    changes = np.flatnonzero(np.any(np.diff(seen[1:], axis=0) != 0, axis=1)) + 1
    np.testing.assert_array_equal(changes, np.arange(13, 150, 13))
    assert np.all(np.abs(seen) <= (20.0, 5.0))


def test_an_array_disturbance_is_its_samples():
    table = np.random.default_rng(0).uniform(-9, 9, (12, 2))
    (seen,) = watch("disturbance", disturbance={"kind": "array", "torque": table, "dt": 0.011})
    np.testing.assert_array_equal(seen[1:], table[np.minimum(np.arange(150) // 11, 11)])


def test_levels_of_a_disturbance_are_new_in_each_lane_and_episode():
    env = TwoLinkArmVectorEnv(512, disturbance={"kind": "piecewise-constant", "amplitude": 1.0, "period": 0.01})
    found = []
    for start in ({"seed": 0}, {}):
        env.reset(**start)
        for _ in range(3):
            env.step(np.zeros((512, 2)))
            found += [*env.truth.disturbance.T]
    assert len(found) == 12
    assert np.abs(np.corrcoef(found) - np.eye(12)).max() < 0.2
    assert stats.kstest(np.concatenate(found), stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_the_phases_of_a_sine_disturbance_are_uniform():
    env = TwoLinkArmVectorEnv(4096, disturbance={"kind": "sine", "amplitude": (3.0, 5.0)})
    env.reset(seed=0)
    for joint, amplitude in ((0, 3.0), (1, 5.0)):
        values = env.truth.disturbance[:, joint] / amplitude
        assert stats.kstest(values, stats.arcsine(-1, 2).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(env.truth.disturbance.T)[0, 1]) < 0.06


@pytest.mark.parametrize("late", [1, 3, 10, 13, 20, 37])
def test_a_delay_is_so_many_physics_steps(late):
    """The twin without a delay is given the commands that much later, and before them the torque at rest."""
    slow = TwoLinkArmEnv(action="torque", actuator={"delay": late * 1e-3})
    twin = TwoLinkArmEnv(action="torque", control_dt=1e-3)
    slow.reset(seed=0)
    twin.reset(seed=0)
    commands = [twin.truth.applied_torque] * late
    for k in range(20):
        commands += [torques(3 * k, 1)[0]] * 10
        slow.step(commands[-1])
        for j in range(10):
            twin.step(commands[10 * k + j])
        np.testing.assert_array_equal(slow.truth.position, twin.truth.position)
        np.testing.assert_array_equal(slow.truth.velocity, twin.truth.velocity)
        np.testing.assert_array_equal(slow.truth.applied_torque, twin.truth.applied_torque)


def test_a_lag_behind_a_delay_answers_a_step_as_an_exponential():
    applied, position = watch(
        "applied_torque", "position", torque=(100.0, 20.0), actuator={"delay": 0.02, "lag": 0.03}, steps=150
    )
    held = gravity_torque(TABLE_1, position[0])
    t = np.maximum(np.arange(151) * 1e-3 - 0.02, 0.0)[:, None]
    expected = held + (np.array([100.0, 20.0]) - held) * (1 - np.exp(-t / 0.03))
    np.testing.assert_allclose(applied, expected, rtol=1e-12)


@pytest.mark.parametrize(
    "options",
    [
        {"actuator": {"lag": 0.005, "torque_limit": None}},
        {"disturbance": {"kind": "sine", "amplitude": 100.0, "frequency": 5.0}},
    ],
    ids=["lag", "sine"],
)
def test_what_varies_within_a_physics_step_is_followed_there(options):
    """A physics step of 1 ms and one of 0.1 ms agree to the order of Runge-Kutta, not only to that of a held torque."""
    ends = []
    for physics_dt in (1e-3, 1e-4):
        env = TwoLinkArmEnv(action="torque", physics_dt=physics_dt, **options)
        env.reset(seed=0)
        for k in range(50):
            env.step(torques(10 * k, 1)[0])
        ends.append(np.concatenate([env.truth.position, env.truth.velocity]))
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-7)


def test_a_torque_limit_is_what_a_fraction_is_of():
    env = TwoLinkArmEnv(actuator={"torque_limit": (300.0, 50.0)})
    env.reset(seed=0)
    assert env.torque_limit == (300.0, 50.0)
    env.step((0.25, -0.5))
    np.testing.assert_array_equal(env.truth.applied_torque, [75.0, -25.0])
    env = TwoLinkArmEnv(actuator={"torque_limit": (300.0, 50.0)}, action="acceleration")
    env.reset(seed=0)
    env.step((100.0, 100.0))
    np.testing.assert_array_equal(env.truth.applied_torque, [300.0, 50.0])


# Sensors, once more.


def test_a_reading_is_bias_then_noise_then_rounding():
    quantum, bias = np.array([0.01, 0.25]), np.array([0.5, -1.0])
    for sensor in WAYS:
        sigma = {"sigma": (0.03, 0.2)}
        layout, noisy, _ = play(noise={sensor: sigma})
        _, seen, truths = play(noise={sensor: {**sigma, "bias": bias, "quantization": quantum}})
        expected = np.floor((noisy[..., layout[sensor]] + bias) / quantum + 0.5) * quantum
        np.testing.assert_array_equal(seen[..., layout[sensor]], expected)
        assert same(truths, PLAIN[2], *PLANT)


@pytest.mark.parametrize("sensor", WAYS)
def test_noise_of_one_joint_leaves_the_other_alone(sensor):
    layout, seen, _ = play(noise={sensor: (0.0, 0.1)})
    error = seen[..., layout[sensor]] - PLAIN[1][..., PLAIN[0][sensor]]
    assert np.all(error[..., 0] == 0.0)
    assert np.all(error[..., 1] != 0.0)


def test_noise_is_new_in_each_episode_and_seed_and_the_same_for_every_policy():
    env, plain = TwoLinkArmVectorEnv(3, noise={"position": 1.0}), TwoLinkArmVectorEnv(3)

    def noises(pushed, **start):
        """[50 x 3 lanes x 2]"""
        rows = [env.reset(**start)[0] - plain.reset(**start)[0]]
        for _ in range(49):
            actions = np.full((3, 2), pushed)
            rows.append(env.step(actions)[0] - plain.step(actions)[0])
        return np.array(rows)[..., :2]

    first, second = noises(0.0, seed=0), noises(0.0)
    again, shifted = noises(0.2, seed=0), noises(0.0, seed=1)
    np.testing.assert_allclose(first, again, atol=1e-12)
    np.testing.assert_allclose(first[:, 1:], shifted[:, :-1], atol=1e-12)  # lane i has the seed s + i
    columns = np.concatenate([first, second, shifted[:, 2:]], axis=1).reshape(50, -1).T
    assert np.abs(np.corrcoef(columns) - np.eye(14)).max() < 0.6
    assert not np.any(first == second)


@pytest.mark.parametrize(
    "sensors", [("position", "velocity"), ("position", "acceleration"), ("acceleration", "position")]
)
def test_sensors_in_any_order_fill_their_slots(sensors):
    layout, seen, truths = play(sensors=sensors)
    assert same(truths, PLAIN[2], *PLANT)
    for name in WAYS:
        assert (name in layout) == (name in sensors)
        if name in sensors:
            assert np.array_equal(seen[..., layout[name]], PLAIN[1][..., PLAIN[0][name]])
    assert [slot.name for slot in layout.slots][: len(sensors)] == [name for name in WAYS if name in sensors]


def test_perfect_sensors_read_the_truth():
    layout, seen, truths = PLAIN
    for name in WAYS:
        assert np.array_equal(seen[..., layout[name]], [getattr(truth, name) for truth in truths])


def test_signal_to_noise_ratio_is_ten_times_the_logarithm_of_the_variance():
    assert SensorError(snr_db=20.0).std == pytest.approx((0.1, 0.1))
    a = play(noise={"velocity": {"snr_db": 20.0}})[1]
    b = play(noise={"velocity": 0.1})[1]
    np.testing.assert_allclose(a, b, rtol=1e-12)


# Parameters, once more.


def test_the_radius_multiplies_the_ratio_within_its_bounds():
    error = {"ratio": {"m1": 3.0, "L2": 0.5}, "radius": 0.25}
    found = ratios(play(steps=1, lanes=4096, parameter_error=error)[2]) / [3.0, 1.0, 1.0, 0.5]
    assert np.all((found >= 1 / 1.25) & (found <= 1.25))
    for column in np.log(found).T / np.log(1.25):
        assert stats.kstest(column, stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_one_factor_for_all_is_log_uniform_too_and_spares_what_it_does_not_touch():
    error = {"radius": 1.0, "sampling": "together", "parameters": ("m2", "L1")}
    found = ratios(play(steps=1, lanes=4096, parameter_error=error)[2])
    np.testing.assert_array_equal(found[:, [0, 3]], 1.0)
    np.testing.assert_allclose(found[:, 1], found[:, 2], rtol=1e-14)
    assert stats.kstest(np.log2(found[:, 1]), stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_parameters_hold_through_an_episode_and_change_with_the_next():
    env = TwoLinkArmVectorEnv(4, parameter_error={"radius": 1.0})
    env.reset(seed=0)
    first = env.truth
    for _ in range(20):
        env.step(np.zeros((4, 2)))
    np.testing.assert_array_equal(env.truth.masses, first.masses)
    np.testing.assert_array_equal(env.truth.lengths, first.lengths)
    env.reset()
    assert not np.any(env.truth.masses == first.masses)


def test_which_parameters_are_touched_does_not_shift_the_others():
    """Masses alone are off by the very factors by which they are off together with the lengths."""
    every = ratios(play(steps=1, parameter_error={"radius": 1.0})[2])
    masses = ratios(play(steps=1, parameter_error={"radius": 1.0, "parameters": ("m1", "m2")})[2])
    np.testing.assert_array_equal(masses[:, :2], every[:, :2])


def test_errors_change_the_plant_and_not_the_nominal_model():
    env = TwoLinkArmEnv(parameter_error={"ratio": 2.0, "payload": 4.0})
    env.reset(seed=0)
    assert env.nominal == TABLE_1
    np.testing.assert_array_equal(env.truth.masses, [40.0, 30.0])
    np.testing.assert_array_equal(env.truth.lengths, [1.4, 1.0])
    assert np.abs(env.truth.leakage).max() > 0.1


@pytest.mark.parametrize(
    "arm",
    [
        SECTION_2_2,
        TABLE_1.as_rods(),
        ArmParameters(gravity=1.6),
        ArmParameters(m1=1.0, m2=2.0, L1=0.3, L2=0.4, centre=0.7, inertia=0.2),
    ],
)
def test_the_arm_reaches_the_plant_and_the_nominal_model(arm):
    env = TwoLinkArmEnv(arm=arm)
    env.reset(seed=0)
    assert env.nominal == arm
    np.testing.assert_allclose(env.truth.lumped, arm.lumped, rtol=1e-15)
    q, v = env.truth.position, env.truth.velocity
    for _ in range(5):
        env.step((0.01, 0.02))
        q, v, torque = env.truth.position, env.truth.velocity, env.truth.applied_torque
        np.testing.assert_allclose(env.truth.acceleration, forward_dynamics(arm, q, v, torque), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(env.truth.leakage, 0.0, atol=1e-8)


# What a task asks for touches neither the plant's parameters nor what the sensors add.

UNRELATED = ("applied_torque", "disturbance", "masses", "lengths", "payload")
CROWDED = {
    "parameter_error": {"radius": 0.5, "payload": {"mass": 3.0, "pick_up": 0.3}},
    "disturbance": {"kind": "piecewise-constant", "amplitude": 20.0, "period": 0.07},
    "noise": {"position": 0.01, "velocity": 0.1},
    "friction": {"coulomb": 3.0},
}


def readings(layout, seen, truths):
    """What the sensors added: [steps + 1 x lanes x 4]."""
    added = [seen[..., layout[name]] - [getattr(truth, name) for truth in truths] for name in ("position", "velocity")]
    return np.concatenate(added, axis=-1)


@pytest.mark.parametrize(
    "change",
    [
        {"reference": {"kind": "fourier"}},
        {"reference": {"kind": "steps", "period": 0.3}},
        {"reference": {"kind": "minimum-jerk", "low": 0.0, "high": 1.0}},
        {"initial_error": (0.2, -0.1)},
        {"friction": None},
        {"arm": {"gravity": 0.0}},
    ],
    ids=str,
)
def test_another_task_in_the_same_world(change):
    ours, theirs = play(**{**CROWDED, **change}), play(**CROWDED)
    np.testing.assert_allclose(readings(*ours), readings(*theirs), atol=1e-11)
    assert same(ours[2][1:], theirs[2][1:], *UNRELATED)
    assert not same(ours[2][5:], theirs[2][5:], "position", "reference")


@pytest.mark.parametrize(
    "change",
    [
        {"reward": {"tracking": "l1", "weight_effort": 3.0}},
        {"preview": 4},
        {"duration": 4.0},
        {"limits": {"position": 50.0, "velocity": 200.0, "command": 5.0}},
        {"name": "another", "description": "of the same"},
    ],
    ids=str,
)
def test_what_does_not_concern_the_arm_does_not_move_it(change):
    """Everything measured, and the whole truth, to the bit."""
    options = {"action": "torque", "limits": {"position": 100.0}, **CROWDED}
    one, two = TwoLinkArmVectorEnv(20, **{**options, **change}), TwoLinkArmVectorEnv(20, **options)
    a, b = one.reset(seed=0)[0], two.reset(seed=0)[0]
    for k in range(60):
        np.testing.assert_array_equal(a[:, :12], b[:, :12])
        for name, value in vars(two.truth).items():
            np.testing.assert_array_equal(getattr(one.truth, name), value, err_msg=name)
        a, b = one.step(torques(k, 20))[0], two.step(torques(k, 20))[0]


def test_reward_reaches_the_reward():
    rewards = []
    for reward in (None, {"tracking": "l1"}, {"worst": 0.5}, {"resolution": 0.1}, {"weight_effort": 1.0}):
        env = TwoLinkArmEnv(reward=reward, initial_error=0.05)
        env.reset(seed=0)
        rewards.append(env.step((0.1, 0.1))[1])
    env = TwoLinkArmEnv(reward={"weight_chatter": 2.0}, initial_error=0.05)
    env.reset(seed=0)
    rewards.append(env.step((0.1, 0.1))[1])
    assert len(set(rewards)) == 6


def test_each_limit_reaches_its_place():
    env = TwoLinkArmEnv(
        action="acceleration", limits={"position": 1.0, "velocity": 7.0, "acceleration": 11.0, "command": 13.0}
    )
    high = env.observation_space.high
    for name, bound in (("position", 2.0), ("velocity", 14.0), ("acceleration", 11.0)):
        np.testing.assert_array_equal(high[env.layout[name]], bound)
        np.testing.assert_array_equal(high[env.layout[f"reference_{name}"]], bound)
    np.testing.assert_array_equal(env.action_space.high, np.float32(13.0))
    env.reset(seed=0)
    observation = env.step((13.0, -13.0))[0]
    assert np.abs(env.truth.acceleration).max() > 11.0
    assert np.abs(observation[env.layout["acceleration"]]).max() == 11.0


@pytest.mark.parametrize("limit", ["position", "velocity"])
def test_an_arm_diverges_just_beyond_its_limit(limit):
    """Of where it started, and of either joint; not a step sooner."""
    bound = {"position": 0.4, "velocity": 2.0}[limit]
    for torque in ((2000.0, 0.0), (0.0, -400.0)):
        env = TwoLinkArmEnv(action="torque", limits={limit: bound}, initial_error=0.3)
        env.reset(seed=0)
        start, ended = env.truth.position, False
        for _ in range(100):
            ended = env.step(torque)[2]
            gone = env.truth.position - start if limit == "position" else env.truth.velocity
            assert ended == bool(np.abs(gone).max() > bound)
            if ended:
                break
        assert ended


def test_friction_of_one_joint_is_of_that_joint():
    for joint in (0, 1):
        level = [0.0, 0.0]
        level[joint] = 6.0
        for part in ("viscous", "coulomb", "stiction"):
            _, _, truths = play(steps=30, friction={part: level, "v_s": 100.0})
            friction = np.array([truth.friction_torque for truth in truths])
            assert not friction[..., 1 - joint].any()
            assert np.any(friction[5:, :, joint] != 0.0)


def test_the_laws_of_friction_differ_at_rest_only_in_what_sticks():
    """A joint at rest is held by the exact law, and feels nothing by the printed one."""
    rest = {"arm": {"gravity": 0.0}, "reference": {"kind": "minimum-jerk", "points": [(0.0, 0.0)]}, "action": "torque"}
    moved = {}
    for law in ("exact", "literal"):
        env = TwoLinkArmEnv(friction={"coulomb": 20.0, "law": law}, **rest)
        env.reset(seed=0)
        env.step((5.0, 0.0))
        moved[law] = env.truth.position
    np.testing.assert_array_equal(moved["exact"], 0.0)
    assert np.abs(moved["literal"]).max() > 0.0


def test_a_joint_that_keeps_moving_has_the_same_friction_by_both_laws():
    """The laws differ at rest; in motion both are the printed curve, so that a swing agrees as closely as the step allows."""
    swings = []
    for law in ("exact", "literal", None):
        friction = law and {"viscous": 1.0, "coulomb": (6.0, 3.0), "stiction": 2.0, "v_s": 4.0, "law": law}
        env = TwoLinkArmEnv(action="acceleration", friction=friction, physics_dt=1e-4)
        env.reset(seed=0)
        for _ in range(40):
            env.step((4.0, 6.0))
            assert np.all(env.truth.velocity > 0.0)
        swings.append(env.truth.position)
    np.testing.assert_allclose(swings[1], swings[0], rtol=0, atol=1e-4)
    assert np.abs(swings[2] - swings[0]).max() > 1e-2


def test_leakage_is_what_the_nominal_model_expects_less_what_happens():
    """Equation (5): the acceleration is a - LS, with a that which the applied torque gives the nominal arm."""
    env = TwoLinkArmEnv(
        action="acceleration", parameter_error={"ratio": (2.0, 0.5, 1.2, 0.9)}, friction={"viscous": 5.0}
    )
    env.reset(seed=0)
    np.testing.assert_allclose(
        env.truth.leakage, -env.truth.acceleration, atol=1e-9
    )  # the nominal arm would hold still
    for a in ((1.0, -2.0), (-3.0, 0.5)):
        env.step(a)
        truth = env.truth
        expected = forward_dynamics(TABLE_1, truth.position, truth.velocity, truth.applied_torque)
        np.testing.assert_allclose(truth.acceleration, expected - truth.leakage, rtol=1e-12)
        assert np.abs(truth.leakage).max() > 0.1


def test_leakage_of_a_disturbance_alone_is_what_it_does_to_the_arm():
    """Equation (6): LS = M^-1 tau_d."""
    env = TwoLinkArmEnv(disturbance={"kind": "array", "torque": [(30.0, -7.0)]})
    env.reset(seed=0)
    for _ in range(10):
        env.step((0.05, 0.01))
        truth = env.truth
        np.testing.assert_array_equal(truth.disturbance, [30.0, -7.0])
        expected = np.linalg.solve(inertia_matrix(TABLE_1, truth.position), [30.0, -7.0])
        np.testing.assert_allclose(truth.leakage, expected, rtol=1e-8)
