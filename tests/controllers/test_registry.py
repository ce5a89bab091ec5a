"""The registry: names, arguments, entry points, and access to the environment."""

import json
from importlib import metadata
from pathlib import Path

import pytest

import controllers
from benchmarks.policies.spec import resolve
from benchmarks.run.suite import Cell
from controllers import registry
from fbl_gym import Interface, TwoLinkArmEnv


def point_at(monkeypatch, path):
    """Install an entry point "mine" that leads to "module:attribute"."""
    point = metadata.EntryPoint("mine", path, registry.ENTRY_POINTS)
    monkeypatch.setattr(registry, "entry_points", lambda: (point,))


def plain_factory(env):
    """Builds a policy; the name of its argument means nothing."""
    return env


def privileged_factory(interface):
    """Builds a policy that reads the truth."""
    return interface


privileged_factory.access = "privileged"


def misspelt_factory(interface):
    return interface


misspelt_factory.access = "truth"


def test_a_name_is_registered_once():
    with pytest.raises(ValueError, match="registered already"):
        controllers.register("zero", "controllers.simple:Zero", "again")


@pytest.mark.parametrize("name", [name for name in controllers.names() if controllers.kind(name) == "classical"])
def test_the_catalogue_has_the_access_of_the_class(name):
    assert controllers.access(name) == controllers.access(controllers.factory(name))


def test_an_installed_package_adds_a_policy(monkeypatch):
    point_at(monkeypatch, "controllers.simple:PdGravity")
    assert "mine" in controllers.names()
    assert controllers.access("mine") == "nominal"
    assert controllers.kind("mine") == "classical"
    assert controllers.summary("mine") == "PD with gravity compensation."
    assert controllers.make("mine", TwoLinkArmEnv(), frequency=3.0).frequency == (3.0, 3.0)


@pytest.mark.parametrize("factory", [plain_factory, lambda env, gain=1.0: env])
def test_the_name_of_an_argument_gives_no_way_to_the_truth(factory):
    assert isinstance(controllers.make(factory, TwoLinkArmEnv()), Interface)


def test_privileged_access_gets_the_environment():
    env = TwoLinkArmEnv()
    assert controllers.access(privileged_factory) == "privileged"
    assert controllers.make(privileged_factory, env) is env
    with pytest.raises(ValueError, match="needs the environment, got its interface"):
        controllers.make("oracle-flm", env.interface)


@pytest.mark.parametrize(
    ("factory", "access", "expected"),
    [
        (plain_factory, None, "nominal"),
        (plain_factory, "privileged", "privileged"),
        (privileged_factory, None, "privileged"),
        ("controllers.oracle:OracleFlm", None, "privileged"),
    ],
)
def test_access_is_registered_or_declared(monkeypatch, factory, access, expected):
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
    controllers.register("mine", factory, "a policy", access=access)
    assert controllers.access("mine") == expected


def test_an_unknown_access_word_is_an_error_that_names_the_valid_ones(monkeypatch):
    message = "unknown access.* 'truth'. Known: nominal, none, privileged"
    point_at(monkeypatch, f"{__name__}:misspelt_factory")
    monkeypatch.setattr(metadata.EntryPoint, "load", lambda point: misspelt_factory)
    for ask in (controllers.access, lambda name: controllers.make(name, TwoLinkArmEnv())):
        for policy in ("mine", misspelt_factory):
            with pytest.raises(ValueError, match=message):
                ask(policy)
    with pytest.raises(ValueError, match=message):
        controllers.register("other", plain_factory, "a policy", access="truth")


def test_a_name_may_end_in_gains(tmp_path, monkeypatch):
    """Gains come from text, file and folder; the last value counts, and an argument replaces it."""
    monkeypatch.chdir(tmp_path)
    Path("mine").mkdir()
    Path("mine/computed-torque.json").write_text('{"frequency": 3}')
    interface = TwoLinkArmEnv().interface
    made = {
        "computed-torque@frequency=7": 7.0,
        "computed-torque@mine": 3.0,
        "computed-torque@mine/computed-torque.json": 3.0,
        "computed-torque@tuned@frequency=7": 7.0,
        "computed-torque@frequency=7@mine": 3.0,
    }
    for name, frequency in made.items():
        assert controllers.make(name, interface).frequency == (frequency, frequency)
        assert controllers.make(name, interface, frequency=5.0).frequency == (5.0, 5.0)
    with pytest.raises(ValueError, match="unknown argument of computed-torque 'frequncy'"):
        controllers.make("computed-torque@frequncy=7", interface)


def test_gains_of_a_class(tmp_path, monkeypatch):
    """Those of its folder; where there are none, the error says how to find some."""
    monkeypatch.setattr(registry, "TUNED", tmp_path)
    for robot, frequency in (("geared", 3.0), ("direct", 4.0)):
        (tmp_path / robot).mkdir()
        (tmp_path / robot / "pd-gravity.json").write_text(json.dumps({"gains": {"frequency": frequency}}))
    env = TwoLinkArmEnv("geared-nominal")
    assert controllers.make("pd-gravity@geared", env).frequency == (3.0, 3.0)
    assert controllers.make("pd-gravity@tuned", env).frequency == (3.0, 3.0)
    assert controllers.make("pd-gravity@direct", env).frequency == (4.0, 4.0)
    assert controllers.make("pd-gravity@tuned", TwoLinkArmEnv("direct-nominal")).frequency == (4.0, 4.0)
    for name in ("pd-gravity@servo", "pd-gravity+springs@servo"):
        for use in (lambda text: controllers.make(text, env), resolve):
            with pytest.raises(ValueError, match=r"no tuned gains for the class .*fbl-gym tune pd-gravity.* --class"):
                use(name)
    with pytest.raises(ValueError, match="no tuned gains for the class servo"):
        controllers.make("pd-gravity@tuned", TwoLinkArmEnv("servo-nominal"))


TASKS = ("direct-nominal", "geared-nominal")


def test_results_follow_the_gains_of_every_class(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "TUNED", tmp_path)
    monkeypatch.setattr("benchmarks.policies.spec._RESOLVED", {})
    for robot in ("geared", "direct"):
        (tmp_path / robot).mkdir()
        (tmp_path / robot / "pd-gravity.json").write_text('{"gains": {"frequency": 3.0}}')
    first, cells = resolve("pd-gravity@tuned").identity, [Cell("pd-gravity@tuned", task, (0,)).key for task in TASKS]
    (tmp_path / "geared" / "pd-gravity.json").write_text('{"gains": {"frequency": 5.0}}')
    monkeypatch.setattr("benchmarks.policies.spec._RESOLVED", {})
    second = resolve("pd-gravity@tuned").identity
    assert {name for name in first if first[name] != second[name]} == {"data"}
    same = [Cell("pd-gravity@tuned", task, (0,)).key == key for task, key in zip(TASKS, cells, strict=True)]
    assert same == [True, False]  # a cell follows those of its own class
