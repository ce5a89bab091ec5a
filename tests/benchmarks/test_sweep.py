"""Sweeps over the values of options, and tables for LaTeX."""

import csv
import dataclasses
import shlex

import pytest

from benchmarks import cli
from benchmarks.report.latex import escape, write_table
from benchmarks.run.suite import with_option
from fbl_gym import scenarios


@pytest.fixture(autouse=True)
def arm(folder):
    (folder / "arm.toml").write_text('base = "noise-1"\nduration = 0.5')


def rows(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def test_an_option_changes_where_its_path_leads():
    base = scenarios.get("noise-1")
    scenario = with_option(base, "noise.position", 0.01)
    assert scenario.name == "noise-1,noise.position=0.01"
    assert scenario.noise.velocity == base.noise.velocity
    assert scenario.noise.position == base.replace(noise={"position": 0.01}).noise.position
    assert with_option(base, "arm.m1", 7.0).arm.m1 == 7.0
    # Ranges that agents generalise over are values of the radius.
    trained_on = scenarios.get("everything-2")
    swept = with_option(trained_on, "parameter_error.radius", 2.0)
    assert swept.parameter_error == dataclasses.replace(trained_on.parameter_error, radius=2.0)


def test_a_sweep_goes_on_in_the_store(folder):
    line = "sweep pd-gravity zero --over noise.position=1e-4:1e-2:log:3 --scenario arm.toml --seeds 2 --workers 1"
    assert cli.main(shlex.split(line)) == 0
    runs = rows("results/sweep.csv")
    assert [run["noise.position"] for run in runs[::4]] == ["0.0001", "0.001", "0.01"]
    stored = {path: path.stat().st_mtime_ns for path in (folder / "results/board").iterdir()}
    assert cli.main(shlex.split(line)) == 0
    assert stored == {path: path.stat().st_mtime_ns for path in (folder / "results/board").iterdir()}


def test_two_options_give_every_pair_of_values(folder):
    line = "sweep pd-gravity --over arm.m2=2,4 --over noise.position=0:1e-2:lin:2 --scenario arm.toml --seeds 1"
    assert cli.main(shlex.split(f"{line} --workers 1 --csv two.csv --plot two.svg")) == 0
    assert [(run["arm.m2"], run["noise.position"]) for run in rows("two.csv")] == [
        ("2.0", "0.0"), ("2.0", "0.01"), ("4.0", "0.0"), ("4.0", "0.01"),
    ]  # fmt: skip
    drawn = (folder / "two.svg").read_text()
    assert "pd-gravity, noise.position 0<" in drawn
    assert "pd-gravity, noise.position 0.01<" in drawn


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        ("my_law.py 5 %", r"my\_law.py 5 \%"),
        ("a\\b{c}~d^2 & #1 $", r"a\textbackslash{}b\{c\}\textasciitilde{}d\textasciicircum{}2 \& \#1 \$"),
        ("-1.0 (-2–3)\n0 (≤5)", r"$-$1.0 ($-$2--3) 0 ($\le$5)"),
        ("computed-torque-dob 1e-3", "computed-torque-dob 1e-3"),
    ],
)
def test_a_text_is_printed_as_it_is(text, latex):
    assert escape(text) == latex


def test_columns_of_numbers_are_to_the_right(tmp_path):
    rows = [("l1", "-1.0", "none"), ("zero", "(2)", "all")]
    write_table(tmp_path / "t.tex", ("law", "error %", "access"), rows, "fbl-gym\nevaluate")
    assert (tmp_path / "t.tex").read_text().splitlines() == [
        "% fbl-gym evaluate", r"% \usepackage{booktabs}", r"\begin{tabular}{lrl}", r"\toprule", r"law & error \% & access \\",
        r"\midrule", r"l1 & $-$1.0 & none \\", r"zero & (2) & all \\", r"\bottomrule", r"\end{tabular}",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("line", "rows", "columns"),
    [
        ("evaluate pd-gravity --plot lines.png", 20, 3),
        ("evaluate pd-gravity zero --plot lines.png", 2, 6),
        ("evaluate pd-gravity zero --trials 2", 2, 3),
        ("sweep pd-gravity zero --over arm.m2=14,15,16 --workers 1", 2, 4),
        ("leaderboard --policies pd-gravity zero oracle-flm --scenarios arm.toml --workers 1", 3, 8),
    ],
)
def test_commands_write_their_table(line, rows, columns, folder, fbl_gym):
    (folder / "arm.toml").write_text('base = "noise-1"\nduration = 0.5\n')
    scenario = "" if "leaderboard" in line else "--scenario arm.toml"
    assert "table: table.tex" in fbl_gym(f"{line} {scenario} --seeds 2 --tex table.tex").out
    assert ("--plot" in line) == (folder / "lines.png").exists()
    body = (folder / "table.tex").read_text().split("\\midrule\n")[1].split("\\bottomrule")[0].splitlines()
    assert len(body) >= rows
    assert all(row.count("&") >= columns - 1 and row.endswith(r"\\") for row in body)
