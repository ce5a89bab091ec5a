"""The paper's claims: this test fails when a verdict changes."""

import json

from benchmarks import cli

VERDICTS = [
    ("3a", "under a reading"),
    ("3a", "not reproduced"),
    ("3b", "reproduced"),
    ("4a, 4b", "under a reading"),
    ("4b", "under a reading"),
    ("4b", "not reproduced"),
    ("§3", "reproduced"),
    ("6a", "reproduced"),
    ("6b", "reproduced"),
    ("8", "reproduced"),
    ("10", "not reproduced"),
]


def test_reproduce(tmp_path, capsys):
    """The command itself: a table, a file of claims, and a plot of each."""
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 0
    claims = json.loads((tmp_path / "claims.json").read_text())
    assert [(claim["figure"], claim["verdict"]) for claim in claims] == VERDICTS
    for claim in claims:
        assert all(claim[field] for field in ("claim", "paper", "measured", "reading", "scenario", "command"))
    assert len(list(tmp_path.glob("*.png"))) == len(list(tmp_path.glob("*.svg"))) == len(VERDICTS)
    assert "not reproduced" in " ".join(capsys.readouterr().out.split())
