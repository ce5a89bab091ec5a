"""The option `actuator`: computation delay, lag, rate limit and gain, against SciPy's ODE solver."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import controllers
from fbl_gym import TABLE_1, TwoLinkArmEnv, TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv
from fbl_gym.model.arm import forward_dynamics, gravity_torque
from tests.fbl_gym.episodes import PLANT, needs_mujoco, play, same, started, started_batch, torques, truths_of, watch

JUMP = np.array([120.0, -25.0])
TIMES = np.arange(101) * 1e-3


def exact(torque, start, times):
    """Return positions [n x 2] by DOP853 of an arm whose torque depends on time and position; start: position, velocity."""

    def slope(t, x):
        return np.concatenate([x[2:], forward_dynamics(TABLE_1, x[:2], x[2:], torque(t, x[:2]))])

    solution = solve_ivp(slope, (0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-13, max_step=5e-4)
    return solution.y[:2].T


def ramp_and_lag(t, held, jump, rate, lag):
    """Return the torque at t after a jump of the command at 0: a ramp of a rate, then a first-order lag."""
    rise = np.minimum(np.abs(jump - held) / rate, t)
    slope = rate * np.sign(jump - held)
    if lag == 0.0:
        return held + slope * rise
    at_end = held + slope * (rise - lag * (1 - np.exp(-rise / lag)))
    target = held + slope * rise
    return target + (at_end - target) * np.exp(-(t - rise) / lag)


@pytest.mark.parametrize("lag", [2e-5, 1e-4, 1e-3, 0.02])
def test_an_arm_under_a_lag_moves_as_by_a_solver(lag):
    """A lag far below the physics step acts as a delay of its own length, which is its impulse."""
    position, velocity = watch("position", "velocity", torque=JUMP, steps=100, actuator={"lag": lag})
    held = gravity_torque(TABLE_1, position[0])
    start = np.concatenate([position[0], velocity[0]])
    expected = exact(lambda t, _: JUMP + (held - JUMP) * np.exp(-t / lag), start, TIMES)
    error = np.abs(position - expected).max()
    without = np.abs(position - exact(lambda *_: JUMP, start, TIMES)).max()
    assert error < (2e-5 if lag < 1e-3 else 5e-8)
    if lag >= 1e-4:
        assert without > 50 * error


@pytest.mark.parametrize("lag", [0.0, 5e-3])
def test_an_arm_under_a_rate_limit_moves_as_by_a_solver(lag):
    rate = 5000.0
    names, actuator = ("position", "velocity", "applied_torque"), {"rate_limit": rate, "lag": lag}
    position, velocity, applied = watch(*names, torque=JUMP, steps=100, actuator=actuator)
    held = gravity_torque(TABLE_1, position[0])
    expected = np.array([ramp_and_lag(t, held, JUMP, rate, lag) for t in TIMES])
    # The ramp's end lies within a physics step, which it lengthens.
    np.testing.assert_allclose(applied, expected, atol=rate * 1e-3)
    if lag == 0.0:
        np.testing.assert_allclose(np.abs(np.diff(applied, axis=0)).max(), rate * 1e-3)
    start = np.concatenate([position[0], velocity[0]])
    motion = exact(lambda t, _: ramp_and_lag(t, held, JUMP, rate, lag), start, TIMES)
    np.testing.assert_allclose(position, motion, atol=2e-5)


def test_a_gain_scales_the_applied_torque():
    *_, truths = play(actuator={"gain": (1.2, 0.7)})
    expected = np.array([play(steps=0)[2][0].applied_torque, *map(torques, range(100))]) * [1.2, 0.7]
    np.testing.assert_allclose([truth.applied_torque for truth in truths], expected, rtol=1e-15)


def test_delay_samples_delay_by_whole_control_steps():
    for samples, delay in ((1, 0.0), (2, 0.003)):
        ours = play(actuator={"delay_samples": samples, "delay": delay})
        theirs = play(actuator={"delay": samples * 0.01 + delay})
        np.testing.assert_array_equal(ours[1], theirs[1])
        assert same(ours[2], theirs[2], *PLANT)


def test_the_truth_has_the_state_of_the_drive():
    env = started(action="torque", actuator={"delay_samples": 1, "delay": 0.004, "lag": 0.02, "rate_limit": 9e4})
    assert (env.truth.delay, env.truth.lag) == (pytest.approx(0.014), pytest.approx(0.02))
    np.testing.assert_allclose(env.truth.rate_limit, 9e4)
    held = env.truth.applied_torque
    np.testing.assert_array_equal(env.truth.commands, [held] * 3)
    for torque in ((3.0, 1.0), (4.0, 2.0)):
        env.step(torque)
    np.testing.assert_array_equal(env.truth.commands, [(4.0, 2.0), (3.0, 1.0), held])


@pytest.mark.parametrize(("actuator", "count"), [
    ({}, 0), ({"delay": 0.001}, 1), ({"delay": 0.01}, 1), ({"delay": 0.011}, 2), ({"delay_samples": 3}, 3),
    ({"delay_samples": 1, "delay": 0.015}, 3), ({"delay": {"uniform": [0.0, 0.035]}}, 4), ({"lag": 0.01}, 1),
    ({"delay_samples": {"choice": [0, 2]}, "delay": 0.003}, 3), ({"rate_limit": 100.0}, 1),
    ({"delay": 0.02, "lag": 0.01}, 3), ({"delay": 0.013, "lag": 0.01}, 2),
], ids=str)  # fmt: skip
def test_previous_actions_are_those_on_their_way(actuator, count):
    env = TwoLinkArmEnv(actuator=actuator, preview=1)
    start, _ = env.reset(seed=0)
    layout = env.layout
    if count == 0:
        assert "previous_actions" not in layout
        return
    at = layout["previous_actions"]
    assert at.stop - at.start == 2 * count
    held = start[at][:2]
    np.testing.assert_array_equal(start[at], np.tile(held, count))
    actions = [held] * count
    for k in range(8):
        actions.insert(0, np.array([0.01 * k, -0.02]))
        observation = env.step(actions[0])[0]
        np.testing.assert_array_equal(observation[at], np.ravel(actions[:count]))
        assert observation in env.observation_space


@pytest.mark.parametrize("actuator", [{"lag": 0.05}, {"ripple": (8.0, 3.0)}, {"ripple": 5.0, "lag": 0.05, "gain": 0.9}])
@pytest.mark.parametrize("joint", [None, 1e4])
def test_a_drive_that_fails_gives_no_torque_at_once_whatever_its_lag_and_ripple(actuator, joint):
    event = {"kind": "drive", "time": 0.02, "factor": (0.0, 0.5)}
    options = {"actuator": actuator, "joint": joint, "arm": {"rotor": 1e9}}  # which hardly turns
    runs = (watch("applied_torque", torque=JUMP, steps=40, events=events, **options) for events in ([event], []))
    (applied,), (healthy,) = runs
    np.testing.assert_array_equal(applied[:21], healthy[:21])
    np.testing.assert_array_equal(applied[21:, 0], 0.0)
    np.testing.assert_allclose(applied[21:, 1], 0.5 * healthy[21:, 1], rtol=1e-2)


def test_jitter_delays_each_command_by_a_time_of_its_own():
    """Each command has a delay of its own within the jitter, which policies are told."""
    options = {"actuator": {"jitter": 0.004}, "control_dt": 0.005, "physics_dt": 0.001}
    env = started_batch(64, action="torque", **options)
    late = np.array([env.step(np.full((64, 2), 0.1 * k)) and env._batch.field("late") for k in range(200)])
    assert set(np.unique(late)) == {0.0, 1.0, 2.0, 3.0, 4.0}
    assert abs(late.mean() - 2.0) < 0.05
    assert abs(np.corrcoef(late[1:].ravel(), late[:-1].ravel())[0, 1]) < 0.03
    assert env.interface.delay == (0.0, 0.004)


LATE = [(0.004, 0.0, 0), (0.004, 0.002, 0), (0.023, 0.002, 0), (0.05, 0.0, 0), (0.012, 0.003, 2)]


@pytest.mark.parametrize(("jitter", "delay", "samples"), LATE)
def test_the_torque_under_jitter_is_that_of_the_newest_command_that_arrived(jitter, delay, samples):
    """Each command waits for its own draw; one that arrives after a newer one is without effect."""
    actuator = {"jitter": jitter, "delay": delay, "delay_samples": samples, "torque_limit": None}
    env = started_batch(9, action="torque", control_dt=0.005, physics_dt=0.001, actuator=actuator, seed=1)
    held, arrivals = env.truth.applied_torque[:, 0], []
    for k in range(120):
        env.step(np.tile([1.0 + k, 0.0], (9, 1)))
        arrivals.append(5 * (k + samples) + round(delay * 1000) + env._batch.field("late"))
        newest = np.max([np.where(arrival < 5 * (k + 1), i, -1) for i, arrival in enumerate(arrivals)], axis=0)
        np.testing.assert_array_equal(env.truth.applied_torque[:, 0], np.where(newest >= 0, 1.0 + newest, held))


def test_ripple_is_a_sine_of_the_drives_angle():
    """The joints are elastic; the next test has rigid ones."""
    amplitude, order, h = np.array([8.0, 3.0]), np.array([10.0, 24.0]), 2.5e-4
    actuator = {"ripple": amplitude, "ripple_order": order}
    joint = {"stiffness": 1e5, "damping": 50.0, "rotor_inertia": 2.0}
    env = started(action="torque", actuator=actuator, joint=joint, control_dt=1e-3, physics_dt=h, seed=3)
    phase = env._batch.field("ripple_phase")[0]
    assert np.all((phase >= 0) & (phase <= 2 * np.pi))
    for _ in range(200):
        env.step(JUMP)
        truth = env.truth
        middle = truth.motor_position - 0.5 * h * truth.motor_velocity
        ripple = amplitude * np.sin(order * middle + phase)
        np.testing.assert_allclose(truth.applied_torque - JUMP, ripple, atol=2e-3)


def test_an_arm_under_ripple_moves_as_by_a_solver():
    amplitude, order = np.array([8.0, 3.0]), np.array([10.0, 24.0])
    env = started(action="torque", control_dt=1e-3, actuator={"ripple": amplitude, "ripple_order": order})
    phase = env._batch.field("ripple_phase")[0]
    truths = truths_of(env, [JUMP] * 100)
    start = np.concatenate([truths[0].position, truths[0].velocity])
    expected = exact(lambda _, q: JUMP + amplitude * np.sin(order * q + phase), start, TIMES)
    np.testing.assert_allclose([truth.position for truth in truths], expected, atol=3e-6)


def test_ripple_at_an_episodes_start_is_of_that_episode():
    """Elastic joints too, whose motors stand where the last episode left them."""
    options = {"actuator": {"ripple": 50.0}, "joint": {"stiffness": 1e4, "rotor_inertia": 1.0}}
    env = started(action="torque", **options, seed=4)
    first = env.truth.motor_position
    env.reset(seed=9)
    for _ in range(20):
        env.step((300.0, -200.0))
    env.reset(seed=4)
    np.testing.assert_array_equal(env.truth.motor_position, first)


@pytest.mark.parametrize("plant", [None, pytest.param("mujoco", marks=needs_mujoco)])
@pytest.mark.parametrize(("action", "acts"), [("normalized", 6.0), ("torque", 1.0), ("acceleration", None)])
def test_a_joint_without_a_drive_moves_freely_and_laws_refuse_it(action, acts, plant):
    options = {"scenario": "dfki-c1-acrobot", "action": action, "plant": plant, "info": True}
    env, batch = TwoLinkArmTrackingEnv(**options), TwoLinkArmTrackingVectorEnv(2, **options)
    for each in (env, batch):
        each.reset(seed=0)
        observation, reward, _, _, info = each.step(np.ones((2, 2) if each is batch else 2))
        torque = np.atleast_2d(each.truth.applied_torque)
        assert (torque[:, 0] == 0.0).all()
        assert acts is None or (torque[:, 1] == acts).all()
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
        np.testing.assert_array_equal(info["saturation"], 0.5 if acts == 6.0 else 0.0)
    assert env.interface.torque_limit == (0.0, 6.0)
    with pytest.raises(ValueError, match="ComputedTorque needs both drives"):
        controllers.make("computed-torque", env.interface)
