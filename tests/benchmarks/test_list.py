"""`fbl-gym show` and `list`: numbers of a scenario and what follows from them; options, from their declarations."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from benchmarks.cli.show import follows, options
from fbl_gym import Scenario


def test_each_option_is_shown_with_its_unit():
    events = [{"kind": "knock", "time": 1.0, "impulse": (3, 1)}]
    friction = {"viscous": (1.0, 0.5), "coulomb": {"uniform": [1, 2]}}
    task = Scenario(friction=friction, actuator={"delay_samples": {"choice": [0, 2]}}, events=events)
    shown = dict(options(task))
    assert shown.items() >= {
        "friction.viscous [N m s/rad]": "1; 0.5", "friction.coulomb [N m]": "1 to 2, uniform",
        "actuator.delay_samples": "one of 0, 2", "events[0]: knock, impulse [N m s]": "3; 1",
    }.items()  # fmt: skip
    assert not any(name.startswith(("joint", "noise")) for name in shown)


def test_what_follows_is_right():
    """Against closed forms: weight of two point masses, dead time by addition, modes with one link alone."""
    facts = follows(Scenario())
    weight = f"{9.81 * (35 * 0.7 + 15 * 0.5):.3g}, {9.81 * 15 * 0.5:.3g} N m"
    assert facts["weight (largest torque of gravity)"] == weight
    assert facts["dead time"] == "5 ms"
    drive, encoder = {"delay_samples": 1, "delay": 0.002, "lag": 0.004}, {"difference": 1, "latency": 1}
    late = Scenario(actuator=drive, encoder=encoder)
    names = ("dead time", "delay of a command: delay, delay_samples, jitter")
    assert [follows(late)[name] for name in names] == ["36 ms", "12 ms"]
    flat = Scenario(arm={"gravity": 0.0}, friction={"coulomb": {"uniform": (1, 20)}})
    assert follows(flat)["largest Coulomb friction"] == "1, 2.5 % of the limit"
    assert "torque limit / weight" not in follows(flat)
    stiff = {"stiffness": (1e9, 4e4), "rotor_inertia": 1.0}
    stiff = follows(Scenario(joint=stiff, physics_dt=1e-6, duration=0.01))
    rate = np.sqrt(4e4 / 3.75) / (2 * np.pi)
    assert float(stiff["modes of the stretched links, motors held"].split(",")[0]) == pytest.approx(rate, rel=0.01)
    spring = {"frequency": (15.0, rate), "rotor_inertia": 1.0}
    for facts in (stiff, follows(Scenario(joint=spring, physics_dt=1e-4))):
        assert facts["stiffness of the joints"].endswith(", 4e+04 N m/rad")
        assert facts["frequency of each stretched joint alone, motor held"].endswith(f", {rate:.3g} Hz")
    bent = Scenario(link={"frequency": (8.0, 300.0)}, physics_dt=1e-5, duration=0.01)
    assert float(follows(bent)["modes of the links, joints held"].split(",")[0]) == pytest.approx(8.0, rel=0.01)
    assert "links that bend" in follows(bent)["most like"]


def test_two_scenarios_show_their_differences(fbl_gym):
    text = fbl_gym(["show", "servo-nominal", "servo-delay-2"]).out
    assert "actuator.delay" in text
    assert "friction" not in text.split("what follows")[0]
    assert "modes of the stretched" in fbl_gym(["show", "geared-nominal"]).out
    fbl_gym("show", 2)


def test_mistakes_of_units_are_named(tmp_path, fbl_gym):
    """Masses in grams, and stiffness in kN m/rad."""
    arm = "[arm]\nmass = [40, 25]\nlength = [0.1, 0.1]\ncentre = [0.05, 0.05]\ninertia = [1e-2, 1e-2]\nrotor = 0.1\n"
    arm = f'base = "servo-nominal"\nactuator.torque_limit = 0.1\n{arm}[joint]\nstiffness = 0.5\ndamping = 0.0\n'
    (tmp_path / "arm.toml").write_text(arm)
    shown = fbl_gym(["show", str(tmp_path / "arm.toml")]).err
    assert all(doubt in shown for doubt in ("of actuator.torque_limit, which is in N m", "stiffness is in N m/rad"))


DOCS = Path(__file__).parents[2] / "docs"


def test_an_option_is_listed_with_valid_values_unit_default_and_meaning(fbl_gym):
    lines = fbl_gym("list options").out.splitlines()
    texts = {name: text.strip() for name, _, text in (line.partition("  ") for line in lines)}
    form = "one or two numbers or distributions not below 0 [N m]"
    assert texts["friction.coulomb"] == form + "; default 0; Coulomb friction, f_i2."
    mass = "a number or distribution not below 0 [kg]; required; mass of the payload."
    assert texts["parameter_error.payload.mass"] == mass
    sine = "one or two numbers not below -1e+06 and not above 1e+06, or None [rad]; default None; phase"
    assert texts["disturbance[sine].phase"].startswith(sine)
    assert texts["reward.tracking"].startswith('"log" or "l1"; default log;')


def test_the_page_of_options_is_current():
    before = (DOCS / "reference" / "options.md").read_text(encoding="utf-8")
    assert before == runpy.run_path(str(DOCS / "conf.py"))["options_page"](), "run `make docs`"
