"""Linear analysis, against python-control's analytic loop and the environment with a delay."""

import dataclasses
import math

import control
import numpy as np
import pytest

from benchmarks.policies.spec import resolve
from benchmarks.run import linearize as linear
from benchmarks.run.cell import Cell
from benchmarks.run.linearize import POINT, linearize, margin_metrics
from benchmarks.run.loop import NotLinear
from benchmarks.run.metrics import MARGINS
from benchmarks.run.rollout import make_env
from benchmarks.run.runner import run_cell
from fbl_gym.records.record import scaled
from fbl_gym.scenarios import Scenario, get

AT_REST = {"kind": "array", "position": [POINT] * 2, "velocity": [(0.0, 0.0)] * 2, "acceleration": [(0.0, 0.0)] * 2}


def test_margins_of_pid_on_double_integrators_are_those_of_python_control():
    """Without gravity and with an exact model, each joint is a held double integrator."""
    dt, kp, ki, kd = 0.01, 100.0, 200.0, 20.0
    loop = linearize(f"pid-flm@kp={kp}@ki={ki}@kd={kd}", Scenario(arm={"gravity": 0.0}))

    def loop_transfer(z):
        return (kp + ki * dt / (z - 1)) * dt**2 / 2 * (z + 1) / (z - 1) ** 2 + kd * dt / (z - 1)

    proportional, integral = kp * dt**2 / 2 * np.array([1, 0, -1]), ki * dt**3 / 2 * np.array([0, 1, 1])
    derivative = kd * dt * np.array([1, -2, 1])
    analytic = control.TransferFunction(proportional + integral + derivative, [1, -3, 3, -1], dt)
    gains, phase, distance, _, crossover, _ = control.stability_margins(analytic, returnall=True)
    margins = loop.margins()
    for joint in (0, 1):
        frequencies, transfer = loop.response(joint, points=50)
        np.testing.assert_allclose(transfer, loop_transfer(np.exp(1j * dt * frequencies)), rtol=1e-6)
        assert margins.gain_lower[joint] == pytest.approx(max(gains[gains < 1.0]), rel=1e-3)
        at_nyquist = 1.0 / abs(loop_transfer(-1.0))
        assert margins.gain_upper[joint] == pytest.approx(min([at_nyquist, *gains[gains > 1.0]]), rel=1e-3)
        assert margins.phase[joint] == pytest.approx(min(phase), rel=1e-3)
        assert margins.sensitivity[joint] == pytest.approx(1.0 / min(distance), rel=1e-3)
    # The formula neglects the hold's part of a sample.
    assert margins.delay == pytest.approx(np.radians(min(phase)) / crossover[np.argmin(phase)], rel=0.02)


def speeds(policy, scenario, state=None, change=lambda action, k: action, **stated):
    """Return the largest speed in each quarter of an episode at rest, [4]; infinite if the arm diverges.

    The policy is told what is `stated` of the sensors.
    """
    spec = resolve(policy)
    env = make_env(spec, scenario.replace(reference=AT_REST), 1)
    actor, (observation, _) = spec.make(dataclasses.replace(env.interface, **stated)), env.reset(seed=[0])
    largest = []
    for k in range(env.scenario.steps - 1):
        action, state = actor.predict(observation, state=state)
        observation, _, terminated, _, _ = env.step(change(action, k))
        if terminated[0]:
            return [math.inf] * 4
        largest.append(np.abs(env.truth.velocity).max())
    return [max(part) for part in np.array_split(largest, 4)]


def settles(policy, **options):
    """Return True if a small error dies out in the environment."""
    quarters = speeds(policy, Scenario(initial_error=1e-6, physics_dt=2.5e-4, duration=12.0, **options))
    return quarters[3] < 1e-3 and (quarters[3] < quarters[1] or quarters[3] < 1e-9)


#: Another real arm than the nominal one, and a lag. Without gravity, a wrong model rests where a
#: right one does.
REAL = {
    "arm": {"gravity": 0.0, "rotor": (4.0, 1.0)}, "friction": {"viscous": 20.0}, "actuator": {"lag": 0.01},
    "parameter_error": {"ratio": {"m1": 1.3, "m2": 0.7}, "payload": 5.0},
}  # fmt: skip


@pytest.mark.parametrize(("policy", "options"), [
    ("pd-gravity", {}), ("pid-flm@tuned", {}), ("cascade-flm", {}), ("lqg@tuned", {}), ("cascade-flm@tuned", {}),
    ("rbf-adaptive", {}), ("computed-torque", {}), ("computed-torque", REAL),
])  # fmt: skip
def test_the_delay_margin_is_the_delay_at_which_the_environment_becomes_unstable(policy, options):
    step, delay = 2.5e-4, linearize(policy, Scenario(**options)).margins().delay
    assert not options or delay < linearize(policy).margins().delay - 0.003
    for share, rounded in ((0.98, math.floor), (1.02, math.ceil)):
        drive = {**options.get("actuator", {}), "delay": rounded(share * delay / step) * step}
        assert settles(policy, **{**options, "actuator": drive}) == (share < 1.0)


