"""Laws composed with observers, predictor, springs and safety filter, which `Filtered` puts around any policy."""

import numpy as np
import pytest

import controllers
from benchmarks.policies.spec import resolve
from controllers.base import leaves
from controllers.composition import Composed, Filtered
from controllers.drive import Drive
from controllers.parts import OBSERVERS, Barrier, Springs
from controllers.registry import CATALOGUE
from fbl_gym import TABLE_1, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.arm import forward_dynamics, inverse_dynamics
from fbl_gym.records.record import tuning_ranges
from tests.controllers.closed_loop import broken_promises, loop, mean_error

LAWS = [name for name, law in CATALOGUE.items() if "access" not in law]


def test_the_prediction_of_one_arm_has_the_bits_of_its_row_in_a_batch():
    """Alone, it is computed with floats. One arm is faster than `FASTEST`."""
    drive, (q, v, f, now, command) = Drive(0.01, 0.013, 0.01), np.random.default_rng(0).normal(size=(5, 20, 2))
    v[3], steps, commands = 500.0, np.array([0.003, 0.01]), np.array([99.0 * command, 0.5 * command])
    batch = drive.predict(TABLE_1, [q, v, now], f, steps, commands)
    for i in range(len(q)):
        row = slice(i, i + 1)
        alone = drive.predict(TABLE_1, [q[row], v[row], now[row]], f[row], steps, commands[:, row])
        assert all((x == y[row]).all() and x.shape == (1, 2) for x, y in zip(alone, batch, strict=True))


@pytest.mark.parametrize("action", ["normalized", "acceleration"])
@pytest.mark.parametrize(("delay", "lag", "latency"), [(1, 0, 0), (3, 0, 1), (2, 0.01, 2), (0, 0.02, 0), (0, 0, 1)])
def test_with_an_exact_model_the_prediction_is_the_true_motion(action, delay, lag, latency):
    """Position, velocity and torque at the time when the next command acts."""
    env = TwoLinkArmEnv(actuator={"delay_samples": delay, "lag": lag}, encoder={"latency": latency}, action=action)
    law = controllers.make("computed-torque+predictor", env)
    predicted, true = [], []
    for observation, state, *_ in loop(law, env, 60, seed=1):
        acting = (state or law.initial(observation[None])).acting
        now = [*law.read(observation[None], "position", "velocity"), acting.torque]
        commands = acting.queue.swapaxes(0, 1)[::-1]
        predicted.append(law.drive.predict(env.interface.nominal, now, 0.0 * now[0], law.drive.coming, commands))
        true.append((env.truth.position, env.truth.velocity, env.truth.applied_torque))
    predicted, true = np.array(predicted)[10 : 60 - delay, :, 0], np.array(true)[10 + delay :]
    np.testing.assert_allclose(predicted[:, :2], true[:, :2], atol=2e-5)
    np.testing.assert_allclose(predicted[:, 2], true[:, 2], atol=2e-3)


LATE = {"delay_samples": 1}, {"delay": 0.013}, {"delay_samples": 3}, {"delay_samples": 2, "lag": 0.01}


@pytest.mark.parametrize("actuator", LATE)
def test_a_predictor_undoes_the_delay(actuator):
    """With an exact model and a preview, the error is near that without delay."""
    ideal = mean_error("computed-torque", preview=5)
    late = mean_error("computed-torque+predictor", preview=5, actuator=actuator)
    assert late < 1.1 * ideal + (1e-4 if "lag" in actuator else 2e-5)
    assert mean_error("computed-torque", actuator=actuator) > 2.5 * ideal


SPRINGS = {
    "joint": {"stiffness": (60e3, 12e3), "damping": (60.0, 15.0), "rotor_inertia": (9.0, 1.1), "encoder": "motor"},
    "reference": {"kind": "sine", "amplitude": 0.8, "frequency": 0.4, "centre": (-1.2, 0.3)},
    "control_dt": 0.001, "physics_dt": 0.0005,
}  # fmt: skip


