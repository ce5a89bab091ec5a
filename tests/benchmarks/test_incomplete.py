"""An incomplete store: the page, the Markdown, the terminal and the exit status of `fbl-gym report` say it."""

from benchmarks import cli


def test_an_incomplete_report_says_what_it_lacks(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    few = ["--policies", "zero", "--seeds", "1", "--scenarios"]
    assert cli.main(["leaderboard", *few, "nominal", "--workers", "1"]) == 0
    assert cli.main(["report", *few, "nominal"]) == 0
    assert "ncomplete" not in (tmp_path / "results" / "report" / "board.md").read_text()
    capsys.readouterr()
    assert cli.main(["report", *few, "nominal", "noise-1", "noise-2"]) == 1
    sentence = "Incomplete: 2 of 3 scenarios have no results: noise-1, noise-2"
    shown = capsys.readouterr()
    assert sentence in shown.out
    assert "the report is incomplete" in shown.err
    for name in ("board.md", "board.html"):
        assert sentence in (tmp_path / "results" / "report" / name).read_text(encoding="utf-8")


def test_a_page_is_complete_or_as_it_was(tmp_path, monkeypatch):
    """Killed while it writes, the report leaves the last page."""
    monkeypatch.chdir(tmp_path)
    few = ["--policies", "zero", "--seeds", "1", "--scenarios", "nominal"]
    assert cli.main(["leaderboard", *few, "--workers", "1"]) == 0
    assert cli.main(["report", *few]) == 0
    folder = tmp_path / "results" / "report"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    assert cli.main(["report", *few]) == 130
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
