"""The classes of robots: servo, direct and geared; and arms of laboratories, whose numbers are those of their sources."""

import dataclasses
import itertools
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.policies.spec import resolve
from benchmarks.run.rollout import make_env, reference_motion
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import TABLE_1, ArmParameters, forward_dynamics, gravity_torque, inertia_matrix, inverse_dynamics
from fbl_gym.model.real_arms import REAL_ARMS
from fbl_gym.records.record import ends
from fbl_gym.scenarios.class_families import conditions, families
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.tiers import MEMBERS as ALL

MEMBERS = [name for name, member in ALL.items() if member.tier != "ideal"]
PUSHED = [(robot, family) for robot in CLASSES for family in families(robot)]


@pytest.mark.parametrize("name", MEMBERS)
def test_every_scenario_is_of_its_class(name):
    scenario, robot = scenarios.get(name), name.partition("-")[0]
    kind, joint = CLASSES[robot], scenario.joint
    assert scenario.description.startswith(f"{robot}: ")
    ours = scenario.name, scenario.control_dt, scenario.sensors, scenario.limits.error, scenario.robot_class
    assert ours == (name, kind.control_dt, ("position", "velocity"), 0.5, robot)
    assert (scenario.encoder.difference, scenario.actuator.delay_samples) == (1, 1)
    assert ends(scenario.actuator.lag)[0] > 0
    assert scenario.friction is not None
    assert scenario.parameter_error.payload is not None
    assert joint is None or joint.encoder == kind.encoder
    assert scenarios.member(name).tier in (robot, f"{robot}-practice", f"{robot}-surprise")


@pytest.mark.parametrize(("robot", "family"), PUSHED)
def test_a_family_pushes_something_further_at_each_severity(robot, family):
    tasks = [scenarios.get(f"{robot}-nominal"), *(scenarios.get(f"{robot}-{family}-{s}") for s in (1, 2, 3))]
    assert len({dataclasses.replace(task, name="", description="") for task in tasks}) == 4


@pytest.mark.parametrize("robot", CLASSES)
def test_the_families_take_turns_in_three_arms_and_practice_has_others(robot):
    own, names = CLASSES[robot].arm, families(robot)
    assert scenarios.get(f"{robot}-nominal").arm == scenarios.get(f"{robot}-practice-nominal").arm == own
    board = {name: {scenarios.get(f"{robot}-{name}-{severity}").arm for severity in (1, 2, 3)} for name in names}
    assert all(len(arms) == 1 for arms in board.values())
    practice = {name: [scenarios.get(f"{robot}-practice-{name}-{k}").arm for k in (1, 3)] for name in names}
    assert all(first != second for first, second in practice.values())
    ours, others = ({(arm.m2, arm.L2) for arms in sets.values() for arm in arms} for sets in (board, practice))
    assert (len(ours), len(others), ours & others) == (3, 3, {(own.m2, own.L2)})


@pytest.mark.parametrize("robot", CLASSES)
def test_the_nominal_model_knows_the_rotors_behind_springs(robot):
    named = [scenarios.get(name) for name in MEMBERS if name.startswith(robot)]
    for task in (*named, Scenario(**conditions(TABLE_1, robot, "everything", 2))):
        assert task.joint is None or task.joint.rotor_inertia == task.arm.rotor, task.name


@pytest.mark.parametrize("name", MEMBERS)
def test_tuning_and_training_may_use_practice_alone(name):
    assert bool(scenarios.held_out_reason(scenarios.get(name))) == ("practice" not in name)


@pytest.mark.parametrize("robot", CLASSES)
def test_the_nominal_arm_can_follow(robot):
    """With its largest friction, it needs less than its torque limits."""
    for name in (f"{robot}-nominal", f"{robot}-practice-nominal"):
        scenario = scenarios.get(name)
        q, v, a = reference_motion(scenario, range(8))
        friction = scenario.friction
        dry = [sum(ends(getattr(friction, part)[i])[1] for part in ("coulomb", "stiction")) for i in (0, 1)]
        viscous = np.array([ends(friction.viscous[i])[1] for i in (0, 1)])
        torque = np.abs(inverse_dynamics(scenario.arm, q, v, a)) + dry + viscous * np.abs(v)
        assert (torque / scenario.actuator.torque_limit).max() < 1.0, name


@pytest.mark.parametrize("robot", CLASSES)
@pytest.mark.parametrize("scale", [0.3, 30.0])
def test_the_task_follows_the_arm(robot, scale):
    """All torques, inertias and springs of an arm whose links and rotors are heavier by a factor are so, too."""
    arm = CLASSES[robot].arm
    other = dataclasses.replace(arm, m1=scale * arm.m1, m2=scale * arm.m2, rotor=tuple(scale * np.array(arm.rotor)))
    ours, theirs = (Scenario(**conditions(each, robot, "everything", 2)) for each in (arm, other))
    assert theirs.friction.load == ours.friction.load
    follow = [("actuator", "torque_limit"), ("friction", "viscous"), ("friction", "coulomb")]
    for option, name in (*follow, *([("joint", "stiffness")] if ours.joint is not None else [])):
        a, b = (np.array([ends(x) for x in getattr(getattr(task, option), name)]) for task in (ours, theirs))
        np.testing.assert_allclose(b, scale * a)


