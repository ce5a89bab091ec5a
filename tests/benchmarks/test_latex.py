"""Tables for LaTeX: every text as it is, numbers to the right, and the same cells as on the terminal."""

import shlex

import pytest

from benchmarks import cli
from benchmarks.report.latex import escape, write_table


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
def test_commands_write_their_table(line, rows, columns, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text('base = "noise-1"\nduration = 0.5\n')
    scenario = "" if "leaderboard" in line else "--scenario arm.toml"
    assert cli.main(shlex.split(f"{line} {scenario} --seeds 2 --tex table.tex")) == 0
    assert "table: table.tex" in capsys.readouterr().out
    assert ("--plot" in line) == (tmp_path / "lines.png").exists()
    body = (tmp_path / "table.tex").read_text().split("\\midrule\n")[1].split("\\bottomrule")[0].splitlines()
    assert len(body) >= rows
    assert all(row.count("&") >= columns - 1 and row.endswith(r"\\") for row in body)
