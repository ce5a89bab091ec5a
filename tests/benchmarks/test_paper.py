"""The paper's claims, in the short form of `fbl-gym reproduce`: fails when a verdict changes."""

import json

import pytest

from benchmarks import cli
from benchmarks.paper.claims import CLAIMS

R, U, N = "reproduced", "under a reading", "not reproduced"
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
LONG = {
    "robust-radius-section-2-2",
    "adaptive-radius-section-2-2",
}  # what Table 1's arm shows of a radius is enough here


def test_every_claim_has_a_verdict():
    assert list(VERDICTS) == list(CLAIMS)


@pytest.mark.parametrize("name", [name for name in VERDICTS if name not in LONG])
def test_reproduce(name, tmp_path, capsys):
    """The command itself: a table, a file of claims, and a plot of each."""
    assert cli.main(["reproduce", "--short", "--only", name, "--out", str(tmp_path)]) == 0
    (claim,) = json.loads((tmp_path / "claims.json").read_text())
    assert claim["verdict"] == VERDICTS[name], claim["measured"]
    assert all(claim[field] for field in ("figure", "claim", "paper", "measured", "reading", "scenario", "seed"))
    assert claim["command"] == f"fbl-gym reproduce --only {name}"
    for ending in ("png", "svg"):
        assert (tmp_path / f"{name}.{ending}").stat().st_size > 10_000
    assert "claims and plots" in capsys.readouterr().out


def test_an_unknown_claim_is_named(capsys):
    assert cli.main(["reproduce", "--only", "figure-11"]) == 2
    assert "unknown claim 'figure-11'; did you mean 'figure-10'" in capsys.readouterr().err
