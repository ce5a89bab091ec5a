"""Training runs of a few hundred steps, and the command `fbl-gym train`."""

import copy
import csv
import dataclasses
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from filelock import FileLock

from benchmarks.agents.adapter import AdapterSettings
from benchmarks.agents.agent import Agent, describe, read
from benchmarks.cli.train import _in_tier
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.training import training_settings
from benchmarks.training.ppo import PPO, _Arms
from benchmarks.training.progress import Progress
from benchmarks.training.train import train
from benchmarks.training.training_settings import SEEDS_PER_RUN, TrainingSettings, shipped_hyperparameters
from benchmarks.training.validation import VALIDATION, tracking_error, validate
from fbl_gym import TwoLinkArmVectorEnv, scenarios
from tests.benchmarks.rl.agents import MISTAKES, batch

SCENARIO = scenarios.get("everything-2").replace(duration=0.2)
PLAIN = AdapterSettings(sensors=("position", "velocity"))
ON_POLICY = {"lanes": 4, "steps": 640, "arguments": {"n_steps": 20, "batch_size": 40, "learning_rate": 1e-3}}
OFF_POLICY = {"lanes": 4, "steps": 200, "arguments": {"learning_starts": 20, "buffer_size": 300, "learning_rate": 1e-3}}
SB3_PPO = {"lanes": 4, "steps": 200, "arguments": {"n_steps": 10, "batch_size": 20, "learning_rate": 1e-3}}


def settings(algorithm="ppo", **changes):
    hyperparameters = {"ppo": ON_POLICY, "sb3-ppo": SB3_PPO}.get(algorithm, OFF_POLICY)
    given = {"scenarios": (SCENARIO,), "hyperparameters": hyperparameters}
    return TrainingSettings(**{"algorithm": algorithm, **given, **changes})


def curve(folder):
    with (folder / "curve.csv").open() as file:
        return [(int(row["steps"]), float(row["validation_mrad"])) for row in csv.DictReader(file)]


@pytest.mark.parametrize("algorithm", ["ppo", "sb3-ppo", "tqc"])
def test_a_run_writes_the_agent_that_it_validated(algorithm, tmp_path):
    train(settings(algorithm), tmp_path, command="fbl-gym train", evaluations=2)
    description, points = describe(tmp_path), curve(tmp_path)
    assert description["command"] == "fbl-gym train"
    assert description["packages"]["stable-baselines3"]
    assert bool(list(tmp_path.rglob("events.*"))) == (algorithm != "ppo")
    assert (description["scenario"], points[-1][0]) == (SCENARIO.to_dict(), settings(algorithm).steps)
    assert description["validation_mrad"] == min(error for _, error in points)
    env = TwoLinkArmVectorEnv(len(VALIDATION), SCENARIO)
    error = tracking_error(Agent(env.interface, *read(tmp_path)), env, VALIDATION).mean()
    assert error == pytest.approx(description["validation_mrad"], abs=2e-4)


def test_an_agent_trains_on_several_scenarios_side_by_side(tmp_path, capsys):
    names = ["servo-practice-nominal", "servo-practice-delay-3"]
    each = tuple(scenarios.get(name).replace(duration=0.2) for name in names)
    adapter = dataclasses.replace(PLAIN, action="residual", history=2, drive=True, preview=0.05)
    train(settings(scenarios=each, adapter=adapter), tmp_path, evaluations=2)
    alone = validate(adapter, adapter.base, each)
    assert capsys.readouterr().err.startswith(f"{adapter.base} alone: validation {alone:.3f} mrad")
    assert describe(tmp_path)["scenarios"] == names
    assert validate(*read(tmp_path), each) == pytest.approx(describe(tmp_path)["validation_mrad"], abs=2e-4)


def test_an_algorithm_of_sb3_makes_as_many_updates_for_a_sample_with_any_number_of_lanes(tmp_path):
    updates = []
    for n in (1, 8):
        train(settings("sac", scenarios=(SCENARIO,) * n), tmp_path / str(n), evaluations=1)
        updates.append(torch.load(tmp_path / str(n) / "checkpoint.pt", weights_only=True)["learner"]["updates"])
    assert updates == [44, 44]  # some 176 samples: of 4 lanes with an update a step, of 8 with two


def test_the_validation_of_several_scenarios_is_that_of_a_board(tmp_path):
    """The geometric mean, over all runs, of the mean absolute error."""
    train(settings(), tmp_path, evaluations=1)
    tasks = [scenarios.get(name).replace(duration=0.3) for name in ("everything-1", "everything-2")]
    traces = [rollout(str(tmp_path), task, VALIDATION) for task in tasks]
    errors = np.array([[row["error_mrad"] for row in measure(trace)] for trace in traces])
    # `error_mrad` also counts the first sample, whose error is that of the initial state.
    first = [1e3 * np.abs(trace.reference - trace.position)[0].mean(axis=-1) for trace in traces]
    steps = tasks[0].steps
    expected = np.exp(np.log((errors * (steps + 1) - first) / steps).mean())
    assert validate(*read(tmp_path), tasks) == pytest.approx(expected, rel=1e-6)


