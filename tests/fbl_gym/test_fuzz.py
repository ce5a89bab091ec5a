"""Random valid options and random actions: nothing breaks, single or batched.

Wider than the check in `test_scenarios.py`: every field of every option, all actions, sensors, rates and autoreset modes.
"""

import json

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fbl_gym import Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.interface import ACTIONS
from fbl_gym.real_arms import REAL_ARMS
from fbl_gym.uncertainty import PARAMETERS, SENSORS

MAX = 2**64 - 1


def joint(low, high):
    """One number for both joints, or one for each."""
    x = st.floats(low, high)
    return st.one_of(x, st.tuples(x, x))


def some(**fields):
    """A dict of some of the fields."""
    return st.fixed_dictionaries({}, optional=fields)


def with_kind(kind, **fields):
    return some(**fields).map(lambda values: {"kind": kind, **values})


def varied(low, high):
    """A number within bounds, or a distribution of such numbers; both joints may differ."""
    numbers = st.lists(st.floats(low, high), min_size=2, max_size=2).map(sorted)
    kinds = ["uniform", "choice", *(["log_uniform"] if low > 0 else [])]
    one = st.one_of(st.floats(low, high), st.builds(lambda kind, ends: {kind: ends}, st.sampled_from(kinds), numbers))
    return st.one_of(one, st.tuples(one, one))


SENSOR = st.one_of(
    joint(0, 2),
    some(density=varied(0, 0.1), bias=varied(-1, 1)),
    some(sigma=joint(0, 2), bias=joint(-2, 2), quantization=joint(0, 1)),
    some(snr_db=st.floats(-20, 120), bias=joint(-2, 2)),
)
ROWS = st.lists(st.tuples(st.floats(-4, 4), st.floats(-4, 4)), min_size=1, max_size=6)
BOX = {"low": joint(-5, -3), "high": joint(1, 5)}
REFERENCE = st.one_of(
    st.sampled_from(["minimum-jerk", "steps", "filtered-steps", "sine", "fourier"]),
    with_kind("minimum-jerk", **BOX, points=ROWS, move_time=st.floats(0.01, 1), hold_time=st.floats(0, 0.2)),
    with_kind("steps", **BOX, points=ROWS, period=st.floats(0.01, 1)),
    with_kind("filtered-steps", **BOX, points=ROWS, period=st.floats(0.01, 1), bandwidth=st.floats(0.1, 50)),
    with_kind(
        "sine",
        centre=joint(-3, 3),
        amplitude=joint(0, 3),
        frequency=st.floats(0.01, 20),
        phase=st.one_of(st.none(), joint(-7, 7)),
    ),
    with_kind(
        "fourier",
        centre=joint(-3, 3),
        amplitude=joint(0, 3),
        frequency=st.floats(0.01, 5),
        harmonics=st.integers(1, 9),
    ),
    st.builds(lambda position, dt: {"kind": "array", "position": position, "dt": dt}, ROWS, st.floats(0.003, 0.1)),
)
ARM = st.one_of(
    st.sampled_from([*scenarios.arms(), *REAL_ARMS]),
    some(
        m1=st.floats(0.01, 100),
        m2=st.floats(0.01, 100),
        L1=st.floats(0.05, 20),
        L2=st.floats(0.05, 20),
        gravity=st.floats(0, 30),
        centre=joint(0.1, 1.5),
        inertia=joint(0, 1),
        rotor=joint(0, 5),
    ),
)
ERROR = st.one_of(
    st.floats(0.05, 20),
    some(
        ratio=st.one_of(
            st.floats(0.05, 20),
            st.tuples(*[st.floats(0.05, 20)] * 4),
            st.dictionaries(st.sampled_from(PARAMETERS), st.floats(0.05, 20)),
        ),
        radius=st.floats(0, 5),
        parameters=st.lists(st.sampled_from(PARAMETERS), unique=True),
        sampling=st.sampled_from(["each", "together"]),
        payload=st.one_of(
            st.floats(0, 50),
            st.builds(
                lambda mass, begin, carry: {"mass": mass, "pick_up": begin, "drop": begin + carry},
                st.floats(0, 50),
                st.floats(0, 0.2),
                st.floats(0.001, 0.2),
            ),
        ),
    ),
)
FRICTION = some(
    viscous=varied(0, 1e4),
    coulomb=varied(0, 200),
    stiction=varied(0, 200),
    v_s=varied(1e-8, 1),
    law=st.sampled_from(["exact", "literal"]),
)
REWARD = some(
    tracking=st.sampled_from(["log", "l1"]),
    worst=st.floats(0.01, 10),
    resolution=st.floats(1e-6, 1),
    weight_effort=st.floats(0, 5),
    weight_chatter=st.floats(0, 5),
)
LIMITS = some(
    position=st.floats(10, 100),
    error=st.floats(0.1, 5),
    error_time=st.floats(1e-3, 1),
    velocity=st.floats(1, 1e3),
    acceleration=st.floats(1, 1e6),
    command=st.floats(1, 1e3),
)
JOINT = st.fixed_dictionaries(
    {"stiffness": st.floats(1, 1e5), "rotor_inertia": joint(0.01, 5)},
    optional={"damping": joint(0, 50), "backlash": joint(0, 0.5), "encoder": st.sampled_from(["motor", "link"])},
)
PLANT = ("arm", "parameter_error", "friction", "joint", "physics_dt", "control_dt", "duration")
EVENT = st.one_of(
    st.builds(lambda mass: {"kind": "pick-up", "mass": mass}, st.floats(0, 20)),
    st.just({"kind": "drop"}),
    st.builds(lambda factor: {"kind": "friction", "factor": factor}, joint(0, 4)),
    st.builds(lambda factor: {"kind": "drive", "factor": factor}, joint(0, 2)),
    st.builds(lambda impulse: {"kind": "knock", "impulse": impulse}, joint(-20, 20)),
)


