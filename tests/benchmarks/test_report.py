"""Reports, run as a user runs them."""

import csv
import re

import pytest

from benchmarks.run.metrics import METRICS

FEW = "--policies zero --seeds 1 --scenarios nominal"


def test_the_report_has_every_run_and_the_accesses(tmp_path, fbl_gym):
    store, out, readme = (tmp_path / name for name in ("store", "out", "README.md"))
    same = f"--policies zero pid-flm cascade-flm oracle-flm --seeds 3 --scenarios nominal --store {store}"
    shown = fbl_gym(f"leaderboard {same} --workers 1").out.replace("\n", "")
    assert all(text in shown for text in ("1 scenario, 3 seeds each", "cascade-flm", "(oracle-flm)", "a page of them"))
    assert not list(store.glob(".*"))
    readme.write_text("before\n<!-- leaderboard -->\nold\n<!-- /leaderboard -->\nafter\n")
    fbl_gym(f"report {same} --out {out} --readme {readme}")
    table = (out / "board.md").read_text()
    assert table.startswith("| policy | rank | error % | lost runs % | × oracle |")
    before, _, rest = readme.read_text().partition("<!-- leaderboard -->\n")
    short, _, after = rest.partition("<!-- /leaderboard -->\n")
    assert (before, after) == ("before\n", "after\n")
    header, _, first, *_ = short.splitlines()
    assert header == "| rank | servo |"
    assert re.fullmatch(r"\| 1 \| `[\w-]+` [\d.]+ % \|", first)
    page, picture = ((tmp_path / "docs" / name).read_text() for name in ("results/board.md", "pictures/errors.svg"))
    assert "cascade-flm" in page
    assert "cascade-flm<" in picture  # a dot for each ranked policy
    assert "oracle-flm<" not in picture
    page = (out / "board.html").read_text()
    assert "cascade-flm" in page
    assert "src=" not in page.partition("<body")[0].replace("data:", "")
    runs = list(csv.DictReader((out / "board.csv").read_text().splitlines()))
    assert (len(runs), len({run["policy"] for run in runs})) == (12, 4)
    assert set(runs[0]) == {"policy", "scenario", "control_dt", "seed", *METRICS}


@pytest.fixture
def report(folder, fbl_gym):
    """The folder of a complete report."""
    fbl_gym(f"leaderboard {FEW} --workers 1")
    fbl_gym(f"report {FEW}")
    return folder / "results" / "report"


def test_an_incomplete_report_says_what_it_lacks(report, fbl_gym):
    assert "ncomplete" not in (report / "board.md").read_text()
    shown = fbl_gym(f"report {FEW} noise-1 noise-2", 1)
    sentence = "Incomplete: 2 of 3 scenarios have no results: noise-1, noise-2"
    assert sentence in shown.out
    assert "the report is incomplete" in shown.err
    for name in ("board.md", "board.html"):
        assert sentence in (report / name).read_text(encoding="utf-8")


def test_a_page_is_complete_or_as_it_was(report, fbl_gym, monkeypatch):
    """Killed while it writes, the report leaves the last page."""
    before = {path.name: path.read_bytes() for path in report.iterdir()}
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    fbl_gym(f"report {FEW}", 130)
    assert {path.name: path.read_bytes() for path in report.iterdir()} == before
