"""MuJoCo's plant: the package's arm where both model the same, lanes as single environments, and other worlds."""

import tomllib
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import controllers
from fbl_gym import TABLE_1, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.options import WORLDS
from tests.fbl_gym.episodes import MUJOCO, episode, started, truths_of

pytest.importorskip("mujoco")

KNOCK = {"kind": "knock", "time": 1.003, "impulse": (5, 2)}
PAYLOAD = {"mass": 3, "pick_up": 1.003}
#: Options under which a physics step has one torque, and under which a torque varies within a step; and a robot's.
TABLES = Path(__file__).with_name("mujoco.toml").read_text(encoding="utf-8")
EXACT, SMOOTH, ELASTIC, LAB = tomllib.loads(TABLES).values()


def run(options, lanes=4, policy="computed-torque", seconds=3.0, **gains):
    """Return the truth of every step in closed loop, and all observations and rewards."""
    env = TwoLinkArmVectorEnv(lanes, duration=seconds, **options)
    law, (observation, _), state = controllers.make(policy, env, **gains), env.reset(seed=0), None
    truth, numbers = [env.truth], [observation]
    for _ in range(env.scenario.steps):
        action, state = law.predict(observation, state)
        observation, reward, terminated, _, _ = env.step(action)
        assert not terminated.any()
        truth.append(env.truth)
        numbers += [observation, reward]
    return truth, numbers


def distance(one, other, name):
    return np.max([np.abs(getattr(a, name) - getattr(b, name)) for a, b in zip(one[0], other[0], strict=True)])


def compare(options, tolerances, **arguments):
    """Check that truths differ by at most the tolerance of their field, and observations and rewards by 1e-9."""
    ours, theirs = (run({**options, "plant": plant}, **arguments) for plant in (None, "mujoco"))
    for name, tolerance in tolerances.items():
        assert distance(ours, theirs, name) < tolerance, name
    for a, b in zip(ours[1], theirs[1], strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)


@pytest.mark.parametrize("options", EXACT.values(), ids=EXACT)
def test_motions_agree_to_rounding(options):
    forces = dict.fromkeys(("acceleration", "friction_torque", "disturbance", "payload", "lumped"), 1e-9)
    compare(options, {"position": 1e-12, "velocity": 1e-11, **forces})


@pytest.mark.parametrize("joint", [None, {"stiffness": (4000, 1500), "rotor_inertia": (0.6, 0.3)}], ids=["", "elastic"])
def test_links_that_bend_agree(joint):
    """Three seconds with a blow, a grasp and frequencies that vary."""
    link, sensors = {"frequency": {"uniform": [10, 15]}}, ("position", "velocity")
    options = {"link": link, "joint": joint, "sensors": sensors, "events": (KNOCK,)}
    options["parameter_error"] = {"payload": {**PAYLOAD, "offset": 0.1, "radius": 0.2}}
    compare(options, {"position": 1e-10, "velocity": 1e-9, "bend": 1e-10, "bend_velocity": 1e-9, "acceleration": 1e-7})


@pytest.mark.parametrize("options", SMOOTH.values(), ids=SMOOTH)
def test_motions_agree_where_a_torque_varies_within_a_step(options):
    gap = distance(run(options), run({**options, "plant": "mujoco"}), "position")
    assert 1e-9 < gap < (3e-3 if "load" in options.get("friction", {}) else 5e-6)  # MuJoCo holds friction over a step


@pytest.mark.parametrize("name", [name for name in controllers.names() if controllers.access(name) == "oracle"])
def test_every_oracle_runs(name):
    """They read the truth of this plant, and follow as on the package's own one."""
    ours, theirs = (run({"plant": plant}, lanes=1, policy=name, seconds=1.0) for plant in (None, "mujoco"))
    assert distance(ours, theirs, "position") < 1e-10


@pytest.mark.parametrize("side", ["motor", "link"])
def test_elastic_joints_agree(side):
    """Two seconds with events, a load on the links, a computed velocity and springs that vary."""
    options = {
        **ELASTIC,
        "joint": {**ELASTIC["joint"], "stiffness": {"log_uniform": [1500, 4000]}, "encoder": side},
        "parameter_error": {"radius": 0.2, "payload": {"mass": 3, "pick_up": 0.5}, "rotor": (1.3, 0.8)},
        "disturbance": {"kind": "piecewise-constant", "amplitude": (20, 8), "period": 0.105},
        "encoder": {"counts": 65536, "difference": 1},
        "events": [{"kind": "knock", "time": 1.0, "impulse": (5, 2)}, {"kind": "drop", "time": 1.5}],
    }
    motion = dict.fromkeys(("position", "velocity", "motor_position", "motor_velocity"), 1e-9)
    forces = dict.fromkeys(("acceleration", "friction_torque", "stiffness", "applied_torque"), 1e-7)
    compare(options, motion | forces, policy="pd-gravity", seconds=2.0)


