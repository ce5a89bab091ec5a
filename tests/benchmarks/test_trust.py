"""Code that a file names runs only with `--trust`."""

import pytest

from benchmarks import cli
from benchmarks.policies import external
from benchmarks.run.cell import run_cell
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell

LAW = "from controllers.simple import Zero as make_policy\nopen({flag!r}, 'w').close()\n"


@pytest.fixture
def flag(tmp_path, monkeypatch):
    """Files of this name are written by the law's code."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(external, "_TRUSTED", set())
    (tmp_path / "law_for_trust.py").write_text(LAW.format(flag=str(tmp_path / "ran")))
    return tmp_path / "ran"


@pytest.mark.parametrize("name", ["law_for_trust.py", "law_for_trust:make_policy"])
def test_a_result_that_names_code_is_verified_only_with_trust(name, flag, capsys):
    store = Store(flag.parent / "store")
    path = store.save(run_cell(Cell(name, "nominal", (0,))))
    flag.unlink()
    assert cli.main(["verify", str(path), "--store", "store"]) == 2
    assert f"names {name}, whose code would be run; give --trust if you trust it" in capsys.readouterr().err
    assert len(list(store.results())) == 1
    assert not flag.exists()
    assert cli.main(["verify", str(path), "--store", "store", "--trust"]) == 0
    assert flag.exists()


@pytest.mark.parametrize(("named", "status"), [("law_for_trust.py", 0), ("a.zip", 1)])
def test_a_suite_that_names_code_runs_only_with_trust(named, status, flag, capsys):
    """Trust covers archives too; this one is then refused for its content."""
    (flag.parent / "a.zip").write_bytes(b"PK")
    (flag.parent / "mine.toml").write_text(f'policies = ["zero", "{named}"]\nscenarios = ["nominal"]\nseeds = 1\n')
    line = ["leaderboard", "--suite", "mine.toml", "--store", "store", "--workers", "1"]
    assert cli.main(line) == 2
    assert f"mine.toml names {named}, whose code would be run; give --trust" in capsys.readouterr().err
    assert not flag.exists()
    assert cli.main([*line, "--trust"]) == status
    assert flag.exists() == (status == 0)
    assert ("a.zip must be an archive" in " ".join(capsys.readouterr().out.split())) == (status == 1)