@pytest.mark.parametrize("robot", CLASSES)
def test_a_wrong_data_sheet_is_told_and_the_truth_lies_on_both_sides_of_its_range(robot):
    tasks = (Scenario(**conditions(CLASSES[robot].arm, robot, family, 2)) for family in ("nominal", "datasheet"))
    usual, wrong = (make_env(resolve("zero"), task, 64) for task in tasks)
    wrong.reset(seed=0)
    truth, told, ranges, drive = wrong.truth, wrong.interface, usual.interface, usual.scenario.actuator
    delay = np.array(ends(drive.delay)) + usual.scenario.control_dt
    pairs = [(truth.lag, told.lag, ranges.lag), (truth.delay, told.delay, delay)]
    pairs += [(truth.gain, (1.0, 1.0), ends(drive.gain[0]))]
    if told.stiffness is not None:
        for name in ("stiffness", "damping"):
            pairs += zip(getattr(truth, name).T, *(np.array(getattr(x, name)).T for x in (told, ranges)), strict=True)
    for real, (low, high), (least, most) in pairs:
        assert low == high
        assert (real < low).any()
        assert (real > high).any()
        assert not ((least < real) & (real < most)).any()


def test_the_board_is_recognised_by_its_content():
    arm, own, drop = CLASSES["geared"].arm, dataclasses.replace(TABLE_1, m1=3.0), [{"kind": "drop", "time": 3.0}]
    for name in ("servo-delay-2", "direct-surprise-arm", "geared-surprise-knock"):
        assert scenarios.held_out_reason(scenarios.get(name).replace(name="mine"))
    for free in (*map(scenarios.get, ("nominal", "everything-2", "dfki-c1")), Scenario(arm=own, events=drop, link=8.0)):
        assert scenarios.held_out_reason(free) == ""
    for reason, task in (
        ("events", {"arm": arm, "events": drop}), ("links bend", {"arm": arm, "link": 20.0, "physics_dt": 2e-4}),
        ("motion", {"arm": own, "reference": scenarios.get("servo-nominal").reference}),
    ):  # fmt: skip
        assert reason in scenarios.held_out_reason(Scenario(**task))


@pytest.mark.parametrize(("reference", "refused"), [
    ({"kind": "minimum-jerk", "move_time": 1.0, "hold_time": 0.2}, True),
    ({"kind": "minimum-jerk", "points": [(-1.0, 0.2), (-0.4, -0.5)]}, True),
    ({"kind": "array", "position": np.zeros((40, 2)), "dt": 0.1}, True),
    ("fourier", False), ("sine", False), ("steps", False), ("filtered-steps", False),
])  # fmt: skip
@pytest.mark.parametrize("name", [name for name in MEMBERS if "practice-everything" in name or "practice-n" in name])
def test_kinds_of_motion_that_judge_are_refused_on_the_robots_of_a_class(name, reference, refused):
    task = scenarios.get(name).replace(reference=reference)
    assert ("kind" in scenarios.held_out_reason(task)) == refused
    assert scenarios.held_out_reason(task.replace(arm={"m1": 3.0, "rotor": task.arm.rotor})) == ""


def test_a_balanced_link_is_scaled_by_its_inertia():
    """Its weight was the scale, however small; at zero, both joints got the rule of a horizontal arm."""
    links = {"mass": (3.0, 1.5), "length": (0.4, 0.3), "inertia": (0.04, 0.01)}
    balanced, nearly = (ArmParameters.from_links(**links, centre=(0.18, c)) for c in (0.0, 1e-4))
    weight = abs(balanced.lumped[3])
    for arm in (balanced, nearly):
        options = scenarios.conditions(arm, "servo")
        assert options["actuator"]["torque_limit"][0] > 1.2 * weight
        dry = options["friction"]["coulomb"]
        assert dry[0]["uniform"][1] == pytest.approx(0.05 * weight, rel=1e-3)
        assert dry[1]["uniform"][1] == pytest.approx(0.1 * 9.8 * 0.01, rel=1e-3)


def test_changed_conditions_change_no_class():
    conditions(TABLE_1, "servo")["limits"]["error"] = 9.0
    assert conditions(TABLE_1, "servo")["limits"]["error"] == 0.5


@pytest.mark.parametrize("robot", CLASSES)
@pytest.mark.parametrize("arm", [TABLE_1, dataclasses.replace(TABLE_1, gravity=0.0), {"m2": 10, "L1": 0.4}])
def test_the_conditions_fit_any_arm(robot, arm):
    arm = Scenario(arm=arm).arm
    for family in families(robot):
        limit = np.array(Scenario(**scenarios.conditions(arm, robot, family, 2)).actuator.torque_limit)
        assert (limit > 0).all()


# Arms of laboratories.


