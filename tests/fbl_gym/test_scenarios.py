"""The named scenarios, and records as plain data."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fbl_gym import Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios


@pytest.mark.parametrize("name", scenarios.names())
def test_every_named_scenario_runs_and_survives_json(name):
    scenario = scenarios.get(name)
    assert scenario.name == name
    assert scenario.description
    assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario
    action = "torque" if scenario.actuator.torque_limit is None else "fraction"
    env = TwoLinkArmEnv(scenario, action=action)
    observation, _ = env.reset(seed=0)
    for _ in range(3):
        assert observation in env.observation_space
        observation = env.step((0.0, 0.0))[0]


def test_severities_grow_from_the_nominal_arm():
    for name in set(scenarios.families()) - {"nominal"}:
        none = scenarios.family(name, 0)
        assert dataclasses.replace(none, name="nominal", description=Scenario().description) == Scenario()
        levels = [scenarios.family(name, severity) for severity in scenarios.SEVERITIES]
        assert len(set(levels)) == 4
    assert scenarios.get("nominal") == Scenario()
    assert scenarios.get("section-2-2/noise-2").arm == scenarios.get("paper-3a").arm


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("noises", 1), "did you mean 'noise'"),
        (("noise", 4), "severity must be"),
        (("noise", 1, "table1"), "did you mean 'table-1'"),
    ],
)
def test_wrong_families_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        scenarios.family(*arguments)


def test_records_are_frozen_and_hashable():
    scenario = scenarios.get("everything-3")
    assert isinstance(hash(scenario), int)
    with pytest.raises(dataclasses.FrozenInstanceError):
        scenario.control_dt = 1.0
    with pytest.raises(ValueError, match="unknown option 'rate'"):
        scenario.replace(rate=3)
    with pytest.raises(ValueError, match="unknown field of scenario 'nme'; did you mean 'name'"):
        Scenario.from_dict({"nme": "x"})


def test_papers_figures_have_the_papers_arms():
    assert scenarios.get("paper-3b").parameter_error.ratios == (2.0,) * 4
    real = TwoLinkArmEnv("paper-3b", action="torque")
    real.reset(seed=0)
    np.testing.assert_allclose([*real.truth.masses, *real.truth.lengths], [0.7, 0.5, 20.0, 15.0])
    large = TwoLinkArmEnv("paper-6a", action="torque")
    large.reset(seed=0)
    np.testing.assert_allclose([*large.truth.masses, *large.truth.lengths], [200.0, 150.0, 7.0, 5.0])


# Any valid combination of options works.

per_joint = st.one_of(st.floats(0.0, 50.0), st.tuples(st.floats(0.0, 50.0), st.floats(0.0, 50.0)))
sensor = st.fixed_dictionaries(
    {}, optional={"sigma": st.floats(0, 1), "bias": st.floats(-1, 1), "quantization": st.floats(0, 0.1)}
)
disturbances = st.one_of(
    st.fixed_dictionaries(
        {"kind": st.just("piecewise-constant"), "amplitude": per_joint, "period": st.sampled_from([0.003, 0.05])}
    ),
    st.fixed_dictionaries({"kind": st.just("sine"), "amplitude": per_joint, "frequency": st.floats(0, 20)}),
    st.fixed_dictionaries(
        {"kind": st.just("pulses"), "amplitude": per_joint, "period": st.just(0.02), "width": st.just(0.005)}
    ),
    st.fixed_dictionaries(
        {"kind": st.just("array"), "torque": st.just([[1.0, 2.0], [-3.0, 4.0]]), "dt": st.just(0.03)}
    ),
)
references = st.one_of(
    st.sampled_from(["minimum-jerk", "steps", "filtered-steps", "sine", "fourier"]),
    st.just({"kind": "array", "position": [[0.0, 0.0], [0.1, 0.2], [0.2, 0.1]]}),
    st.just({"kind": "steps", "points": [[0.0, 0.0]]}),
)
options = st.fixed_dictionaries(
    {"duration": st.just(0.1)},
    optional={
        "arm": st.sampled_from(["table-1", "section-2-2", {"m1": 0.01, "L2": 3.0, "gravity": 0.0}]),
        "parameter_error": st.fixed_dictionaries(
            {},
            optional={
                "ratio": st.floats(0.01, 100.0),
                "radius": st.floats(0.0, 10.0),
                "sampling": st.sampled_from(["each", "together"]),
                "payload": st.fixed_dictionaries({"mass": st.floats(0, 100), "pick_up": st.floats(0, 0.1)}),
            },
        ),
        "noise": st.fixed_dictionaries({}, optional={"position": sensor}),
        "friction": st.fixed_dictionaries(
            {},
            optional={
                "viscous": per_joint,
                "coulomb": per_joint,
                "stiction": per_joint,
                "v_s": st.floats(1e-6, 1.0),
                "law": st.sampled_from(["exact", "literal"]),
            },
        ),
        "disturbance": disturbances,
        "actuator": st.fixed_dictionaries(
            {},
            optional={
                "torque_limit": st.floats(0.1, 1e5),
                "delay": st.sampled_from([0.0, 0.007, 0.03]),
                "lag": st.floats(0, 1),
            },
        ),
        "sensors": st.sampled_from([("position",), ("position", "velocity"), ("position", "acceleration")]),
        "reference": references,
        "preview": st.integers(0, 3),
        "physics_dt": st.sampled_from([0.001, 0.0005, 0.01]),
        "initial_error": st.floats(-3, 3),
        "reward": st.fixed_dictionaries({"tracking": st.sampled_from(["log", "l1"])}),
    },
)


def divides(options):
    """Whether every time is a multiple of the physics step, as it must be: with a coarse step, some drawn ones are not."""
    h = options.get("physics_dt", 0.001)
    push = options.get("disturbance", {})
    times = [push.get(name, 0.0) for name in ("period", "width", "dt")] + [
        options.get("actuator", {}).get("delay", 0.0)
    ]
    return all(abs(t / h - round(t / h)) < 1e-9 for t in times)


@settings(max_examples=80, deadline=None)
@given(options, st.integers(0, 2**64 - 1), st.sampled_from([0.0, 0.3, 1.0, 1e9]))
def test_any_combination_of_options_runs(options, seed, reach):
    """No NaN, observations in their space, rewards in [0, 1], no exception; single and batched alike."""
    assume(divides(options))
    env, batch = TwoLinkArmEnv(**options), TwoLinkArmVectorEnv(2, **options)
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    many, _ = batch.reset(seed=[seed, 0])
    for _ in range(10):
        assert observation in env.observation_space
        np.testing.assert_array_equal(many[0], observation)
        action = rng.uniform(-1, 1, 2) * reach
        observation, reward, terminated, truncated, _ = env.step(action)
        many, rewards, *_ = batch.step(np.stack([action, -action]))
        assert 0.0 <= reward <= 1.0
        assert rewards[0] == reward
        assert np.isfinite(observation).all()
        if terminated or truncated:
            break