def test_the_links_follow_where_the_motors_lead_by_the_deflection():
    """With an exact model, encoders on the motors: the error falls to a tenth."""
    names = (f"computed-torque-dob{part}@frequency=60" for part in ("", "+springs"))
    without, with_part = (mean_error(name, steps=2000, **SPRINGS) for name in names)
    assert with_part < 0.1 * without


def test_the_motors_reference_is_that_of_the_springs_torque():
    """Deflection by the stiffness; its rate and acceleration against central differences of the deflection."""
    env = TwoLinkArmVectorEnv(3, **SPRINGS)
    env.reset(seed=0)
    springs, memory, moved = Springs(env.interface), np.full((3, 2, 2), np.inf), []
    stiffness, dt = np.array([60e3, 12e3]), env.interface.control_dt
    t = dt * np.arange(400)[:, None, None] + 0.1 * np.arange(3)[:, None]
    r, v, a = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    references = [np.repeat(x, 2, axis=-1) * np.array([0.8, 0.5]) for x in (r, v, a)]
    deflection = inverse_dynamics(env.interface.nominal.lumped, *references) / stiffness
    for k in range(400):
        reference = np.concatenate([x[k] for x in references], axis=-1)[:, None]
        shifted, memory = springs.moved(reference, memory)
        moved.append((shifted - reference)[:, 0])
    moved = np.array(moved)
    np.testing.assert_allclose(moved[..., :2], deflection, rtol=1e-9, atol=1e-15)
    rate = np.gradient(deflection, dt, axis=0)
    assert not moved[0, :, 2:].any()
    assert not moved[1, :, 4:].any()
    np.testing.assert_allclose(moved[1:, :, 2:4], rate[1:], atol=0.01 * np.abs(rate).max())
    np.testing.assert_allclose(moved[3:, :, 4:], np.gradient(rate, dt, axis=0)[3:], atol=0.1)


@pytest.mark.parametrize("joint", [None, {**SPRINGS["joint"], "encoder": "link"}])
def test_without_springs_before_the_encoder_the_reference_stays(joint):
    options = {**SPRINGS, "joint": joint}
    assert mean_error("computed-torque+springs", **options) == mean_error("computed-torque", **options)


@pytest.mark.parametrize("name", OBSERVERS)
@pytest.mark.parametrize("wrong_model", [False, True])
def test_an_observer_estimates_the_motion(name, wrong_model):
    """With an exact model, those that use it are exact; a wrong model disturbs "kalman" most."""
    ratio = 0.75 if wrong_model else 1.0
    env = TwoLinkArmEnv(sensors=("position",), actuator={"delay": 0.005, "lag": 0.01}, parameter_error=ratio)
    gains = {f"{name}_bandwidth": 150.0}
    law = controllers.make(f"computed-torque+{name}", env, frequency=5.0, **gains)
    errors = []
    for observation, state, *_ in loop(law, env, 300):
        state, truth = state or law.initial(observation[None]), env.truth
        estimate = law._look(observation[None], state)[1][0]
        errors.append(estimate[:, :3].T - [truth.position, truth.velocity, truth.acceleration])
    position, velocity, acceleration = np.abs(errors[50:]).mean(axis=(0, 2))
    largest = {"kalman": 0.05 if wrong_model else 1e-3, "eso": 1e-3}
    assert position < 2e-4
    assert velocity < largest[name]
    assert acceleration < 0.1


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("parts", ["", "+kalman+predictor"])
def test_every_law_keeps_its_promises_on_a_late_position_sensor_alone(name, parts):
    """And a drive that is late too."""
    late = {"actuator": {"delay_samples": 1, "delay": 0.013, "lag": 0.01}, "encoder": {"latency": 1}}
    scenario = scenarios.get("everything-2").replace(duration=0.3, noise=None, sensors=("position",), **late)
    found = broken_promises(name + parts, scenario)
    assert [text for text in found if "action='acceleration' linearises with" not in text] == []  # needs a velocity


