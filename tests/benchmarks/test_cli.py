"""First contact: what `fbl-gym` says to someone who has mistyped something, and that its tables can be read."""

import contextlib
import io
import shlex
import subprocess
import sys

import pytest
from rich.console import Console

from benchmarks import cli
from benchmarks.analysis.board import assemble
from benchmarks.cli import list as names
from benchmarks.cli import play, sweep
from benchmarks.report import markdown, terminal
from benchmarks.report.columns import ALL, columns_of, number
from benchmarks.run.expansion import with_option
from benchmarks.run.runner import run_cell
from benchmarks.run.suite import SHORT_SEEDS, SUITES, load
from fbl_gym import scenarios

FEW = "--policies zero --scenarios nominal --seeds 1 --workers 1"


@pytest.mark.parametrize(("line", "message"), [
    ("evaluate cascade-fl", "unknown policy 'cascade-fl'; did you mean 'cascade-flm'? Nearest: "),
    ("evaluate pid-flm@tund", "did you mean 'pid-flm@tuned'"),
    ("evaluate zero --scenario mixed-eror-2", "did you mean 'mixed-error-2'"),
    ("evaluate zero --senario=nominal", "did you mean '--scenario'"),
    ("evaluate zero --plot trace.bmp", "must end in .png or .svg or .pdf, got 'trace.bmp'"),
    ("evaluate zero --plot /dev/null/x.png", "must be a file that can be written, got '/dev/null/x.png': none can"),
    ("evaluate zero --seeds 10001", "must be at most 10000, the test seeds there are, got '10001'"),
    ("leaderboard --policies zero ./", "a folder with an agent.json, got './'"),
    ("evaluate zero --trials 2 --trace a.csv", "--trace is for one trial, got --trials 2"),
    ("evaluate zero --csv runs.txt", "must end in .csv, got 'runs.txt'"),
    ("leaderboard --suite idael", "unknown suite 'idael'; did you mean 'ideal'"),
    ("leaderboard --suite lost.toml", "fbl-gym: No such file or directory: lost.toml"),
    ("leaderboard --scenarios mass-eror", "unknown scenario or family 'mass-eror'; did you mean 'mass-error'"),
    ("list policy", "invalid choice: 'policy' (choose from "),
    ("report --store nowhere", "nowhere lacks these results: run `fbl-gym leaderboard`"),
    ("tune pid-flm --class geared --scenarios servo-practice-delay-1", "--class must be left out with --scenarios"),
    ("tune zero", "zero has nothing to tune"), ("identify", "give the logs"), ("show ''", "unknown scenario ''"),
    ("reproduce --only figure-77", "unknown claim 'figure-77'; did you mean 'figure-7'"),
    ("leaderbord", "did you mean 'leaderboard'"), ("leaderboard --workers 99999", "must be at most "),
    ("evaluate zero --seeds 0", "must be a whole number, 1 or more, got '0'"),
    *[(f"leaderboard --cell-{x}", "must be a finite number") for x in ("timeout nan", "memory -1")],
    ("leaderboard --world mujoco --tex table.tex", "--tex is for one board"),
    ("evaluate os:getcwd --seeds 1", "getcwd makes no policy: it must take the interface"),
    ("check-policy nowhere.py", "there is no file nowhere.py"),
    ("check-policy .nomod:f", "must name a module as in an import, such as my_laws.pd, got '.nomod'"),
    ("check-policy controllers.nomod:f", "but there is no module controllers.nomod, installed or in "),
    ("check-policy controllers.laws.simple:Zeros", "factory of controllers.laws.simple 'Zeros'; did you mean 'Zero'"),
    ("tune controllers.laws.simple:PdGravity --ship", "--ship is for the laws that fbl-gym comes with, got 'contr"),
    *[(f"tune zero --least-phase {x}", f"from 0 to 180, got '{x}'") for x in ("-5", "nan", "181", "much")],
    ("tune pid-flm --seeds 9999", "there are 10000 tuning seeds"),
    ("tune pid-flm --storage results", "storage must be a URL such as sqlite:///"),
    ("tune pid-flm --scenarios servo-noise-2", "its motion is the board's"),
    *[
        (f"sweep zero --over {x}", "must be such as noise.position=1e-4:1e-2:log:9")
        for x in map("friction.coulomb={}".format, ("1:2:log", "1/2/3", "x1/2", "1/"))
    ],
    *[(f"sweep zero --over {x}", "must name an option") for x in ("=1,2", "name=1,2", "description=1")],
    *[(f"sweep zero --over arm.m1={x}:1:log:3", "must have ends above 0 for log") for x in (0, -1)],
    ("sweep zero --over noise.position=0.0010000001,0.0010000002", "values that differ in their first six digits"),
    ("sweep zero --over nois.position=1,2", "unknown field of scenario 'nois'; did you mean 'noise'"),
    ("sweep zero --over arm.m1=1 --over arm.m1=2", "must name options that are no part of each other, got arm.m1"),
    *[(f"identify --plan a.csv --start servo-{x}", "must have rigid j") for x in ("surprise-bend", "elastic-1")],
    ("identify --plan plan.csv --amplitude -1 1", "amplitude[0] must be a finite number greater than 0 and not above"),
    *[(f"identify --plan a.csv --amplitude 1 {x}", "amplitude[1] must be a finite number") for x in ("nan", "1e300")],
    *[(f"identify --plan a.csv --speed {x}", "speed must be a finite number greater than 0") for x in ("inf", "-1")],
    ("identify --validate none.csv", "No such file or directory: none.csv"),
    (f"leaderboard {FEW} --suite ideal ideal.toml", "--suite must give suites of different names, got ideal, ideal"),
    ("leaderboard --suite lists.toml", "policies of lists.toml must be a list of names, got []"),
    ("sweep zero --over noise.position=1:2:log:10001", "must be at most 10000, got '10001'"),
    ("sweep zero --over arm.m1=1:2:lin:999 --over arm.m2=1:2:lin:999", "at most 100000 cells, policies times values"),
    ("tune pid-flm --trials 1000000000", "must be at most 1000000, got '1000000000'"),
    ("evaluate zero --csv folder.csv", "must be a file, got 'folder.csv', which is a folder"),
])  # fmt: skip
def test_a_mistake_is_answered_with_what_is_right(line, message, folder, fbl_gym):
    (folder / "folder.csv").mkdir()
    (folder / "lists.toml").write_text("policies = []\nscenarios = []\n")
    (folder / "ideal.toml").write_text('policies = ["zero"]\nscenarios = ["nominal"]\n')
    before = {*folder.iterdir()}
    shown = fbl_gym(line, 2)
    assert message in shown.err
    assert shown.out == ""
    assert {*folder.iterdir()} <= {*before, folder / "results"}


