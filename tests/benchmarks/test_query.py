"""`fbl-gym query`: each current run once, and everything in the table `all_results`."""

import dataclasses

from benchmarks import cli
from benchmarks.report.export import query
from benchmarks.run.cell import run_cell
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell


def count(store, table):
    return int(query(store.results(), f"SELECT count(*) AS n FROM {table}").splitlines()[-1])


def test_older_code_and_other_sets_of_seeds_do_not_count_twice(tmp_path, capsys):
    store = Store(tmp_path)
    few, many = (run_cell(Cell("zero", "nominal", tuple(range(n)))) for n in (2, 5))
    older = dataclasses.replace(few.cell.policy, digest="of older code")
    for result in (few, many, dataclasses.replace(few, cell=Cell(older, "nominal", (0, 1)))):
        store.save(result)
    other = Cell("zero", few.cell.scenario.replace(noise={"position": 0.1}), (0, 1))
    store.save(dataclasses.replace(few, cell=other))
    assert count(store, "results") == 5
    assert count(store, "all_results") == 2 + 5 + 2 + 2
    assert count(store, "all_results WHERE current") == 2 + 5
    assert cli.main(["query", "SELECT count(DISTINCT key) FROM all_results", "--store", str(tmp_path)]) == 0
    assert "4" in capsys.readouterr().out


def test_an_answer_in_a_file_is_whole(tmp_path, capsys, monkeypatch):
    question = ["query", "SELECT i, i + 0.5 AS half FROM range(200) t(i)", "--store", str(tmp_path)]
    assert cli.main(question) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (len(lines), lines[0], lines[200]) == (201, "i,half", "199,199.5")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert cli.main(question) == 0
    assert "200 rows" in capsys.readouterr().out


def test_a_query_runs_no_code_of_a_file(tmp_path):
    law = tmp_path / "law.py"
    flag = tmp_path / "ran"
    law.write_text(f"from controllers.simple import Zero as make_policy\nopen({str(flag)!r}, 'w').close()\n")
    store = Store(tmp_path / "store")
    store.save(run_cell(Cell(str(law), "nominal", (0,))))
    flag.unlink()
    assert count(store, "results") == 1
    law.write_text(law.read_text().replace("Zero", "PdGravity"))
    assert count(store, "results") == 0
    assert not flag.exists()


def test_a_question_reads_and_writes_files_only_if_asked(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Store(tmp_path / "store").save(run_cell(Cell("zero", "nominal", (0,))))
    (tmp_path / "secret.csv").write_text("a\n1\n")
    ask = ["query", "--store", "store"]
    for question in (
        "COPY results TO 'board.csv'", "SELECT * FROM 'secret.csv'", "SELECT * FROM read_text('secret.csv')",
        "ATTACH 'other.db'", "SET enable_external_access = true", "INSTALL httpfs",
    ):  # fmt: skip
        assert cli.main([*ask, question]) == 2, question
    assert sorted(path.name for path in tmp_path.iterdir()) == ["secret.csv", "store"]
    assert cli.main([*ask, "COPY results TO 'board.csv'", "--files"]) == 0
    assert (tmp_path / "board.csv").read_text().count("\n") == 2
    assert "Traceback" not in capsys.readouterr().err