def test_each_scenario_has_enough_lanes_and_a_seed_for_each():
    each = tuple(map(scenarios.get, scenarios.in_tier("servo-practice", (3,))))
    blend = AdapterSettings("blend", second="lqg")
    lanes = shipped_hyperparameters("ppo")["lanes"], shipped_hyperparameters("ppo", "blend")["lanes"]
    given = *((name, PLAIN, each) for name in ("sb3-ppo", "sac", "ppo")), ("ppo", blend, each[:10]), ("ppo", blend)
    expected = training_settings.LEAST_LANES, 1, lanes[0] // len(each), lanes[1] // 10, SEEDS_PER_RUN
    assert tuple(TrainingSettings(*arguments).lanes for arguments in given) == expected
    with pytest.raises(ValueError, match="not above 2000, got 2001"):
        TrainingSettings("ppo", scenarios=each[:2], hyperparameters=shipped_hyperparameters("ppo") | {"lanes": 2001})


def test_a_run_trains_on_the_motions_of_its_scenarios_and_on_others_that_no_board_has():
    tasks = tuple(map(scenarios.get, scenarios.in_tier("servo-practice", (1, 3))))
    assert TrainingSettings("ppo", scenarios=tasks).practice == [*tasks]
    practice, motions = TrainingSettings("ppo", scenarios=tasks, moves=3).practice, training_settings.MOTIONS
    assert [task.reference for task in practice[:5]] == [tasks[0].reference, *motions[:3], tasks[4].reference]
    assert {task.reference for task in practice} == {tasks[0].reference, *motions[:3]}  # saturation takes turns, too
    assert not any(map(scenarios.held_out_reason, practice))


def test_a_run_trains_on_drawn_arms_too():
    tasks = tuple(map(scenarios.get, scenarios.in_tier("geared-practice", (3,))))
    drawn, again, new = (TrainingSettings("ppo", scenarios=tasks, arms=2, seed=seed) for seed in (0, 0, 1))
    assert drawn.lanes == drawn.hyperparameters["lanes"] // (3 * len(tasks))
    assert drawn.practice[: len(tasks)] == [*tasks]
    assert drawn.practice == again.practice != new.practice
    others = drawn.practice[len(tasks) :]
    assert len({other.arm for other in others} - {task.arm for task in tasks}) == len(others) == 2 * len(tasks)
    assert not any(map(scenarios.held_out_reason, others))
    for task, other in zip(tasks + tasks, others, strict=True):
        usual = scenarios.as_scenario({"base": task.name, "arm": dataclasses.asdict(other.arm)})
        ratio = np.divide(other.actuator.torque_limit, usual.actuator.torque_limit)
        assert np.all((ratio >= 0.8) & (ratio <= 2.0))
        drive = dataclasses.replace(other.actuator, torque_limit=usual.actuator.torque_limit)
        assert other.replace(actuator=drive) == usual
    short = tasks[0].replace(duration=0.2)
    with pytest.raises(ValueError, match="arms must be 0 for a scenario that is of no tier, got 1: geared-practice"):
        TrainingSettings("ppo", scenarios=(*tasks, short), arms=1)


def test_the_value_sees_the_real_arm_and_the_agent_does_not():
    env = batch(3, PLAIN, "servo-practice-everything-3", duration=0.05)
    learner = PPO([env], 0, learning_rate=1e-3)
    model, x = learner._model, learner._now
    model.watch(x + torch.randn(100, *x.shape).mul(0.1).flatten(0, 1)[: len(x)])
    other = torch.cat([x[:, : learner._arms.observed], torch.randn(3, x.shape[1] - learner._arms.observed)], dim=1)
    with torch.no_grad():
        (policy, value), (same, another) = model(x), model(other)
    assert torch.equal(policy.mean, same.mean)
    assert not torch.equal(value, another)
    acted = learner.actor()(x[:, : learner._arms.observed].numpy().astype(float))
    np.testing.assert_allclose(acted, policy.mean.clamp(-1, 1), atol=1e-5)
    delay = 20 * env.unwrapped.truth.delay
    np.testing.assert_allclose(x[:, learner._arms.observed + 10], delay, rtol=1e-6)


