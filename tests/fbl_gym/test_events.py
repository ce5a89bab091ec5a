"""Changes of a running arm, which act at their time and not before: payloads, events, and a hand."""

import numpy as np
import pytest

from fbl_gym import TABLE_1, ArmParameters, TwoLinkArmEnv, scenarios
from fbl_gym.envs.hand import BANDWIDTH, Hand, open_to_hand
from fbl_gym.model.arm import inertia_matrix, with_rotors
from fbl_gym.model.chain import HINGE
from tests.fbl_gym.episodes import started, truths_of, watch


def test_a_payload_acts_from_its_physics_step_on():
    """Picked up at 23 ms and dropped at 71 ms, it acts in the physics steps from 23 up to 71 ms."""
    option = {"mass": 6.0, "pick_up": 0.0231, "drop": 0.0709}
    payload, lumped, velocity = watch("payload", "lumped", "velocity", parameter_error={"payload": option})
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


@pytest.mark.parametrize(("option", "carried"), [(2.0, 2.0), ({"mass": 5.0, "drop": 4e-4}, 0.0)], ids=str)
def test_a_payload_without_a_pick_up_is_carried_at_the_start_unless_dropped_at_once(option, carried):
    payload, lumped = watch("payload", "lumped", steps=2, parameter_error={"payload": option})
    np.testing.assert_array_equal(payload, [carried] * 3)
    assert np.all((lumped > TABLE_1.lumped) == (carried > 0.0))


def test_the_drop_of_a_payload_that_an_event_released_leaves_another_one():
    """3 kg are dropped by the event, then 5 kg are picked up; the option's own drop has nothing left to release."""
    events = [{"kind": "drop", "time": 0.03}, {"kind": "pick-up", "time": 0.06, "mass": 5.0}]
    (payload,) = watch("payload", parameter_error={"payload": {"mass": 3.0, "drop": 0.09}}, events=events)
    assert [payload[k] for k in (10, 50, 80, 120)] == [3.0, 0.0, 5.0, 5.0]


PICK_UP = [{"kind": "pick-up", "time": 0.05, "mass": 6.0}]


@pytest.mark.parametrize(("payload", "events", "own", "other"), [
    ({}, [], 3.0, 0.0), ({}, PICK_UP, 3.0, 6.0), ({"mass": 0.0}, PICK_UP, 0.0, 6.0), ({"drop": 0.03}, PICK_UP, 0.0, 6.0),
    ({"drop": 0.07}, PICK_UP, 0.0, 6.0), ({"pick_up": 0.07}, PICK_UP, 3.0, 6.0),
    ({"pick_up": 0.09}, [*PICK_UP, {"kind": "drop", "time": 0.07}], 3.0, 0.0),
    ({"drop": 0.09}, [*PICK_UP, {"kind": "drop", "time": 0.03}], 0.0, 6.0),
], ids=str)  # fmt: skip
def test_what_an_event_picks_up_hangs_at_the_tip_whatever_the_other_payloads_size(payload, events, own, other):
    """Lumped parameters, and the moments of the last segment of links that bend, are sums over the bodies."""
    error = {"payload": {"mass": 3.0, "offset": 0.2, "radius": 0.1, **payload}}
    names = ("lumped", "payload", "segment_inertia", "segment_moment")
    lumped, mass, inertia, moment = watch(*names, parameter_error=error, events=events, link=20.0, physics_dt=5e-4)
    *_, plain_inertia, plain_moment = watch(*names, steps=0, link=20.0, physics_dt=5e-4)
    bodies, (L1, L2, g) = ((own, 0.2, 0.1), (other, 0.0, 0.0)), (TABLE_1.L1, TABLE_1.L2, TABLE_1.gravity)
    extra = [m * np.array([L1**2, (L2 + x) ** 2 + r**2, L1 * (L2 + x), L1 * g, (L2 + x) * g]) for m, x, r in bodies]
    np.testing.assert_allclose(lumped[-1] - TABLE_1.lumped, np.sum(extra, axis=0), rtol=1e-12)
    assert mass[-1] == pytest.approx(own + other)
    tip = (1 - HINGE) * L2
    seconds, firsts = zip(*((m * ((tip + x) ** 2 + r**2), m * (tip + x)) for m, x, r in bodies), strict=True)
    np.testing.assert_allclose(inertia[-1, 3] - plain_inertia[0, 3], sum(seconds), rtol=1e-12)
    np.testing.assert_allclose(moment[-1, 3] - plain_moment[0, 3], sum(firsts), rtol=1e-12)