def test_the_steps_of_a_derivative_may_exceed_the_torque_limit():
    """But not the torque that holds the arm."""
    law, loose, delays = "sliding-mode+springs@tuned", get("geared-nominal"), []
    for share in (1.0, 0.45):
        drive = dataclasses.replace(loose.actuator, torque_limit=scaled(loose.actuator.torque_limit, share))
        delays.append(linearize(law, loose.replace(actuator=drive)).margins().delay)
    assert delays[0] == pytest.approx(delays[1], rel=1e-3)
    with pytest.raises(NotLinear, match="the drives cannot hold the arm there"):
        linearize(law, loose.replace(actuator=dataclasses.replace(drive, torque_limit=1.0)))


@pytest.mark.parametrize(("policy", "name", "link"), [
    ("computed-torque", "geared-nominal", None),
    ("pd-gravity", "servo-elastic-2", None),
    ("pid-gravity", "servo-elastic-1", None),
    ("pd-gravity", "servo-nominal", 15.0),
    ("computed-torque", "geared-nominal", 8.0),
])  # fmt: skip
def test_the_delay_margin_holds_with_springs_and_velocities_of_encoders(policy, name, link):
    """Encoders on the motors (geared) and on the links (servo), which both compute the velocity."""
    step, base = 1e-4, get(name)
    drive = dataclasses.replace(base.actuator, ripple=0.0, delay=0.0)
    more = {"encoder": {"difference": 1, "low_pass": 30.0}, "friction": {"viscous": 0.02}, "link": link}
    base = base.replace(physics_dt=step, initial_error=0.0, actuator=drive, duration=12.0, **more)
    delay = linearize(policy, base).margins().delay
    for factor, rounded in ((0.96, math.floor), (1.04, math.ceil)):
        late = dataclasses.replace(drive, delay=rounded(factor * delay / step) * step)
        _, _, third, last = speeds(policy, base.replace(actuator=late))
        assert last < 0.9 * third if factor < 1 else last > 0.99 * third


@pytest.mark.parametrize(("policy", "options", "less"), [
    ("lqg", {"actuator": {"delay": 0.004}}, 0.004), ("pd-gravity", {"encoder": {"latency": 1}}, 0.01),
    ("pid-flm", {"encoder": {"counts": 4096}}, 0.0), ("pid-flm", {"actuator": {"torque_limit": 5e29}}, 0.0),
    ("pid-flm", {"actuator": {"jitter": 0.004}}, 0.002),
])  # fmt: skip
def test_what_is_late_in_drive_and_encoder_is_taken_off_the_delay_margin(policy, options, less):
    plain, late = linearize(policy), linearize(policy, Scenario(**options))
    assert late.margins().delay == pytest.approx(plain.margins().delay - less, abs=1e-5)


def test_more_observed_actions_than_the_delay_has_do_not_change_the_margins():
    """A delay that varies has as many observed actions as its longest value; the loop has that of its seed."""
    task = Scenario(actuator={"delay": {"uniform": [0.0, 0.04]}}, control_dt=0.003, duration=3.0)
    varying = linearize("pd-gravity", task)
    fixed = linearize("pd-gravity", task.replace(actuator={"delay": varying.delay}))
    assert fixed.margins().delay == pytest.approx(varying.margins().delay, abs=2e-5)


def test_a_drive_of_half_the_gain_allows_twice_the_gain():
    """The whole loop scales with the drive's gain, as it does in the environment."""
    options = {"arm": {"gravity": 0.0}}
    tasks = (Scenario(actuator=actuator, **options) for actuator in (None, {"gain": 0.5}))
    full, half = (linearize("pid-flm@kp=100@ki=200@kd=20", task).margins() for task in tasks)
    for joint in (0, 1):
        assert half.gain_upper[joint] == pytest.approx(2.0 * full.gain_upper[joint], rel=1e-3)
        assert half.gain_lower[joint] == pytest.approx(2.0 * full.gain_lower[joint], rel=1e-3)


def test_the_response_is_that_of_python_control():
    """The sensitivity of both torques at once, S = (I - K P)^-1, has 1 / (1 + L) of each joint on its diagonal."""
    loop = linearize("lqg", get("payload-2"))
    plant, law = (control.StateSpace(*parts, loop.control_dt) for parts in ((*loop.plant(), 0.0), loop.matrices))
    for joint in (0, 1):
        frequencies, transfer = loop.response(joint, points=20)
        z = np.exp(1j * loop.control_dt * frequencies)
        opened = np.moveaxis(np.eye(2)[..., None] - np.einsum("ijw,jkw->ikw", law(z), plant(z)), -1, 0)
        np.testing.assert_allclose(1.0 / (1.0 + transfer), np.linalg.inv(opened)[:, joint, joint], rtol=1e-6)