def test_the_discount_is_that_of_the_horizon_in_each_batch():
    """A time in seconds, so that a batch with shorter steps has a discount nearer to 1."""
    envs = [batch(2, PLAIN, f"{robot}-practice-nominal", duration=0.03) for robot in ("servo", "geared")]
    learner = PPO(envs, 0, learning_rate=1e-3, horizon=0.1)
    np.testing.assert_allclose(learner._gamma, [0.9, 0.9, 0.99, 0.99], rtol=1e-6)


def test_an_episode_that_time_ends_has_its_last_observation():
    lanes = _Arms([batch(2, PLAIN, "servo-practice-nominal", duration=0.03)])
    lanes.reset(0)
    seen, _, _, cut, last = zip(*(lanes.step(np.full((2, 2), 0.1, np.float32)) for _ in range(3)), strict=True)
    same = [torch.equal(*(x[:, : lanes.observed] for x in pair)) for pair in zip(seen, last, strict=True)]
    assert ([each.tolist() for each in cut], same) == ([[False] * 2, [False] * 2, [True] * 2], [True, True, False])


def test_a_run_repeats_and_its_seed_and_reward_matter(tmp_path):
    """The reward of the hyperparameters is the environment's, whose default has a resolution of 1e-3."""
    results = []
    for seed, reward in ((0, {}), (0, {"resolution": 1e-3}), (1, {}), (0, {"resolution": 1e-4})):
        hyperparameters, folder = ON_POLICY | ({"reward": reward} if reward else {}), tmp_path / str(len(results))
        train(settings(seed=seed, hyperparameters=hyperparameters), folder, evaluations=3)
        results.append((curve(folder), read(folder)[1].layers[0][0].tolist()))
    assert results[0] == results[1]
    assert results[0][0] != results[3][0]
    assert results[0][1] != results[2][1]


@pytest.mark.parametrize("algorithm", ["ppo", "sb3-ppo", "sac"])
def test_a_stopped_run_goes_on_and_a_finished_one_is_extended(algorithm, tmp_path, monkeypatch, capsys):
    """It is stopped at its third validation and goes on from the checkpoint of the second."""
    errors, resume, resumed, given = iter([5.0, 3.0]), Progress.resume, [], settings(algorithm)
    monkeypatch.setattr("benchmarks.training.progress.validate", lambda *_: next(errors))
    with pytest.raises((StopIteration, RuntimeError)):
        train(given, tmp_path, evaluations=4)
    before, saved = curve(tmp_path), torch.load(tmp_path / "checkpoint.pt", weights_only=True)["learner"]
    monkeypatch.undo()

    def keep(self, learner):
        resume(self, learner)
        resumed.append(copy.deepcopy(learner.state()))

    monkeypatch.setattr(Progress, "resume", keep)
    train(given, tmp_path, evaluations=4)
    for part in (saved, resumed[0]):
        for name, values in part.pop("parameters", {}).items():
            part[name] = values.get("state", values)
    torch.testing.assert_close(resumed[0], saved, rtol=0, atol=0)
    after = curve(tmp_path)
    assert after[:2] == before
    assert after[-1][0] == given.steps > before[-1][0]
    with pytest.raises(ValueError, match="only steps and minutes of a run may change"):
        train(settings(algorithm, seed=1), tmp_path, evaluations=4)
    train(given, tmp_path, evaluations=4)
    assert curve(tmp_path) == after
    assert f"the run has {given.steps:,} steps already" in capsys.readouterr().err
    train(settings(algorithm, steps=2 * given.steps), tmp_path, evaluations=2)
    steps, _ = zip(*(longer := curve(tmp_path)), strict=True)
    assert list(steps) == sorted(set(steps))
    assert (steps[-1], longer[: len(after)]) == (2 * given.steps, after)


class Marker:
    """An object whose pickle, when it is loaded, makes a file in the current folder."""

    def __reduce__(self):
        return Path.touch, (Path("marker"),)


def test_a_resumed_folder_runs_no_code(folder):
    """Whatever file of a run has been exchanged."""
    train(settings("td3"), folder / "run", evaluations=1)
    for name in {path.name for path in (folder / "run").glob("*.p*")} | {"buffer.pkl", "checkpoint.pt"}:
        (folder / "run" / name).write_bytes(pickle.dumps(Marker()))
    with pytest.raises(ValueError, match="cannot be resumed"):
        train(settings("td3", steps=400), folder / "run", evaluations=1)
    assert not (folder / "marker").exists()


def test_a_run_of_some_processor_time_ends(tmp_path):
    train(settings(minutes=0.01), tmp_path, evaluations=2)
    assert describe(tmp_path)["wall_s"] < 60