def test_a_mistake_in_a_file_is_one_line(folder, fbl_gym):
    (folder / "bad.py").write_text("import os\n= 3\n")
    assert fbl_gym("evaluate bad.py", 2).err == "fbl-gym: SyntaxError: invalid syntax (bad.py, line 2)\n"
    law = "from controllers.laws.simple import PdGravity\nclass make_policy(PdGravity):\n    def torque(self, o, state):\n"
    (folder / "nan.py").write_text(f"{law}        return 0 * o[:, :2] + float('nan'), state\n")
    assert "nan.py after 0 s: actions must be finite, got [nan nan]" in fbl_gym("evaluate nan.py", 2).err


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_the_example_of_a_command_is_right(name):
    parser, example = cli.prepare(name)[0], cli.COMMANDS[name]["example"]
    assert example in parser.format_help()
    assert parser.parse_args(shlex.split(example))


def test_the_row_of_the_example_is_on_the_default_board():
    suite = load("servo")
    rows = [f"{policy}/{task.name}" for policy in suite.policies for task in suite.scenarios]
    assert cli.COMMANDS["verify"]["example"] in rows


def test_the_help_has_the_names_and_numbers_of_the_code():
    board, window = (" ".join(cli.prepare(name)[0].format_help().split()) for name in ("leaderboard", "play"))
    assert f" {', '.join(SUITES)}, or TOML files" in board
    assert f" {SHORT_SEEDS} seeds" in board
    assert f"after {play.ROUND:g} s" in window


@pytest.fixture(scope="module")
def board():
    tasks = [s.replace(duration=1.0) for s in load("ideal").scenarios if s.name != "everything-2"]
    suite = load("ideal").build(["zero", "slotine-li@tuned", "oracle-flm"], tasks, 1)
    return assemble([run_cell(cell) for cell in suite.cells])


def printed(board, **options):
    file = io.StringIO()
    terminal.leaderboard(Console(file=file, **options), board)
    return file.getvalue()