@st.composite
def environments(draw):
    """Arguments of an environment, all valid: times are multiples of what they must be, noise is of sensors that exist."""
    options = {}

    def maybe(name, strategy):
        if draw(st.booleans()):
            options[name] = draw(strategy)

    h, substeps, steps = (
        draw(st.sampled_from([1e-3, 5e-4, 1 / 300, 0.01])),
        draw(st.integers(1, 12)),
        draw(st.integers(1, 12)),
    )
    options |= {"physics_dt": h, "control_dt": substeps * h, "duration": steps * substeps * h}
    times = st.integers(1, 3 * substeps)
    maybe("arm", ARM)
    maybe("parameter_error", ERROR)
    maybe("friction", FRICTION)
    maybe("reference", REFERENCE)
    for name in ("period", "move_time") if "reference" in options else ():
        if name in options["reference"]:  # a segment lasts a control step at least
            options["reference"] = {**options["reference"], name: max(options["reference"][name], substeps * h)}
    maybe("limits", LIMITS)
    maybe("reward", REWARD)
    maybe("initial_error", varied(-4, 4))
    maybe("initial_velocity", varied(-4, 4))
    maybe("preview", st.integers(0, 5))
    maybe("action", st.sampled_from(ACTIONS))
    if draw(st.booleans()):
        limit = draw(
            st.one_of(
                joint(0.1, 1e5), st.none() if options.get("action", "normalized") != "normalized" else joint(1, 9)
            )
        )
        delay = draw(st.integers(0, 3 * substeps)) * h
        options["actuator"] = {
            "torque_limit": limit,
            "delay": delay,
            "lag": draw(st.sampled_from([0.0, 1e-9, 1e-4, 0.05, 10.0, {"uniform": [0.0, 0.01]}])),
            "delay_samples": draw(st.one_of(st.integers(0, 3), st.just({"choice": [0, 2]}))),
            "gain": draw(varied(0, 2)),
            "rate_limit": draw(st.one_of(st.none(), varied(1e-3, 1e6))),
        }
    must = {"position"} | ({"velocity"} if options.get("action") == "acceleration" else set())
    maybe("encoder", some(counts=joint(1, 1e6), latency=st.integers(0, 5)))
    sensors = [name for name in SENSORS if name in must or draw(st.booleans())]
    options["sensors"] = sensors
    maybe("noise", some(**dict.fromkeys(sensors, SENSOR)))
    noise, encoder = options.get("noise", {}), options.get("encoder", {})
    position = noise.get("position", {})
    if isinstance(position, dict) and "quantization" in position:
        encoder.pop("counts", None)
    if "velocity" in sensors and "velocity" not in noise and "encoder" in options:
        encoder |= draw(some(difference=st.integers(1, 5)))
        if "difference" in encoder:
            encoder |= draw(some(low_pass=st.floats(0.1, 1e4)))
    kind = draw(st.sampled_from([None, "piecewise-constant", "sine", "pulses", "array"]))
    if kind == "piecewise-constant":
        options["disturbance"] = {"kind": kind, "amplitude": draw(joint(0, 1e3)), "period": draw(times) * h}
    elif kind == "sine":
        options["disturbance"] = {"kind": kind, "amplitude": draw(joint(0, 1e3)), "frequency": draw(joint(0, 0.25 / h))}
    elif kind == "pulses":
        width = draw(times)
        timing = {"width": width * h, "period": (width + draw(times)) * h, "start": (draw(times) - 1) * h}
        options["disturbance"] = {"kind": kind, "amplitude": draw(joint(-1e3, 1e3)), **timing}
    elif kind == "array":
        torque = draw(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)), min_size=1, max_size=5))
        options["disturbance"] = {"kind": kind, "torque": torque, "dt": draw(times) * h}
    if draw(st.booleans()):
        options["joint"] = draw(JOINT)
        for _ in range(20):  # until it is soft enough for the step
            try:
                Scenario(**{name: options[name] for name in PLANT if name in options})
                break
            except ValueError:
                options["joint"] = {**options["joint"], "stiffness": options["joint"]["stiffness"] / 8, "damping": 0.0}
        else:
            del options["joint"]
    time = st.integers(0, 12 * substeps).map(lambda k: k * h)
    options["events"] = draw(st.lists(EVENT, max_size=3))
    options["events"] = [event | {"time": draw(time)} for event in options["events"]]
    if "friction" not in options:
        options["events"] = [event for event in options["events"] if event["kind"] != "friction"]
    return options


