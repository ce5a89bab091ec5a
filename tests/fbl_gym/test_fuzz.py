"""Random valid options and random actions: nothing breaks, single or batched.

The options come from their declarations: a new number needs a range in `ranges.toml`, and is then in every test.
"""

import contextlib
import dataclasses
import functools
import json
import tomllib
from pathlib import Path

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fbl_gym import Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.interface import ACTIONS
from fbl_gym.model.arm import ARMS
from fbl_gym.model.real_arms import REAL_ARMS
from fbl_gym.options import SENSORS
from tests.fbl_gym.declared import FIELDS
from tests.fbl_gym.episodes import PLANT, started, torques
from tests.fbl_gym.test_vector_env import compare

MAX = 2**64 - 1
#: Ranges of the numbers, by the start of their path and their name.
RANGES = tomllib.loads(Path(__file__).with_name("ranges.toml").read_text(encoding="utf-8"))

#: Times that are multiples of the physics step, and their least number of steps.
STEPPED = dict.fromkeys(("actuator.delay", "actuator.jitter", "disturbance.start", "events.0.time"), 0)
STEPPED |= dict.fromkeys(("disturbance.period", "disturbance.width", "disturbance.dt"), 1)

RATIO = st.floats(0.05, 20)
RATIOS = st.one_of(RATIO, st.tuples(*[RATIO] * 4), st.dictionaries(st.sampled_from(["m1", "L2"]), RATIO))
SPECIAL = {
    "parameter_error.ratio": RATIOS,
    "arm": st.sampled_from([*ARMS, *REAL_ARMS]),
    "parameter_error.parameters": st.lists(st.sampled_from(["m1", "m2", "L1", "L2"]), unique=True),
}
ROWS = st.lists(st.tuples(st.floats(-4, 4), st.floats(-4, 4)), min_size=1, max_size=6)
#: Options that are drawn together, and MuJoCo, which has tests of its own.
SET = ("physics_dt", "control_dt", "duration", "sensors", "plant")

MOVES = ("arm", "parameter_error", "friction", "joint", "link", "physics_dt", "control_dt", "duration", "events")


def range_of(field):
    """Return the range of a number."""
    ranges = [each.items() for start, each in RANGES.items() if field.stream.startswith(start.rstrip("."))]
    (ends,) = [ends for each in ranges for names, ends in each if field.name in names.split()]
    return ends


def value_of(field, h):
    """Return a strategy of a field's valid values, as plain data; h is the physics step."""
    if field.is_record:
        parents = sorted({other.path.rpartition(".")[0] for other in FIELDS if other.path.startswith(f"{field.path}[")})
        records = [record_of(parent, h) for parent in parents or [field.path]]
        one = st.one_of(*records, SPECIAL.get(field.path, st.nothing()))
        return st.lists(one, max_size=3) if field.path == "events" else one
    if field.path in SPECIAL:
        return SPECIAL[field.path]
    if field.is_table:
        return ROWS
    if not field.is_number:
        return st.sampled_from(field.names)
    if field.stream in STEPPED:
        return st.integers(STEPPED[field.stream], 36).map(lambda k: k * h)
    low, high = range_of(field)
    one = st.integers(low, high) if field.is_whole else st.floats(low, high)
    if field.varies:
        kinds = ["uniform", "choice", *(["log_uniform"] if low > 0 else [])]
        ends = st.lists(one, min_size=2, max_size=2).map(sorted)
        one = st.one_of(one, st.builds(lambda kind, ends: {kind: ends}, st.sampled_from(kinds), ends))
    one = st.one_of(one, st.tuples(one, one)) if field.is_pair else one
    return st.one_of(st.none(), one) if field.declaration.optional else one


@functools.cache
def record_of(parent, h):
    """Return a strategy of the fields of a record, by the path that leads to it."""
    fields = [field for field in FIELDS if field.path.rpartition(".")[0] == parent and field.path not in SET]
    kind = {"kind": st.just(fields[0].base["kind"])} if "kind" in fields[0].base else {}
    needed = {field.name: value_of(field, h) for field in fields if field.default is dataclasses.MISSING}
    optional = {field.name: value_of(field, h) for field in fields if field.name not in needed}
    return st.fixed_dictionaries({**kind, **needed}, optional=optional)