def test_shipped_hyperparameters_state_their_tuning():
    for hyperparameters in map(shipped_hyperparameters, training_settings.ALGORITHMS):
        assert set(hyperparameters) == {"tuned", "lanes", "steps", "arguments"}
        assert len(hyperparameters["tuned"]) > 20


@pytest.mark.parametrize(("changes", "message"), [
    ({"algorithm": "ppp"}, "unknown algorithm 'ppp'; did you mean 'ppo'"),
    ({"seed": -1}, "seed must be a whole number not below 0, got -1"),
    ({"seed": 99999999}, "seed must be 0 to 2146482, since each has 1000 training seeds, got 99999999"),
    ({"steps": 0}, "steps must be a whole number not below 1, got 0"),
    ({"hyperparameters": ON_POLICY | {"reward": {"power": 2}}}, "unknown field of hyperparameters.reward 'power'"),
    ({"hyperparameters": ON_POLICY | {"rewards": {}}}, "unknown hyperparameter 'rewards'; did you mean 'reward'"),
    ({"minutes": 0}, "minutes must be a finite number greater than 0, got 0"),
    ({"scenarios": (scenarios.get("servo-lag-2"),)}, r"scenario must be one to train on.*servo-lag-2"),
])  # fmt: skip
def test_wrong_settings_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        settings(**changes)


def test_a_severity_that_a_tier_lacks_is_refused():
    assert len(_in_tier("servo-practice", [3])) == 15
    with pytest.raises(ValueError, match="--severity must be one of 1, 3 for servo-practice, got 2"):
        _in_tier("servo-practice", [3, 2])


def test_settings_without_a_length_take_the_steps_of_the_hyperparameters():
    assert settings().steps == ON_POLICY["steps"]
    assert settings(minutes=1.0).steps is None
    assert TrainingSettings("ppo").steps == shipped_hyperparameters("ppo")["steps"]
    blend = TrainingSettings("ppo", AdapterSettings("blend", second="pid-flm"))
    expected = shipped_hyperparameters("ppo", "blend") | {"lanes": SEEDS_PER_RUN}  # one scenario has no more
    assert blend.hyperparameters == expected != shipped_hyperparameters("ppo")


@pytest.fixture
def short(folder):
    """A folder with hyperparameters of a short run."""
    (folder / "short.json").write_text(json.dumps({"ppo": ON_POLICY}))
    return folder


SHORT = "train ppo --hyperparameters short.json --steps 80"


def test_options_reach_the_agent(short, fbl_gym):
    printed = fbl_gym(f"{SHORT} --interface residual --history 1 --preview 0.05 --scenario mixed-error-1")
    assert "agent: runs/ppo-residual-0" in printed.out
    assert "left" in printed.err
    description = describe(short / "runs" / "ppo-residual-0")
    assert description["interface"].items() >= {"history": 1, "preview": 0.05}.items()
    assert description["scenario"]["name"] == "mixed-error-1"


@pytest.mark.parametrize(("options", "lanes", "arguments", "message"), MISTAKES["train"])
def test_a_mistake_is_answered_with_what_is_right(options, lanes, arguments, message, short, fbl_gym):
    content = ON_POLICY | {"lanes": lanes, "arguments": ON_POLICY["arguments"] | arguments}
    (short / "short.json").write_text(json.dumps({"ppo": content}))
    (short / "none.json").touch()
    assert message in fbl_gym(f"{SHORT} {options}", 2).err


@pytest.mark.usefixtures("short")
def test_a_run_that_cannot_begin_leaves_the_folder_to_the_next(fbl_gym):
    """Without --sensors, the agent has those of its scenarios."""
    command = f"{SHORT} --scenario servo-practice-nominal --out run"
    assert "sensors must include 'position', got" in fbl_gym(f"{command} --sensors velocity", 2).err
    assert "not applicable" in fbl_gym(f"{command} --sensors position acceleration", 2).err
    fbl_gym(command)
    assert describe(Path("run"))["interface"]["sensors"] == ["position", "velocity"]


def test_a_folder_is_of_one_run_at_a_time(short, fbl_gym):
    with FileLock(short / ".lock"):
        assert "another `fbl-gym train` runs in ." in fbl_gym(f"{SHORT} --out .", 2).err
    assert {path.name for path in short.iterdir()} == {".lock", "short.json"}


@pytest.mark.parametrize(("name", "content"), [("run.json", b""), ("run.json", b"[]"), ("checkpoint.pt", b"PK")])
def test_a_damaged_run_is_refused(name, content, short, fbl_gym):
    fbl_gym(f"{SHORT} --out run")
    (short / "run" / name).write_bytes(content)
    said = fbl_gym(f"{SHORT} --out run", 2).err
    assert "fbl-gym: only steps and minutes" in said or "cannot be resumed" in said