def test_backlash_converges():
    """A gap's torque is held over MuJoCo's steps. Finer ones approach the kernel, to its own error."""

    def follow(plant):
        joint = {**ELASTIC["joint"], "damping": 0.0, "backlash": 0.01}
        options = {**ELASTIC, "joint": joint, "plant": plant}
        return run(options, policy="pd-gravity", seconds=1.0, lanes=1, damping=1.0)

    exact = follow(None)
    coarse, fine = (distance(exact, follow({"kind": "mujoco", "substeps": n}), "position") for n in (1, 10))
    assert fine < 0.2 * coarse < 5e-4


def test_the_laboratory_is_another_arm_at_another_rate():
    """Every condition of a drive, a sensor and a load reaches it, together with events."""
    scenario = scenarios.get("mixed-error-1").replace(**LAB)
    lab = scenarios.in_world(scenario, "mujoco-lab")
    assert (lab.control_dt, lab.steps, lab.plant) == (0.008, 1250, WORLDS["mujoco-lab"])
    np.testing.assert_allclose(lab.arm.lumped[3:], scenario.arm.lumped[3:], rtol=0.05)
    assert np.all(lab.arm.lumped[:3] < 0.95 * scenario.arm.lumped[:3])
    truth, _ = run({"scenario": lab}, policy="pd-gravity", seconds=2.0)
    assert np.abs([t.position - t.reference for t in truth]).max() < 1.5
    assert truth[70].payload[0] - truth[60].payload[0] == 3.0
    coarse = scenario.replace(physics_dt=0.005, joint=None, friction=None, actuator=None)
    assert scenarios.in_world(coarse, "mujoco-lab").substeps == 8


def test_finer_steps_and_another_integrator_converge():
    def follow(**plant):
        return run({"arm": TABLE_1.as_rods(), "plant": {"kind": "mujoco", **plant}}, seconds=1.0)

    exact = follow()
    coarse, fine = (follow(integrator="implicitfast", substeps=n) for n in (1, 4))
    assert distance(exact, fine, "position") < 0.3 * distance(exact, coarse, "position") < 1e-3


@pytest.mark.parametrize(("level", "friction", "joint", "moves"), [
    (25, "coulomb", None, True),
    (25, "breakaway", None, False),
    (25, "breakaway", ELASTIC["joint"], False),
    (35, "breakaway", None, True),
])  # fmt: skip
def test_friction_holds_the_drives(level, friction, joint, moves):
    """A hanging arm, pushed below and above MuJoCo's friction loss, which lets it creep by some mrad/s."""
    down = {"kind": "steps", "points": [[-np.pi / 2, 0.0]]}
    options = {"action": "torque", "reference": down, "friction": {"coulomb": 20, "stiction": 10}, "joint": joint}
    env = started(**options, plant={"kind": "mujoco", "friction": friction}, physics_dt=5e-4)
    truth = truths_of(env, [(float(level), 0.0)] * 50)[-1]
    assert (abs(truth.motor_position[0] + np.pi / 2) > 1e-2) == moves
    if not moves:
        assert truth.friction_torque[0] == pytest.approx(level, abs=0.5)


def test_the_plant_has_an_id_and_its_errors_name_it():
    assert gym.make(MUJOCO).unwrapped.scenario.plant == WORLDS["mujoco"]
    np.testing.assert_array_equal(episode(gym.make(MUJOCO)), episode(TwoLinkArmEnv(plant="mujoco")))
    assert scenarios.get("payload-2@mujoco").name == "payload-2@mujoco"
    with pytest.raises(ValueError, match="mujoco-lab"):
        scenarios.get("payload-2@mujoco-bent")


def test_numbers_that_are_not_finite_end_the_episode(tmp_path, monkeypatch):
    """A torque beyond all bounds: terminated, observations finite, and MuJoCo writes no log file."""
    monkeypatch.chdir(tmp_path)
    env = started(plant="mujoco", action="torque", actuator=None)
    observation, reward, terminated, *_ = env.step(np.array([1e9, -1e9]))
    assert terminated
    assert reward == 0.0
    assert np.isfinite(observation).all()
    assert not list(tmp_path.iterdir())
    env.reset()
    assert not env.step(np.zeros(2))[2]