@st.composite
def environments(draw):
    """Arguments of an environment, all valid."""
    h = draw(st.sampled_from([1e-3, 5e-4, 1 / 300, 0.01]))
    substeps, steps = draw(st.integers(1, 12)), draw(st.integers(1, 12))
    options = {"physics_dt": h, "control_dt": substeps * h, "duration": steps * substeps * h, **draw(record_of("", h))}
    tasks = {"reward": record_of("reward", h), "preview": st.integers(0, 5), "action": st.sampled_from(ACTIONS)}
    for name, strategy in tasks.items():
        if draw(st.booleans()):
            options[name] = draw(strategy)
    must = ("position", "velocity") if options.get("action") == "acceleration" else ("position",)
    options["sensors"] = [name for name in SENSORS if name in must or draw(st.booleans())]
    make_valid(options)
    return options


def without(fields, *names):
    """Return the fields of a record less some."""
    return {name: value for name, value in (fields or {}).items() if name not in names}


def fits(options):
    """Return True if the physics step is short enough for the plant."""
    with contextlib.suppress(ValueError):
        return bool(Scenario(**{name: options[name] for name in MOVES if name in options}))
    return False


def make_valid(options):
    """Take out what contradicts other options; last longer than the delay."""
    sensors, encoder, step = options["sensors"], options.get("encoder") or {}, options["control_dt"]
    if "noise" in options:
        noise = {name: error for name, error in options["noise"].items() if name in sensors}
        for name, error in noise.items():
            sizes = [size for size in ("snr_db", "density", "sigma") if error.get(size) is not None]
            noise[name] = without(error, *sizes[1:])
        if "counts" in encoder and "position" in noise:
            noise["position"] = without(noise["position"], "quantization")
        options["noise"] = noise
    if encoder.get("difference") is None or "velocity" not in sensors or "velocity" in options.get("noise", {}):
        encoder = without(encoder, "difference", "low_pass")
    if "encoder" in options:
        options["encoder"] = encoder
    if options.get("action", "normalized") == "normalized" and "torque_limit" in (drive := options.get("actuator", {})):
        options["actuator"] = {**drive, "torque_limit": drive["torque_limit"] or 9.0}
    options["duration"] -= -options.get("actuator", {}).get("delay", 0.0) // step * step
    if "friction" not in options:
        options["events"] = [event for event in options.get("events", []) if event["kind"] != "friction"]
    disturbance, reference = options.get("disturbance", {}), options.get("reference", {})
    if disturbance.get("kind") == "pulses":
        width = disturbance.get("width", 0.3)
        options["disturbance"] = {**disturbance, "width": width, "period": width + disturbance.get("period", 1.0)}
    for name in ("velocity", "acceleration") if "position" in reference else ():
        if reference.get(name) is not None:
            n = len(reference["position"])
            options["reference"] = reference = {**reference, name: (reference[name] * n)[:n]}
    if "friction" in options and ("joint" in options or "link" in options):
        options["friction"] = without(options["friction"], "law")
    if "link" in options and not fits(options):  # too fast for the step, perhaps with this joint or friction
        del options["link"]
    while "joint" in options:  # until it is soft enough for the step
        joint = options["joint"] = {"rotor_inertia": 1.0, **without(options["joint"], "damping")}
        joint["rotor_inertia"] = joint["rotor_inertia"] or 1.0
        joint["stiffness"] = None if joint.get("frequency") is not None else joint.get("stiffness") or 1e3
        if fits(options):
            break
        joint["frequency"], joint["stiffness"] = None, 1.0 if joint["stiffness"] != 1.0 else 0.01
        if joint["stiffness"] == 0.01:
            del options["joint"]
    if "datasheet" in options:
        springs = ("stiffness", "damping", "rotor_inertia", "backlash") if "joint" not in options else ()
        unread = {"velocity", "acceleration"}.difference(sensors)
        options["datasheet"] = without(options["datasheet"], *springs, *(f"{sensor}_noise" for sensor in unread))
    if "joint" not in options and "friction" in options and not fits(options):  # too strong for the step
        options["friction"] = without(options["friction"], "viscous")