def actions_of(seed, lanes, env):
    """A source of actions [lanes x 2]: within the box, at its corners, and far outside."""
    rng, bound = np.random.default_rng(seed), np.array(env.interface.action_limit)
    while True:
        reach = rng.choice([0.0, 0.3, 1.0, 1.5, 1e6])
        yield (
            reach
            * bound
            * np.where(rng.random() < 0.5, rng.uniform(-1, 1, (lanes, 2)), rng.choice([-1.0, 1.0], (lanes, 2)))
        )


SLOW = settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)


@SLOW
@given(environments(), st.integers(0, MAX), st.integers(0, 1000))
def test_a_single_environment_accepts_every_valid_combination(options, seed, choice):
    """Observations are in their space, rewards in [0, 1]; no exception or warning; the end is in time."""
    env = TwoLinkArmEnv(**options)
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
            truth = {**vars(env.truth), "rate_limit": 0.0}  # infinite without a limit
            assert all(np.isfinite(value).all() for value in truth.values())
        assert terminated or truncated
        assert observation in env.observation_space


@SLOW
@given(
    environments(),
    st.integers(0, MAX - 40),
    st.integers(0, 1000),
    st.sampled_from([1, 2, 5, 8, 17]),
    st.sampled_from(AutoresetMode),
)
def test_lanes_equal_single_environments_for_every_valid_combination(options, seed, choice, lanes, mode):
    """Over several episodes, the last lane to the bit."""
    envs, env = TwoLinkArmVectorEnv(lanes, autoreset_mode=mode, **options), TwoLinkArmEnv(**options)
    source = actions_of(choice, lanes, env)
    observations, _ = envs.reset(seed=seed)
    observation, _ = env.reset(seed=seed + lanes - 1)
    np.testing.assert_array_equal(observations[-1], observation)
    over = False
    for _ in range(25):
        actions = next(source)
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        assert observations in envs.observation_space
        assert np.isfinite(observations).all()
        assert np.all((rewards >= 0.0) & (rewards <= 1.0))
        if over and mode == AutoresetMode.NEXT_STEP:
            observation, reward, over = env.reset()[0], 0.0, False
        else:
            observation, reward, *flags, _ = env.step(actions[-1])
            assert flags == [terminated[-1], truncated[-1]]
            over = any(flags)
        assert rewards[-1] == reward
        if over and mode == AutoresetMode.SAME_STEP:
            np.testing.assert_array_equal(infos["final_obs"][-1], observation)
            observation, over = env.reset()[0], False
        np.testing.assert_array_equal(observations[-1], observation)
        if mode == AutoresetMode.DISABLED and (terminated | truncated).any():
            observations, _ = envs.reset(options={"reset_mask": terminated | truncated})
            if over:
                observation, over = env.reset()[0], False
            np.testing.assert_array_equal(observations[-1], observation)


@SLOW
@given(environments())
def test_every_valid_combination_survives_json(options):
    """As a scenario, and as the options of an environment."""
    scenario = TwoLinkArmEnv(**options).scenario
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario
    env = gym.make("fbl_gym/TwoLinkArm-v0", **options)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario == scenario
    assert again.unwrapped.interface == env.unwrapped.interface
    np.testing.assert_array_equal(again.reset(seed=1)[0], env.reset(seed=1)[0])
