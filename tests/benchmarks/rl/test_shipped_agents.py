"""The shipped agents match their descriptions."""

from pathlib import Path

import pytest

from benchmarks.rl import policy
from benchmarks.rl.agent import describe
from benchmarks.rl.policy import SHIPPED, best_seed, shipped, shipped_agent
from benchmarks.rl.validation import validate
from fbl_gym import Scenario, TwoLinkArmEnv, scenarios


def test_every_shipped_agent_has_a_factory():
    factories = {
        name.replace("_", "-") for name, value in vars(policy).items() if getattr(value, "kind", "") == "learned"
    }
    assert set(shipped()) == factories


def test_agents_have_three_training_seeds_or_more_and_less_than_10_megabytes():
    assert min(map(len, shipped().values())) >= 3
    assert sum(path.stat().st_size for path in SHIPPED.rglob("*")) < 10e6


def test_only_ppo_context_was_trained_with_context():
    assert [name for name in shipped() if describe(SHIPPED / name / "0")["interface"].get("context")] == ["ppo-context"]
    assert [name for name in shipped() if getattr(policy, name.replace("-", "_")).access == "privileged"] == [
        "ppo-context"
    ]


@pytest.mark.parametrize("name", shipped())
def test_an_agent_has_the_validation_error_of_its_description(name):
    """Within 2 %: `ppo-memory` tracks so closely that last bits decide whether joints stick, in 6 of the 16 runs."""
    description = describe(SHIPPED / name / str(best_seed(name)))
    each = tuple(map(scenarios.get, description.get("scenarios", ()))) or (Scenario.from_dict(description["scenario"]),)
    error = validate(lambda env: shipped_agent(name, env), each)
    assert error == pytest.approx(description["validation_mrad"], rel=0.02)
    assert description["command"].startswith("fbl-gym train")
    assert description["licence"] == "MIT"
    assert {"steps", "wall_s", "packages", "hyperparameters", "seed"} <= set(description)


def test_unknown_agents_and_training_seeds_are_refused():
    with pytest.raises(ValueError, match="unknown agent 'ppo-torq'; did you mean 'ppo-torque'"):
        shipped_agent("ppo-torq", TwoLinkArmEnv().interface)
    with pytest.raises(ValueError, match="unknown training seed 9"):
        policy.ppo_torque(TwoLinkArmEnv().interface, seed=9)


@pytest.mark.parametrize("name", shipped())
def test_the_model_card_of_an_agent_has_the_numbers_of_its_description(name):
    page = (Path(__file__).parents[3] / "docs" / "reference" / "agents.md").read_text(encoding="utf-8")
    card = page.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
    agents = {seed: describe(SHIPPED / name / str(seed)) for seed in shipped()[name]}
    for seed, agent in agents.items():
        rows = (SHIPPED / name / str(seed) / "curve.csv").read_text(encoding="utf-8").splitlines()[1:]
        assert min(rows, key=lambda row: float(row.split(",")[-1])).split(",")[0] == str(agent["steps"])
    best = agents[best_seed(name)]
    steps = ", ".join(f"{agent['steps']:,} (seed {seed})" for seed, agent in agents.items())
    errors = ", ".join(f"{agent['validation_mrad']:.3g}" for agent in agents.values())
    for text in (getattr(policy, name.replace("-", "_")).__doc__, steps, errors, best["command"], best["machine"]):
        assert text in card