# Events.


MOVING = {"reference": {"kind": "sine", "amplitude": 0.8, "frequency": 0.7, "phase": (0.0, 0.5)}}
FIELDS = ("position", "velocity", "lumped", "payload", "friction_torque", "applied_torque")


def both(event, steps=60, arm=TABLE_1, torque=(-50.0, -10.0), **options):
    """Return fields of a run with and of one without an event."""
    options = {**MOVING, "arm": arm, "steps": steps, "torque": torque, **options}
    return (dict(zip(FIELDS, watch(*FIELDS, events=given, **options), strict=True)) for given in ([event], ()))


def jump(ours, plain, k):
    """Return the change of velocity at physics step k that the event makes; both runs are equal before it."""
    for name in ("position", "velocity", "lumped"):
        np.testing.assert_array_equal(ours[name][: k + 1], plain[name][: k + 1])
    return ours["velocity"][k + 1] - plain["velocity"][k + 1]


SPRING = {"stiffness": 4000.0, "rotor_inertia": 0.5}


@pytest.mark.parametrize(("rotor", "joint"), [(0.0, None), ((4.0, 2.0), None), (0.3, SPRING)])
def test_a_knock_changes_the_momentum_by_its_impulse(rotor, joint):
    """That of the links and, if the joints are rigid, of the rotors."""
    arm, impulse = ArmParameters(rotor=rotor), np.array([5.0, -2.0])
    ours, plain = both({"kind": "knock", "time": 0.02, "impulse": tuple(impulse)}, arm=arm, joint=joint)
    change = jump(ours, plain, 20)
    moved = arm.lumped if joint else arm
    expected = np.linalg.solve(inertia_matrix(moved, ours["position"][20]), impulse)
    np.testing.assert_allclose(change, expected, rtol=2e-2)  # a step of 1 ms follows
    assert np.abs(expected).min() > 0.1


def test_a_grasp_conserves_momentum_and_loses_energy():
    """The velocities after it are those of M_after v+ = M_before v-. The solver of `test_physics.py` has that of a payload."""
    arm = ArmParameters(rotor=(2.0, 1.0))
    events = [{"kind": "pick-up", "time": 0.002, "mass": 6.0}]
    options = MOVING | {"arm": arm, "action": "torque", "actuator": None, "events": events}
    env = started(control_dt=1e-5, physics_dt=1e-5, duration=0.1, **options)
    before, after = truths_of(env, [(0.0, 0.0)] * 201)[-2:]
    assert (before.payload, after.payload) == (0.0, 6.0)
    first, second = (inertia_matrix(with_rotors(truth.lumped, arm.rotor), before.position) for truth in (before, after))
    np.testing.assert_allclose(second @ after.velocity, first @ before.velocity, rtol=2e-3)
    assert after.velocity @ second @ after.velocity < 0.9 * (before.velocity @ first @ before.velocity)


def test_a_drop_releases_all_payload_and_keeps_velocities():
    ours, plain = both({"kind": "drop", "time": 0.03}, parameter_error={"payload": 3.0})
    assert np.abs(jump(ours, plain, 30)).max() < 0.1
    np.testing.assert_array_equal(ours["payload"], [3.0] * 31 + [0.0] * 30)
    np.testing.assert_array_equal(ours["lumped"][31], TABLE_1.lumped)


def test_friction_changes_by_its_factor():
    friction = {"viscous": (4.0, 2.0), "coulomb": (10.0, 4.0), "stiction": 1.0}
    ours, plain = both({"kind": "friction", "time": 0.025, "factor": (3.0, 0.5)}, friction=friction)
    jump(ours, plain, 25)
    v = ours["velocity"][26]
    law = np.array([4.0, 2.0]) * v + (np.array([10.0, 4.0]) + np.exp(-(v**2) / 1e-3)) * np.sign(v)
    np.testing.assert_allclose(ours["friction_torque"][26], (3.0, 0.5) * law, rtol=1e-12)


