"""The verdicts on the paper's claims, by `fbl-gym reproduce --short`, and the files of claims."""

import dataclasses
import json

import pytest

from benchmarks import cli
from benchmarks.cli import reproduce
from benchmarks.paper import claims
from benchmarks.paper.claim import Claim
from benchmarks.paper.claims import CLAIMS

R, U, N = "reproduced", "under assumptions", "not reproduced"
VERDICTS = {
    "figure-2-section-2-2": R,
    "figure-2-table-1": R,
    "leakage-of-parameters": R,
    "leakage-of-disturbance": U,
    "figure-3a-section-2-2": U,
    "figure-3a-table-1": U,
    "figure-3a-as-printed": N,
    "figure-3b-section-2-2": U,
    "figure-3b-table-1": R,
    "equation-10": U,
    "figure-4a-section-2-2": U,
    "figure-4a-table-1": U,
    "figure-4b-filter-section-2-2": U,
    "figure-4b-filter-table-1": U,
    "figure-4b-error-section-2-2": U,
    "figure-4b-error-table-1": N,
    "figure-4b-settling-section-2-2": U,
    "figure-4b-settling-table-1": N,
    "noise-of-1-db": N,
    "robust-radius-section-2-2": R,
    "robust-radius-table-1": U,
    "figure-6a": R,
    "figure-6b": R,
    "figure-6b-at-1-khz": N,
    "estimation-under-noise": R,
    "adaptive-radius-section-2-2": U,
    "adaptive-radius-table-1": U,
    "figure-7": U,
    "figure-8-section-2-2": U,
    "figure-8-table-1": R,
    "leakage-of-stiction": R,
    "figure-9": U,
    "figure-10": U,
    "figure-10-with-noise": U,
}
LONG = {"robust-radius-section-2-2", "adaptive-radius-section-2-2"}
"""Claims that take minutes; the same is measured on the arm of Table 1."""


def test_every_claim_has_a_verdict():
    assert list(VERDICTS) == list(CLAIMS)


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
    kinds = ("filter", "error", "settling")
    assert claims.select(["figure-4b"]) == [f"figure-4b-{k}-{arm}" for k in kinds for arm in ("section-2-2", "table-1")]
    assert claims.select(["figure-6b", "figure-2"]) == ["figure-2-section-2-2", "figure-2-table-1", "figure-6b"]
    assert claims.select([]) == list(CLAIMS)


CLAIM = Claim("6a", "a claim", "1 %", "2 %", "reproduced", "none", "nominal", "0")


def test_new_measurements_replace_old_ones_and_other_claims_stay(tmp_path, monkeypatch):
    """In the paper's order."""
    claims.save(tmp_path, {"figure-7": CLAIM, "figure-6a": dataclasses.replace(CLAIM, measured="3 %")})
    monkeypatch.setattr(reproduce, "measure_claim", lambda name, effort: (CLAIM, lambda path: None))
    assert cli.main(["reproduce", "--only", "figure-6a", "equation-10", "--out", str(tmp_path)]) == 0
    loaded = claims.load(tmp_path)
    assert loaded == dict.fromkeys(("equation-10", "figure-6a", "figure-7"), CLAIM)
    assert list(loaded) == ["equation-10", "figure-6a", "figure-7"]
    assert (tmp_path / "claims.md").read_text().count("2 %") == 3


@pytest.mark.parametrize("text", ["[{", "{}x", "[1]", '{"name": 1}', '[{"name": "figure-6a"}]', '[{"name": 1}]'])
def test_a_damaged_file_is_refused_before_anything_is_measured(text, tmp_path, capsys):
    (tmp_path / "claims.json").write_text(text)
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 2
    assert f"{tmp_path / 'claims.json'} is damaged, or not from `fbl-gym reproduce` (" in capsys.readouterr().err
    assert (tmp_path / "claims.json").read_text() == text
