"""The verdicts on the paper's claims, by `fbl-gym reproduce --short`, and the files of claims."""

import dataclasses
import json

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.cli import reproduce
from benchmarks.paper import claims, radius
from benchmarks.paper.claim import Case, Claim, judge
from benchmarks.paper.claims import CLAIMS
from fbl_gym import TwoLinkArmVectorEnv

R, U, N, NONE = "reproduced", "under assumptions", "not reproduced", "–"
VERDICTS = {
    "figure-2": R,
    "leakage-of-parameters": R,
    "leakage-of-disturbance": R,
    "figure-3a": R,
    "figure-3a-as-printed": N,
    "figure-3b": R,
    "equation-10": U,
    "figure-4a": U,
    "figure-4b-filter": U,
    "figure-4b-error": U,
    "figure-4b-settling": U,
    "kalman-filter": R,
    "robust-radius": U,
    "equation-22": R,
    "figure-5": U,
    "figure-6a": U,
    "figure-6b": U,
    "estimation-under-noise": NONE,
    "adaptive-radius": U,
    "figure-7": U,
    "figure-8": U,
    "leakage-of-stiction": R,
    "figure-9": R,
    "soft-scheduling": U,
    "figure-10": U,
    "figure-10-with-noise": NONE,
}
LONG = {"figure-4a", "robust-radius", "adaptive-radius", "soft-scheduling", "figure-10", "figure-10-with-noise"}
"""Claims that take long. Their parts are tested by others, and `fbl-gym reproduce` measures them."""


def test_one_rule_gives_every_verdict():
    """A case holds if the 95 % interval of the share of seeds lies above 90 %; all, some or no cases hold."""
    assert Case("", np.arange(64) < 63).holds
    assert not Case("", np.arange(64) < 62).holds
    assert Case("", True).holds
    assert not Case("", False).holds
    yes, no, shown = Case("yes", True), Case("no", np.zeros(8, dtype=bool)), Case("shown")
    for cases, verdict in (([yes, shown], R), ([yes, no], U), ([no], N), ([shown], NONE)):
        assert judge(cases)[0] == verdict
    assert judge([yes, no, shown])[1] == "1 of 2"
    assert no.row == ("no", "", "0 of 8, 0–37 %", "no")


def test_a_radius_has_the_interval_of_its_share():
    """Errors 10 u log(1 + r), u uniform: 95 % of them are below 5 up to log(1 + r) = 0.5 / 0.95."""
    r = np.array([0.0, 1.0, 2.0, 3.0])
    error = 10.0 * np.log1p(r)[:, None] * (np.arange(512) + 0.5) / 512
    value, low, high = radius.radius(r, error, 5.0)
    assert value == pytest.approx(np.expm1(0.5 / 0.95), abs=0.02)
    assert 0.6 < low < value < high < 0.8
    assert radius.radius(r, 0.0 * error, 5.0) == (np.inf,) * 3


@pytest.mark.parametrize(("direction", "low", "high"), [("larger", 1, 4), ("smaller", 0.25, 1), ("both", 0.25, 4)])
def test_a_radius_has_directions(direction, low, high):
    """Radius 3: the real parameters lie within [1, 4], [1/4, 1] and [1/4, 4] times the nominal ones, and fill them."""
    env = TwoLinkArmVectorEnv(500, radius.with_radius(radius.task("Table 1"), 3.0, direction), action="torque")
    env.reset(seed=0)
    ratios = np.hstack([env.truth.masses / [20.0, 15.0], env.truth.lengths / [0.7, 0.5]])
    assert np.all((ratios > low - 1e-9) & (ratios < high + 1e-9))
    assert ratios.min() < low * 1.05
    assert ratios.max() > high / 1.05


def test_every_claim_has_a_verdict():
    assert list(VERDICTS) == list(CLAIMS)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in VERDICTS if name not in LONG])
def test_a_claim_has_its_verdict_a_file_and_plots(name, tmp_path, capsys):
    assert cli.main(["reproduce", "--short", "--only", name, "--out", str(tmp_path)]) == 0
    (claim,) = json.loads((tmp_path / "claims.json").read_text())
    assert claim["verdict"] == VERDICTS[name], claim["measured"]
    assert all(claim[field] for field in ("figure", "claim", "paper", "measured", "assumptions", "scenario", "seed"))
    assert claim["command"] == f"fbl-gym reproduce --only {name}"
    for suffix in ("png", "svg"):
        assert (tmp_path / f"{name}.{suffix}").stat().st_size > 10_000
    assert "claims and plots" in capsys.readouterr().out


def test_an_unknown_claim_is_refused(capsys):
    assert cli.main(["reproduce", "--only", "figure-11"]) == 2
    assert "unknown claim 'figure-11'; did you mean 'figure-10'" in capsys.readouterr().err
    assert cli.main(["reproduce", "--only", "figure-6a", "figure-4"]) == 2
    assert "all of them: fbl-gym list claims" in capsys.readouterr().err


def test_the_beginning_of_a_name_selects_all_claims_with_it():
    assert claims.select(["figure-4b"]) == [f"figure-4b-{kind}" for kind in ("filter", "error", "settling")]
    assert claims.select(["figure-6b", "leakage"])[-1] == "leakage-of-stiction"
    assert claims.select([]) == list(CLAIMS)


CLAIM = Claim(
    "6a", "a claim", "1 %", "2 %", "reproduced", "1 of 1", "none", "nominal", "0", (("a case", "2 %", "", "yes"),)
)


def test_new_measurements_replace_old_ones_and_other_claims_stay(tmp_path, monkeypatch):
    """In the paper's order."""
    claims.save(tmp_path, {"figure-7": CLAIM, "figure-6a": dataclasses.replace(CLAIM, measured="3 %")})
    monkeypatch.setattr(reproduce, "measure_claim", lambda name, effort: (CLAIM, lambda path: None))
    assert cli.main(["reproduce", "--only", "figure-6a", "equation-10", "--out", str(tmp_path)]) == 0
    loaded = claims.load(tmp_path)
    assert loaded == dict.fromkeys(("equation-10", "figure-6a", "figure-7"), CLAIM)
    assert list(loaded) == ["equation-10", "figure-6a", "figure-7"]
    assert (tmp_path / "claims.md").read_text().count("Measured: 2 %") == 3


@pytest.mark.parametrize("text", ["[{", "{}x", "[1]", '{"name": 1}', '[{"name": "figure-6a"}]', '[{"name": 1}]'])
def test_a_damaged_file_is_refused_before_anything_is_measured(text, tmp_path, capsys):
    (tmp_path / "claims.json").write_text(text)
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 2
    assert f"{tmp_path / 'claims.json'} is damaged, or not from `fbl-gym reproduce` (" in capsys.readouterr().err
    assert (tmp_path / "claims.json").read_text() == text