def test_a_drive_loses_torque_within_a_control_step():
    """The event comes at a physics step between two commands."""
    event = {"kind": "drive", "time": 0.025, "factor": (0.5, 0.0)}
    envs = (started(action="torque", events=events, **MOVING) for events in ([], [event]))
    whole, broken = (truths_of(env, [(-50.0, -10.0)] * 4)[1:] for env in envs)
    np.testing.assert_array_equal([truth.applied_torque for truth in broken], [(-50, -10)] * 2 + [(-25, 0)] * 2)
    lost = [theirs.velocity - ours.velocity for ours, theirs in zip(whole, broken, strict=True)]
    np.testing.assert_array_equal(lost[1], 0.0)
    np.testing.assert_allclose(lost[2] / (lost[3] - lost[2]), 0.5, rtol=0.25)  # it acts for half of the third step


# A hand acts through the options' own physics.


ACTION = np.array([0.02, -0.01])


def with_hand(scenario="nominal", **options):
    env = TwoLinkArmEnv(open_to_hand(scenarios.get(scenario).replace(duration=2.0), 3), **options)
    hand = Hand(env)
    return env, hand, env.reset(seed=3)[0]


@pytest.mark.parametrize("scenario", ["everything-2", "geared-everything-2", "servo-everything-2"])
def test_an_idle_hand_changes_no_bit_of_the_seeds_episode(scenario):
    plain = TwoLinkArmEnv(scenarios.get(scenario).replace(duration=2.0))
    env, hand, observation = with_hand(scenario)
    np.testing.assert_array_equal(observation, plain.reset(seed=3)[0])
    for _ in range(20):
        hand.push(np.zeros(2))
        np.testing.assert_array_equal(env.step(ACTION)[0], plain.step(ACTION)[0])


def test_a_push_is_a_disturbance_of_one_control_step():
    env, hand, _ = with_hand()
    torque = [(3.0, -1.0), (0.0, 5.0)]
    given = {"kind": "array", "torque": [(0.0, 0.0), *np.negative(torque), (0.0, 0.0)], "dt": 0.01}
    other = TwoLinkArmEnv(env.scenario.replace(disturbance=given))
    other.reset(seed=3)
    for k in range(6):
        if k in (1, 2):
            hand.push(torque[k - 1])
        np.testing.assert_array_equal(env.step(ACTION)[0], other.step(ACTION)[0])


def test_payload_drives_and_noise_change_at_the_next_step():
    env, hand, _ = with_hand("payload-2")
    before = env.truth
    hand.load(2.0)
    hand.scale_drives((1.0, 0.5))
    hand.make_noise((1e-3, 1e-2))
    observation, truth = env.step(ACTION)[0], env.truth
    np.testing.assert_array_equal([truth.payload, *truth.gain], [before.payload + 2.0, *before.gain * (1.0, 0.5)])
    readings = np.abs(observation[:4] - [*truth.position, *truth.velocity])
    assert ((readings > 0.0) & (readings < 5 * np.repeat([1e-3, 1e-2], 2))).all()
    hand.unload()
    env.step(ACTION)
    assert env.truth.payload == 0.0


def test_the_reference_goes_smoothly_to_the_target_also_in_the_preview():
    """r'' = w^2 (s - r) - 2 w r', and `let_go` gives the scenario's own reference back."""
    env, hand, first = with_hand(preview=3)
    layout, target = env.layout, np.array((-1.0, 0.5))
    for _ in range(120):
        hand.aim(tuple(target))
        before, now = env.truth, env.step(ACTION)[0]
    position, velocity, acceleration = now[layout.reference[:6]].reshape(3, 2)
    np.testing.assert_allclose(acceleration, BANDWIDTH**2 * (target - position) - 2 * BANDWIDTH * velocity, atol=1e-12)
    np.testing.assert_allclose(position - before.reference, 0.01 * velocity, atol=1e-3)
    assert np.abs(position - target).max() < 0.1
    ahead = now[layout["preview"]][:6]
    hand.aim(tuple(target))
    np.testing.assert_allclose(env.step(ACTION)[0][layout.reference[:6]], ahead, atol=1e-12)
    hand.let_go()
    np.testing.assert_array_equal(env.reset(seed=3)[0], first)