@pytest.mark.parametrize("policies", [(), ("zero",)])
def test_a_short_board_has_the_first_rows_and_the_policies_that_are_asked_for(board, policies):
    file = io.StringIO()
    terminal.leaderboards(Console(file=file, width=132), {"one": board, "two": board}, 1, policies)
    shown = file.getvalue()
    assert shown.count("slotine-li@tuned") == 3  # on both boards and on that of both
    assert shown.count("zero ") == 3 * len(policies)
    assert "(oracle-flm)" not in shown
    assert shown.count(terminal.MEANING[:40]) == 1


def test_evaluate_prints_the_metrics_that_there_are(fbl_gym):
    """No step, no constraint and no event: seven metrics have no value."""
    short, every = (fbl_gym(["evaluate", "zero", "--seeds", "1", *more]).out for more in ([], ["--columns", "all"]))
    assert "settling_s" not in short
    assert " - " not in short
    assert every.count(" - ") >= 7
    both = fbl_gym("evaluate zero cascade-flm --scenario nominal --seeds 8").out
    assert "100 % (63–100)" in both


@pytest.mark.parametrize(("option", "label"), [
    ("noise.position", "noise.position [rad]"), ("noise.velocity.bias", "noise.velocity.bias [rad/s]"),
    ("joint", "joint [N m/rad]"), ("arm.m2", "arm.m2 [kg]"), ("encoder", "encoder"),
])  # fmt: skip
def test_a_sweep_names_the_unit_of_its_option(option, label):
    assert sweep._label(option, factor=False) == label
    assert sweep._label(option, factor=True) == f"factor on {option}"


def test_a_pair_is_a_value_and_two_options_make_a_grid_in_latex(folder, fbl_gym):
    (folder / "short.toml").write_text('base = "paper-8"\nduration = 0.1\n')
    line = "sweep zero pid-flm --over friction.coulomb=1/2,3/4 --over arm.m2=15,20 --scenario short.toml --seeds 1"
    shown = fbl_gym(f"{line} --workers 1 --csv s.csv --tex s.tex --plot s.svg").out
    assert "zero, arm.m2 15" in shown
    heads = r"\multicolumn{2}{c}{zero, arm.m2 [kg]} & \multicolumn{2}{c}{pid-flm, arm.m2 [kg]} \\"
    first, second, _, *rows = (folder / "s.tex").read_text().splitlines()[5:10]
    assert first == rf"\multicolumn{{1}}{{c}}{{}} & {heads}"
    assert second == r"friction.coulomb [N m] & 15 & 20 & 15 & 20 \\"
    assert [row.split(" & ")[0] for row in rows] == ["1/2", "3/4"]
    assert [row.split(",")[1] for row in (folder / "s.csv").read_text().splitlines()[1:]] == ["1/2"] * 4 + ["3/4"] * 4
    assert ">3/4</text>" in (folder / "s.svg").read_text()
    task = with_option(scenarios.get("paper-8"), "friction.coulomb", (1.0, 2.0))
    assert (task.name, task.friction.coulomb) == ("paper-8,friction.coulomb=1/2", (1.0, 2.0))


def test_the_board_in_a_file_has_the_numbers_of_the_markdown_table(board):
    shown, table = printed(board, width=132), markdown.leaderboard(board)
    assert f"{len(board.scenarios)} scenarios, 1 seed each" in shown
    for error, policy in zip(board.error().value, board.policies, strict=True):
        (row,) = [line for line in shown.splitlines() if line.strip("( ").startswith(policy)]
        assert number(error) in row.split()
        assert f" {number(error)} (" in next(line for line in table.splitlines() if f"`{policy}`" in line)


@pytest.mark.parametrize("width", [72, 100, 132])
def test_the_board_on_a_terminal_has_the_main_columns_that_fit(board, width):
    shown = printed(board, width=width, force_terminal=True, color_system=None)
    assert "…" not in shown
    assert max(map(len, shown.splitlines())) <= width
    (row,) = [line.split() for line in shown.splitlines() if line.lstrip().startswith("slotine-li@tuned")]
    _, _, named = " ".join(shown.split()).partition("also shows ")
    hidden = named.split(".")[0].split(", ") if named else []
    words = 1 + ("worst family" not in hidden)  # of "0 (≤11)" and "1.9, noise"
    assert len(row) + len(hidden) == len(columns_of(board, ALL)) + words