LOOSE = {"stiffness": 1e5, "damping": 100.0, "rotor_inertia": 100.0, "backlash": 1e-3}


@pytest.mark.parametrize(("policy", "options", "reason"), [
    ("sliding-mode@layer=0", {}, "jumps"),
    ("adaptive-flm", {}, "does not follow"),
    ("oracle-flm", {}, "reads the true state"),
    ("zero", {}, "torque is constant"),
    ("computed-torque-tde", {"parameter_error": 0.2}, "unstable"),
    ("computed-torque", {"arm": {"gravity": 0.0}, "joint": LOOSE}, "within the gap"),
])  # fmt: skip
def test_a_loop_without_margins_says_why(policy, options, reason):
    with pytest.raises(NotLinear, match=reason):
        linearize(policy, Scenario(**options)).margins()


def test_the_command_prints_margins_or_the_reason(fbl_gym):
    printed = fbl_gym(["margins", "cascade-flm", "sliding-mode@layer=0", "--at", "-1", "0.5"]).out
    assert " ms " in printed
    assert "no margins of sliding-mode@layer=0: the law jumps" in printed


ROWS = [
    ("servo", "lqg-elastic@tuned"), ("servo", "lqg@tuned"), ("servo", "computed-torque-eso@tuned"),
    ("servo", "h-infinity+predictor@tuned"), ("geared", "lqg-elastic@tuned"), ("geared", "l1-adaptive+springs@tuned"),
    ("geared", "sliding-mode+springs@tuned"), ("geared", "computed-torque-dob+springs@tuned"),
    ("direct", "cascade-flm@tuned"), ("direct", "pid-flm@tuned"),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "policy"), ROWS)
def test_rows_of_the_boards_are_stable_up_to_their_margins(robot, policy):
    """With 0.9 times the further gain or delay a disturbed arm comes to rest; with 1.1 times it does not."""
    spec, task = resolve(policy), linear._without_jitter(get(f"{robot}-nominal"))
    margins, truth = linearize(policy, task).margins(), make_env(spec, task, 1)
    truth.reset(seed=[0])
    told, delay = sum(task.actuator.facts(task)["delay"]) / 2, float(truth.truth.delay[0])
    _, learned, *_ = linear._run(spec, task, POINT, [0], {})
    calm = linear._calm(task, spec).replace(initial_error=0.0, duration=9.0, physics_dt=1e-4, datasheet={"delay": told})

    def rests(gain, later):
        steps, gains = round((delay + later) / 1e-4), np.where(np.arange(2) == joint, gain, 1.0)
        drive = dataclasses.replace(calm.actuator, delay_samples=0, delay=1e-4 * steps)
        stated = {name: getattr(truth.interface, name) for name in ("noise_std", "resolution")}
        # The estimates find the arm first.
        changed = calm.replace(actuator=drive)
        quarters = speeds(spec, changed, learned, lambda x, k: x * gains if k > 500 else x, **stated)
        return quarters[3] < max(1e-8, min(1.0, 0.97 * quarters[2]))  # at its torque limits, a swing may vary

    joint = int(np.argmin(margins.gain_upper))
    assert [rests(1.0 + factor * (margins.gain_upper[joint] - 1.0), 0.0) for factor in (0.9, 1.1)] == [True, False]
    assert [rests(1.0, factor * margins.delay) for factor in (0.9, 1.1)] == [True, False]


def test_a_schedule_at_rest_has_the_margins_of_its_fast_law():
    """It mixes the careful law in within some 1e-6 rad, less than the steps of the other laws' derivatives."""
    laws = map(resolve, ("lqg-elastic-scheduled@tuned", "lqg-elastic@tuned@observer=1.3x"))
    scheduled, fast = (margin_metrics(law, get("geared-nominal"), (0, 4)) for law in laws)
    for one, other in zip(scheduled, fast, strict=True):
        assert one == pytest.approx(other, rel=0.01)


def test_a_board_has_the_margins_of_its_nominal_arms():
    """The margins are of its first arms; a short board has none."""
    cells = (("nominal", 16), ("nominal", 8), ("delay-2", 16))
    nominal, short, late = (run_cell(Cell("pid-flm@tuned", f"servo-{name}", range(n))).rows for name, n in cells)
    for seed, row in enumerate(nominal[:2]):
        margins = linearize("pid-flm@tuned", "servo-nominal", seed=seed).margins()
        expected = min(margins.phase), margins.delay / 0.01, min(margins.gain_upper), max(margins.sensitivity)
        assert [row[name] for name in MARGINS] == pytest.approx(expected, rel=1e-3)
    assert np.isnan([row[name] for row in (*nominal[8:], *short, *late) for name in MARGINS]).all()
    (unstable,) = margin_metrics(resolve("pd-gravity@frequency=30"), get("servo-nominal"), [0])
    assert unstable["phase_deg"] == unstable["delay_samples"] == 0.0