def test_a_missing_sensor_is_estimated():
    """With all sensors the law itself is made."""
    env = TwoLinkArmEnv(sensors=("position",))
    law = controllers.make("computed-torque", env, frequency=9.0)
    assert law.frequency == (9.0, 9.0)
    plain = controllers.make("computed-torque", TwoLinkArmEnv()), controllers.make("computed-torque-eso", env)
    assert [isinstance(each, Composed) for each in (law, *plain)] == [True, False, False]
    assert mean_error("computed-torque", sensors=("position",)) < 1.2 * mean_error("computed-torque")


def test_a_composition_has_the_gains_of_law_and_parts():
    spec = resolve("pid-flm+eso+predictor+barrier")
    assert (spec.access, spec.needs, spec.tuning, spec.problem) == ("nominal", ("position",), "default gains", "")
    assert spec.summary.endswith("; with eso and predictor and barrier")
    assert {"kp", "eso_bandwidth", "predictor_lead"} <= set(tuning_ranges(spec.factory()))
    gains = {"kp": 30.0, "eso_bandwidth": 70.0, "predictor_lead": 1.0, "barrier_margin": 0.1}
    law = spec.make(TwoLinkArmEnv(actuator={"lag": 0.01}), **gains)
    made = law._inside.kp[0], law._observer.bandwidth[0], law._predictor.lead, law._barrier.margin[0]
    assert made == tuple(gains.values())


@pytest.mark.parametrize("name", ["computed-torque-dob", "computed-torque-dob+predictor"])
@pytest.mark.parametrize(("told", "disturbance"), [(True, 0.0), (False, -50.0)])
def test_an_observer_that_is_told_the_sent_torque_takes_it_for_no_disturbance(name, told, disturbance):
    """The model is exact, and 50 N m are added to the torque of the law."""
    env = TwoLinkArmVectorEnv(2, actuator={"delay": 0.013, "lag": 0.01}, action="torque")
    law = controllers.make(name, env)
    observation, _ = env.reset(seed=[0, 1])
    state = law.initial(observation)
    for _ in range(300):
        sent = law.torque(observation, state)[0] + 50.0
        state = (law.sending(sent) if told else law).torque(observation, state)[1]
        observation = env.step(sent)[0]
    assert np.abs(getattr(state, "inside", state).disturbance - disturbance).max() < 0.1


SETTLED = "adaptive-flm", "computed-torque-dob+predictor", "lqg-elastic", "lqg-elastic-scheduled+predictor"


@pytest.mark.parametrize("name", SETTLED)
def test_a_decision_is_settled_by_the_torque_that_is_sent(name):
    """As by a law that is told it before; and the law's own torque leads to its own next state."""
    env = TwoLinkArmVectorEnv(2, "geared-practice-payload-1")
    law = controllers.make(name, env)
    observation, _ = env.reset(seed=[0, 1])
    state = law.torque(observation, law.initial(observation))[1]
    torque, draft = law.decide(observation, state)
    for sent in (env.interface.saturate(torque), torque - 5.0):
        expected = law.sending(sent).torque(observation, state)
        np.testing.assert_array_equal(torque, expected[0])
        for each, other in zip(leaves(law.settle(draft, sent)), leaves(expected[1]), strict=True):
            np.testing.assert_array_equal(each, other)
    states = (leaves(law.settle(draft, sent)) for sent in (torque, torque - 5.0))
    assert not all(map(np.array_equal, *states))


BOX = {"low": (-2.1, -0.9), "high": (-1.1, 0.5), "velocity": (0.9, 1.2)}
#: A motion that starts within the box and leaves it on every side.
MOVES = {"kind": "minimum-jerk", "points": [(-1.5, 0.0), (-0.9, 0.7), (-2.3, -1.1)], "move_time": 0.7, "hold_time": 0.1}


def filtered(name):
    """Return what makes a policy within the safety filter."""
    return lambda env: Filtered(controllers.make(name, env), env.interface)