def test_a_list_has_a_line_each_and_a_family_once(fbl_gym):
    whole = fbl_gym(["list"]).out.splitlines()
    assert len(whole) == sum(len(found()) for found in names.LISTS.values()) + len(names.LISTS)
    shown = [line.partition("  ")[0] for line in fbl_gym(["list", "scenarios"]).out.splitlines()]
    assert {"paper-10", "nominal", "noise-0 to -3"} <= set(shown)
    assert len(shown) == len(set(shown)) < 140


@pytest.mark.usefixtures("folder")
def test_help_on_training_needs_no_extra(fbl_gym, monkeypatch):
    for name in ("torch", "stable_baselines3"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "benchmarks.cli.train", raising=False)
    fbl_gym("train --help")
    assert "pip install 'fbl-gym[rl]'" in fbl_gym("train ppo --steps 10", 2).err


WITHOUT_EXTRAS = """
import sys
from benchmarks import cli
absent = {module for modules in cli.EXTRAS.values() for module in modules} - {"torch"}  # SciPy looks for it
sys.modules.update(dict.fromkeys(absent))
sys.exit(cli.main(sys.argv[1:]))
"""


@pytest.mark.parametrize(("line", "extra"), [
    ("list", ""), ("doctor", ""), ("margins pid-flm", "bench"), ("tune pid-flm", "analysis"),
])  # fmt: skip
def test_first_commands_need_no_extra_and_others_name_theirs(line, extra, tmp_path):
    absent = "[cli.EXTRAS['analysis']]" if extra == "analysis" else "cli.EXTRAS.values()"
    code = WITHOUT_EXTRAS.replace("cli.EXTRAS.values()", absent)
    words = [sys.executable, "-c", code, *shlex.split(line)]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == (2 if extra else 0), done.stderr
    assert (f"pip install 'fbl-gym[{extra}]'" in done.stderr) == bool(extra)
    assert "Traceback" not in done.stderr
    assert "cannot be loaded" not in done.stdout.replace("cannot be loaded: ImportError", "")


def test_no_name_controls_the_terminal(folder, capsys):
    """Raw escapes in the names of a scenario and a policy, and in an error, are shown as text."""
    (folder / "evil.toml").write_text('base = "nominal"\nname = "\\u001b[31mred"\nduration = 0.5\n')
    evil = "\x1b[2Jlaw.py"
    (folder / evil).write_text("from controllers.laws.simple import PdGravity as make_policy\n")
    (folder / "fails.py").write_text("raise ValueError('\\x1b[2J')\n")
    board = f"--scenarios evil.toml --seeds 1 --policies zero {evil}"
    for line in (
        f"evaluate zero {evil} --scenario evil.toml --seeds 1",
        f"leaderboard {board} --workers 1",
        f"report {board}",
        f"verify {evil}/\x1b[31mred",
        f"verify {evil}/lost",
        "evaluate fails.py",
        "evaluate \x1b[31mlost",
        "evaluate zero --\x1b[31mlost",
        f"check-policy {evil}:\x1b[31mlost",
        f"margins {evil} --scenario evil.toml",
        f"sweep {evil} --over noise.position=1e-3 --scenario evil.toml --seeds 1 --workers 1 --csv \x1b[0m.csv",
        f"tune {evil} --trials 1 --seeds 1 --fresh-seeds 2 --candidates 1 --scenarios noise-1 --storage sqlite:///a.db",
    ):
        with contextlib.suppress(SystemExit):
            cli.main(shlex.split(line))
        shown = "".join(capsys.readouterr())
        assert "\x1b" not in shown
        assert "\\u001b[" in shown or "\\x1b[" in shown  # the latter in quotes
    for file in folder.rglob("*"):
        assert file.suffix not in (".csv", ".html", ".json", ".md", ".tex") or b"\x1b" not in file.read_bytes()


def test_no_row_of_margins_is_a_failure(fbl_gym):
    assert "no margins of zero: at[0] must be a finite number, got nan" in fbl_gym("margins zero --at nan nan", 1).out


@pytest.mark.parametrize(("change", "status", "message"), [
    (">&- 2>&- <&-", 0, ""), (">&-", 0, ""), ("NUMBA_DISABLE_JIT=1", 2, "NUMBA_DISABLE_JIT must be unset"),
])  # fmt: skip
def test_no_state_of_the_shell_is_a_traceback(change, status, message):
    line = f"{sys.executable} -m fbl_gym list suites"
    line = f"{line} {change}" if change.startswith(">") else f"{change} {line}"
    done = subprocess.run(line, shell=True, capture_output=True, text=True)
    assert (done.returncode, message in done.stderr, "Traceback" in done.stderr) == (status, True, False)
