"""Events: each changes what it names, at its time, and nothing before it."""

import numpy as np
import pytest

from fbl_gym import TABLE_1, ArmParameters
from fbl_gym.model.arm import inertia_matrix, with_rotors
from tests.fbl_gym.episodes import started, truths_of, watch

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