STATES = np.random.default_rng(0).uniform(-3, 3, (50, 2))

DFKI = tomllib.loads(Path(__file__).with_name("dfki.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", DFKI)
def test_dfkis_arm_has_the_accelerations_of_its_plant_file(name):
    """`plant.py` written out: the matrices with the rotors' coupling, angles from hanging, inertia about the joint."""
    (m1, m2, l1, r1, r2, I1, I2, Ir), gr, g = DFKI[name], 6.0, 9.81
    for x, (v1, v2), u in zip(STATES, 3 * STATES[::-1], STATES**2, strict=True):
        q1, q2 = x
        m22, m12 = I2 + gr**2 * Ir, I2 + m2 * l1 * r2 * math.cos(q2) - gr * Ir
        m11 = I1 + I2 + m2 * l1**2 + 2 * m2 * l1 * r2 * math.cos(q2) + (gr**2 + 1) * Ir
        h = m2 * l1 * r2 * math.sin(q2)
        coriolis = np.array([[-2 * h * v2, -h * v2], [h * v1, 0.0]]) @ (v1, v2)
        down2 = m2 * g * r2 * math.sin(q1 + q2)
        gravity = np.array([m1 * g * r1 * math.sin(q1) + m2 * g * l1 * math.sin(q1) + down2, down2])
        theirs = np.linalg.solve([[m11, m12], [m12, m22]], u - coriolis - gravity)
        ours = forward_dynamics(REAL_ARMS[name], (q1 - math.pi / 2, q2), (v1, v2), u)
        np.testing.assert_allclose(ours, theirs, rtol=1e-11)


def test_the_direct_drive_arm_has_the_matrices_of_its_second_source():
    for q in STATES:
        c = math.cos(q[1])
        theirs = [[2.351 + 0.1676 * c, 0.102 + 0.0838 * c], [0.102 + 0.0838 * c, 0.102]]
        np.testing.assert_allclose(inertia_matrix(REAL_ARMS["cicese"], q), theirs, atol=1e-3)
        s1, s12 = math.sin(q[0]), math.sin(q.sum())
        gravity = gravity_torque(REAL_ARMS["cicese"], (q[0] - math.pi / 2, q[1]))
        np.testing.assert_allclose(gravity, [9.81 * (3.9211 * s1 + 0.1862 * s12), 9.81 * 0.1862 * s12], atol=2e-3)


def test_the_pelicans_largest_gravity_torque():
    assert gravity_torque(REAL_ARMS["pelican"], (0.0, 0.0))[0] == pytest.approx(11.967, abs=1e-3)


@pytest.mark.parametrize("name", REAL_ARMS)
def test_every_arm_is_known_by_name_and_physical(name):
    arm = REAL_ARMS[name]
    assert Scenario(arm=name).arm == arm
    assert min(*arm.inertia, *arm.centre) > 0.0
    assert max(arm.centre) <= (1.0 if "identified" not in name else 1.1)


def test_identified_arms_have_the_numbers_of_the_page():
    """p1 with the first rotor, p2, p4 and p5, as docs/reference/arms.md has them."""
    page = (Path(__file__).parents[2] / "docs" / "reference" / "arms.md").read_text(encoding="utf-8")
    for i, name in enumerate(("dfki-c1-identified", "dfki-a0-identified")):
        arm = REAL_ARMS[name]
        p1, p2, _, p4, p5 = arm.lumped
        for label, number in (("p1", p1 + arm.rotor[0]), ("p2", p2), ("p4", p4), ("p5", p5), ("rotor 2", arm.rotor[1])):
            (row,) = [line for line in page.splitlines() if line.startswith(f"| {label} [")]
            assert float(row.split("|")[3 + 2 * i].split()[0]) == pytest.approx(number, rel=1e-9), label


@pytest.mark.parametrize("name", ["dfki-c1", "dfki-a0", "cicese"])
def test_the_reference_stays_within_the_torque_limits(name):
    """With friction, two thirds of the limit are enough between the corners of its box, and 70 % within it."""
    scenario = scenarios.get(name)
    reference, friction = scenario.reference, scenario.friction
    inside = np.random.default_rng(0).uniform(reference.low, reference.high, (30, 2))
    corners = [*itertools.product(*zip(reference.low, reference.high, strict=True))]
    moves = [(move, 2 / 3) for move in itertools.product(corners, repeat=2)]
    moves += [(move, 0.7) for move in itertools.product([*corners, *inside], repeat=2)]
    s, T = np.linspace(0.0, 1.0, 41)[:, None], reference.move_time
    shape = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 * (1 - s) ** 2 / T, 60 * s * (1 - s) * (1 - 2 * s) / T**2
    for (first, last), share in moves:
        path, v, a = (part * np.subtract(last, first) for part in shape)
        torque = np.abs(inverse_dynamics(scenario.arm, first + path, v, a)) + friction.viscous * np.abs(v)
        assert np.all(torque + friction.coulomb < np.multiply(share, scenario.actuator.torque_limit))
