"""The paper's laws against what theory says of them: linear error equations, roots, saturation."""

import numpy as np
import pytest
from scipy.linalg import expm

import controllers
from fbl_gym import SECTION_2_2, TABLE_1, TwoLinkArmEnv, TwoLinkArmVectorEnv

STILL = {"kind": "minimum-jerk", "points": ((-1.0, 0.5),)}
FAST = {"control_dt": 1e-3, "physics_dt": 1e-3}


def errors(policy, env, steps, seed=0):
    """Tracking error [steps + 1 x 2] of the true arm."""
    observation, _ = env.reset(seed=seed)
    state, log = None, [env.truth.reference - env.truth.position]
    for _ in range(steps):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
        log.append(env.truth.reference - env.truth.position)
    return np.array(log)


def linear(a, x0, dt, steps):
    """First component of x' = a x from x0, at each sample."""
    step, x, log = expm(np.array(a) * dt), np.array(x0), []
    for _ in range(steps + 1):
        log.append(x[0])
        x = step @ x
    return np.array(log)


def pid_deviation(arm, pose, start, dt):
    """Largest distance of pid-flm's error from e'' + 3 e' + 10 e = 0 over 4 s, as a share of its amplitude, per joint."""
    reference = {"kind": "minimum-jerk", "points": (pose,)}
    env = TwoLinkArmEnv(
        arm=arm, actuator=None, action="torque", reference=reference, initial_error=start, control_dt=dt, physics_dt=dt
    )
    steps = round(4.0 / dt)
    found = errors(controllers.make("pid-flm", env), env, steps)
    expected = [linear([[0, 1], [-10, -3]], [-x, 0.0], dt, steps) for x in start]
    return np.abs(found - np.transpose(expected)).max(axis=0) / np.abs(start).max()


@pytest.mark.parametrize("arm", [TABLE_1, SECTION_2_2], ids=["table-1", "section-2-2"])
def test_pid_error_obeys_its_linear_equation(arm):
    """Exact model, no noise, 1 kHz: e'' + 3 e' + 10 e = 0 within 1e-3 of its amplitude, for both joints."""
    assert pid_deviation(arm, (0.0, 0.0), (-0.2, 0.2), 1e-3).max() < 1e-3


def test_pid_deviation_is_the_sampling():
    """Hanging, Table 1's gravity changes while the torque is held, and the deviation is 2.4e-3; it halves with the interval."""
    coarse = pid_deviation(TABLE_1, (-1.0, 0.5), (-0.2, 0.2), 1e-3)
    fine = pid_deviation(TABLE_1, (-1.0, 0.5), (-0.2, 0.2), 5e-4)
    assert coarse.max() < 3e-3
    np.testing.assert_allclose(fine / coarse, 0.5, atol=0.02)


def test_pid_is_decoupled():
    """With an exact model, an error of one joint does not reach the other."""
    assert pid_deviation(TABLE_1, (0.0, 0.0), (0.3, 0.0), 1e-3)[1] < 2e-4


def test_the_printed_gains_are_unstable():
    """P, I, D = 10, 3, 0 as printed: the error grows as exp(0.149 t), the roots of s^3 + 10 s + 3."""
    env = TwoLinkArmEnv(
        actuator=None, action="torque", reference=STILL, initial_error=(0.01, 0.0), duration=20.0, **FAST
    )
    found = errors(controllers.make("pid-flm", env, kp=10, ki=3, kd=0), env, 19999)[:, 0]
    roots = np.roots([1, 0, 10, 3])
    growth = roots.real.max()
    assert growth == pytest.approx(0.149, abs=1e-3)
    early, late = np.abs(found[4000:6000]).max(), np.abs(found[17000:19000]).max()
    assert late > 3 * early
    assert np.log(late / early) / 13.0 == pytest.approx(growth, rel=0.1)


def test_cascade_error_obeys_its_linear_equation():
    """Exact model: with w = Kp e + e' the inner loop is w' ... a = P w + I int(w), so e''= -P w - I int(w)."""
    kp, p, i = 10.0, 30.0, 13.0
    env = TwoLinkArmEnv(actuator=None, action="torque", reference=STILL, initial_error=(-0.2, 0.0), **FAST)
    found = errors(controllers.make("cascade-flm", env), env, 3000)[:, 0]
    # x = (e, e', int w):  e'' = -P (e' + Kp e) - I int w.
    a = [[0, 1, 0], [-p * kp, -p, -i], [kp, 1, 0]]
    expected = linear(a, [0.2, 0.0, 0.0], 1e-3, 3000)
    assert np.abs(found - expected).max() < 6e-3 * 0.2


def test_cascade_inner_poles():
    """The errata's -29.6 and -0.44 for P, I = 30, 13: settling takes about 0.1 s, not the paper's 0.01 s."""
    assert np.sort(np.roots([1, 30, 13])) == pytest.approx([-29.56, -0.4398], abs=1e-2)


def test_integral_action_removes_a_constant_load():
    options = {"reference": STILL, "disturbance": {"kind": "array", "torque": ((30.0, 10.0),)}, "duration": 30.0}
    env = TwoLinkArmEnv(**options)
    found = errors(controllers.make("cascade-flm", env), env, 2999)
    assert np.abs(found[-1]).max() < 1e-4
    assert np.abs(found[100]).max() > 1e-3


@pytest.mark.parametrize("name", ["pid-flm", "cascade-flm"])
def test_integrators_pause_while_the_torque_saturates(name, monkeypatch):
    """Held back by its torque limit, the arm does not store what would throw it past the reference."""
    gains = {"ki": 20.0, "kp": 30.0, "kd": 10.0} if name == "pid-flm" else {}
    options = {
        "reference": {"kind": "minimum-jerk", "points": ((-0.6, 0.0),)},
        "initial_error": (-1.0, 0.0),
        "actuator": {"torque_limit": (330.0, 120.0)},
    }

    def overshoot(**changes):
        env = TwoLinkArmEnv(**{**options, **changes}, action="torque")
        return -errors(controllers.make(name, env, **gains), env, 900)[:, 0].min()

    paused, unlimited = overshoot(), overshoot(actuator=None)
    module = f"controllers.{name.split('-')[0]}.winds_up"
    monkeypatch.setattr(module, lambda *arguments: np.zeros_like(arguments[2], dtype=bool))
    wound_up = overshoot()
    assert wound_up > 1.3 * unlimited
    # Of the overshoot that the limit adds to that of an unlimited arm, three quarters and more are avoided.
    assert paused - unlimited < 0.25 * (wound_up - unlimited)


def test_gravity_compensation_holds_still():
    """PD with the exact gravity torque keeps a resting arm at its reference."""
    env = TwoLinkArmEnv(reference=STILL)
    assert np.abs(errors(controllers.make("pd-gravity", env), env, 500)).max() < 1e-9


def test_the_oracle_is_a_ceiling():
    """Where parameters, load and friction are wrong, the oracle tracks far better than any law that is not told."""
    mean = {}
    for name in ("oracle-flm", "cascade-flm", "pid-flm", "pd-gravity"):
        env = TwoLinkArmVectorEnv(8, "everything-3")
        observation, _ = env.reset(seed=0)
        policy, state, log = controllers.make(name, env), None, []
        for _ in range(900):
            action, state = policy.predict(observation, state)
            observation = env.step(action)[0]
            log.append(np.abs(env.truth.reference - env.truth.position).mean())
        mean[name] = np.mean(log)
    assert mean["oracle-flm"] < 0.1 * min(mean[name] for name in mean if name != "oracle-flm")