def actions_of(seed, lanes, env):
    """A source of actions [lanes x 2]: within the box, at its corners, and far outside."""
    rng, bound = np.random.default_rng(seed), np.array(env.interface.action_limit)
    while True:
        reach, inside = rng.choice([0.0, 0.3, 1.0, 1.5, 1e6]), rng.random() < 0.5
        shares = rng.uniform(-1, 1, (lanes, 2)) if inside else rng.choice([-1.0, 1.0], (lanes, 2))
        yield reach * bound * shares


SLOW = settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
LANES = st.sampled_from([1, 2, 5, 8, 17])


@SLOW
@given(environments(), st.integers(0, MAX), st.integers(0, 1000))
def test_a_single_environment_accepts_every_valid_combination(options, seed, choice):
    """Observations are in their space, rewards in [0, 1]; no exception or warning; the end is in time.

    The options survive JSON: as a scenario, and as the options of an environment.
    """
    env = gym.make("fbl_gym/TwoLinkArm-v0", **options)
    again = gym.make(EnvSpec.from_json(env.spec.to_json())).unwrapped
    env = env.unwrapped
    assert again.scenario == env.scenario == Scenario.from_dict(json.loads(json.dumps(env.scenario.to_dict())))
    assert again.interface == env.interface
    np.testing.assert_array_equal(again.reset(seed=1)[0], env.reset(seed=1)[0])
    source = actions_of(choice, 1, env)
    for start in ({"seed": seed}, {}):
        observation, _ = env.reset(**start)
        for k in range(env.scenario.steps):
            assert np.isfinite(observation).all()
            assert observation in env.observation_space
            observation, reward, terminated, truncated, _ = env.step(next(source)[0])
            assert 0.0 <= reward <= 1.0
            assert truncated == (k + 1 == env.scenario.steps)
            assert not terminated or reward == 0.0
            if terminated:
                break
            assert all(np.isfinite(value).all() for name, value in vars(env.truth).items() if name != "rate_limit")
        assert terminated or truncated
        assert observation in env.observation_space


@SLOW
@given(environments(), st.integers(0, MAX - 40), st.integers(0, 1000), LANES, st.sampled_from(AutoresetMode))
def test_lanes_equal_single_environments_for_every_valid_combination(options, seed, choice, lanes, mode):
    """Over several episodes."""
    ours = TwoLinkArmVectorEnv(lanes, autoreset_mode=mode, **options)
    theirs = SyncVectorEnv([lambda: TwoLinkArmEnv(**options)] * lanes, autoreset_mode=mode)
    compare(ours, theirs, actions_of(choice, lanes, ours), 25, seed)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(environments(), st.integers(0, 1000))
def test_a_held_decision_is_the_same_as_a_repeated_one(options, seed):
    """To the bit: n physics steps under one command are n intervals of one step under the same command.

    Delay, lag, payload, events and every disturbance act at their times, multiples of control_dt or not.
    """
    drive = without(options.get("actuator"), "jitter", "delay_samples")  # these count in control steps
    options = {**without(options, "limits"), "action": "torque", "actuator": drive}
    coarse = started(**options, seed=seed)
    fine = started(**{**options, "control_dt": options["physics_dt"]}, seed=seed)
    for k in range(coarse.scenario.steps):
        torque = torques(7 * k, 1)[0]
        coarse.step(torque)
        for _ in range(coarse.scenario.substeps):
            if fine.step(torque)[2]:
                return
        for name in set(PLANT) - {"reference"}:
            np.testing.assert_array_equal(getattr(coarse.truth, name), getattr(fine.truth, name), err_msg=name)