def motion(policy, steps=400, **options):
    """Return positions and velocities [T x 2] of an arm, and the actions of a policy: its name, or what makes it."""
    env = TwoLinkArmEnv(reference=MOVES, **{"constraints": BOX, "control_dt": 4e-3, **options})
    policy, rows = controllers.make(policy, env) if isinstance(policy, str) else policy(env), []
    for _, _, action, _ in loop(policy, env, steps + 1, seed=1):
        signals = env._batch.true_signals()
        rows.append((signals["position"][0], signals["velocity"][0], action))
    return np.moveaxis(rows, 1, 0)


def worst(positions, velocities):
    """Return the largest violation of each kind of bound [rad], [rad/s]."""
    beyond = np.maximum(np.array(BOX["low"]) - positions, positions - np.array(BOX["high"]))
    return beyond.max(), (np.abs(velocities) - np.array(BOX["velocity"])).max()


@pytest.mark.parametrize(("name", "action"), [("computed-torque", "normalized"), ("pd-gravity", "acceleration")])
def test_the_bounds_hold_with_an_exact_model_and_a_fine_rate(name, action):
    free = worst(*motion(name, action=action)[:2])
    assert min(free) > 0.05
    position, velocity = worst(*motion(f"{name}+barrier", action=action)[:2])
    assert position < 1e-4
    assert velocity < 1e-3


def test_a_predictor_keeps_the_bounds_through_a_delay():
    """A delay of 20 ms is long for a decay of 40 1/s."""
    late, names = {"actuator": {"delay_samples": 5}, "preview": 10}, ("barrier", "predictor+barrier")
    without, with_it = (worst(*motion(f"computed-torque+{name}@barrier_decay=40", **late)[:2]) for name in names)
    assert min(without) > 0.02
    assert max(with_it) < 1e-3


def test_a_filter_around_a_policy_equals_that_of_the_law():
    np.testing.assert_allclose(motion(filtered("pd-gravity"), 200), motion("pd-gravity+barrier", 200), atol=1e-9)


@pytest.mark.parametrize("constraints", [None, {"low": -9.0, "high": 9.0, "velocity": 50.0}], ids=["none", "wide"])
@pytest.mark.parametrize("name", ["pid-gravity", "slotine-li", "td3"])
def test_an_inactive_filter_changes_no_bit(name, constraints):
    def action(policy):
        return motion(policy, 60, constraints=constraints, scenario="everything-2", control_dt=0.01)[2]

    plain = action(name)
    np.testing.assert_array_equal(action(filtered(name)), plain)
    if name != "td3":
        np.testing.assert_array_equal(action(f"{name}+barrier"), plain)


def test_the_filter_solves_the_quadratic_program():
    """No other acceleration in the box is nearer to the wanted one, also for a state outside of the constraints."""
    env = TwoLinkArmEnv(constraints=BOX, actuator=None, action="torque")
    barrier, rng = Barrier(env.interface, decay=8.0, margin=0.05), np.random.default_rng(0)
    q, v, torque = rng.uniform(-2, 1, (500, 2)), rng.normal(0, 0.5, (500, 2)), rng.normal(0, 100, (500, 2))
    low, high = barrier.accelerations(q, v)
    assert (low <= high).all()
    safe, wanted = (forward_dynamics(env.interface.nominal, q, v, x) for x in (barrier.filtered(torque, q, v), torque))
    inside = (low <= wanted) & (wanted <= high)
    np.testing.assert_allclose(safe, np.clip(wanted, low, high), atol=1e-9)
    np.testing.assert_array_equal((barrier.filtered(torque, q, v) == torque).all(axis=-1), inside.all(axis=-1))
    assert 10 < inside.all(axis=-1).sum() < 490


def test_a_barrier_composes_and_keeps_every_promise():
    scenario = scenarios.get("everything-2").replace(constraints=BOX, duration=0.3)
    assert broken_promises("pid-flm+kalman+barrier", scenario) == []
