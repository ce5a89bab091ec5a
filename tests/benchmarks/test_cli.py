"""First contact: what `fbl-gym` says to someone who has mistyped something, and that its tables and lists can be read."""

import contextlib
import io
import json
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmarks import cli
from benchmarks.agents.policy import SHIPPED
from benchmarks.analysis.board import assemble
from benchmarks.cli import leaderboard, play, sweep
from benchmarks.cli import list as names
from benchmarks.cli.show import follows, options
from benchmarks.report import markdown, terminal
from benchmarks.report.columns import ALL, columns_of, number
from benchmarks.run.expansion import with_option
from benchmarks.run.runner import run_cell
from benchmarks.run.suite import SHORT_SEEDS, SUITES, load
from fbl_gym import Scenario, scenarios

MISTAKES = tomllib.loads(Path(__file__).with_name("mistakes.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("line", "message"), MISTAKES.items())
def test_a_mistake_is_answered_with_what_is_right(line, message, folder, fbl_gym):
    (folder / "folder.csv").mkdir()
    files = {"lists": "policies = []\nscenarios = []\n", "empty": "", "arm": 'base = "dfki-c1"\n'}
    for name, text in (files | {"ideal": 'policies = ["zero"]\nscenarios = ["nominal"]\n'}).items():
        (folder / f"{name}.toml").write_text(text)
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
    policy, _, task = cli.COMMANDS["verify"]["example"].partition("/")
    assert policy in load("servo").policies
    assert task in {scenario.name for scenario in load("servo").scenarios}


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
    terminal.leaderboard(Console(file=(file := io.StringIO()), **options), board)
    return file.getvalue()


@pytest.mark.parametrize("policies", [(), ("zero",)])
def test_a_short_board_has_the_first_rows_and_the_policies_that_are_asked_for(board, policies):
    terminal.leaderboards(Console(file=(file := io.StringIO()), width=132), {"one": board, "two": board}, 1, policies)
    shown = file.getvalue()
    assert shown.count("slotine-li@tuned") == 3  # on both boards and on that of both
    assert shown.count("zero ") == 3 * len(policies)
    assert "(oracle-flm)" not in shown
    assert shown.count(terminal.MEANING[:40]) == 1


def test_a_short_board_shows_the_row_of_runs_that_are_asked_for(folder, fbl_gym, monkeypatch):
    monkeypatch.setattr(leaderboard, "SHOWN", 0)
    for seed in (0, 1):
        shutil.copytree(SHIPPED / "sac" / "0", folder / f"mine-{seed}")
        (folder / f"mine-{seed}" / "run.json").write_text(json.dumps({"seed": seed}))
    few = "--policies zero pid-flm --scenarios nominal --seeds 1 --workers 1"
    shown = fbl_gym(f"leaderboard --short {few} --policy ./mine-0 --policy ./mine-1").out
    assert ("mine, 2 training seeds" in shown, "zero " in shown) == (True, False)


def test_evaluate_prints_the_metrics_that_there_are(fbl_gym):
    """No step, no constraint and no event: seven metrics have no value."""
    short, every = (fbl_gym(f"evaluate zero --seeds 1 {more}").out for more in ("", "--columns all"))
    assert "settling_s" not in short
    assert " - " not in short
    assert every.count(" - ") >= 7
    assert "100 % (63–100)" in fbl_gym("evaluate zero cascade-flm --scenario nominal --seeds 8").out


def test_a_sweep_names_the_unit_of_its_option():
    units = {"noise.position": " [rad]", "noise.velocity.bias": " [rad/s]", "joint": " [N m/rad]", "encoder": ""}
    assert [sweep._label(option, factor=False) for option in units] == ["".join(pair) for pair in units.items()]
    assert with_option(scenarios.get("nominal"), "disturbance[sine].amplitude", 2.0).disturbance.amplitude == (2.0, 2.0)


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
    assert fbl_gym("list").out.count("\n") == sum(len(found()) + 1 for found in names.LISTS.values())
    shown = [line.partition("  ")[0] for line in fbl_gym("list scenarios").out.splitlines()]
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


NEEDS = {"list": "", "doctor": "", "margins pid-flm": "bench", "tune pid-flm": "analysis"}


@pytest.mark.parametrize(("line", "extra"), NEEDS.items())
def test_first_commands_need_no_extra_and_others_name_theirs(line, extra, tmp_path):
    absent = "[cli.EXTRAS['analysis']]" if extra == "analysis" else "cli.EXTRAS.values()"
    words = [sys.executable, "-c", WITHOUT_EXTRAS.replace("cli.EXTRAS.values()", absent), *line.split()]
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
        f"evaluate zero {evil} --scenario evil.toml --seeds 1", f"leaderboard {board} --workers 1", f"report {board}",
        f"verify {evil}/\x1b[31mred", f"verify {evil}/lost", "evaluate fails.py", "evaluate \x1b[31mlost",
        "evaluate zero --\x1b[31mlost", f"check-policy {evil}:\x1b[31mlost", f"margins {evil} --scenario evil.toml",
        f"sweep {evil} --over noise.position=1e-3 --scenario evil.toml --seeds 1 --workers 1 --csv \x1b[0m.csv",
        f"tune {evil} --trials 1 --seeds 1 --fresh-seeds 2 --candidates 1 --scenarios noise-1 --storage sqlite:///a.db",
    ):  # fmt: skip
        with contextlib.suppress(SystemExit):
            cli.main(shlex.split(line))
        shown = "".join(capsys.readouterr())
        assert "\x1b" not in shown
        assert "\\u001b[" in shown or "\\x1b[" in shown  # the latter in quotes
    for file in folder.rglob("*"):
        assert file.suffix not in (".csv", ".html", ".json", ".md", ".tex") or b"\x1b" not in file.read_bytes()


def test_no_row_of_margins_is_a_failure(fbl_gym):
    assert "no margins of zero: at[0] must be a finite number, got nan" in fbl_gym("margins zero --at nan nan", 1).out


@pytest.mark.parametrize("line", ["{} >&- 2>&- <&-", "{} >&-", "NUMBA_DISABLE_JIT=1 {}"])
def test_no_state_of_the_shell_is_a_traceback(line):
    command = line.format(f"{sys.executable} -m fbl_gym list suites")
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert ("NUMBA_DISABLE_JIT must be unset" in done.stderr) == ("JIT" in line)
    assert (done.returncode, "Traceback" in done.stderr) == (2 * ("JIT" in line), False)


# `fbl-gym show` and `list`: numbers of a scenario and what follows from them; options, from their declarations.


def test_each_option_is_shown_with_its_unit():
    events = [{"kind": "knock", "time": 1.0, "impulse": (3, 1)}]
    friction = {"viscous": (1.0, 0.5), "coulomb": {"uniform": [1, 2]}}
    task = Scenario(friction=friction, actuator={"delay_samples": {"choice": [0, 2]}}, events=events)
    shown = dict(options(task))
    assert shown.items() >= {
        "friction.viscous [N m s/rad]": "1; 0.5", "friction.coulomb [N m]": "1 to 2, uniform",
        "actuator.delay_samples": "one of 0, 2", "events[0]: knock, impulse [N m s]": "3; 1",
    }.items()  # fmt: skip
    assert not any(name.startswith(("joint", "noise")) for name in shown)


def test_what_follows_is_right():
    """Against closed forms: weight of two point masses, dead time by addition, modes with one link alone."""
    facts = follows(Scenario())
    weight = f"{9.81 * (35 * 0.7 + 15 * 0.5):.3g}, {9.81 * 15 * 0.5:.3g} N m"
    assert facts["weight (largest torque of gravity)"] == weight
    assert facts["dead time"] == "5 ms"
    drive, encoder = {"delay_samples": 1, "delay": 0.002, "lag": 0.004}, {"difference": 1, "latency": 1}
    late = Scenario(actuator=drive, encoder=encoder)
    names = ("dead time", "delay of a command: delay, delay_samples, jitter")
    assert [follows(late)[name] for name in names] == ["36 ms", "12 ms"]
    flat = Scenario(arm={"gravity": 0.0}, friction={"coulomb": {"uniform": (1, 20)}})
    assert follows(flat)["largest Coulomb friction"] == "1, 2.5 % of the limit"
    assert "torque limit / weight" not in follows(flat)
    half = follows(Scenario(actuator={"torque_limit": (2000.0, 0.0)}))
    assert half["largest torque of the nominal motion"].endswith(", no drive % of the limit")
    stiff = {"stiffness": (1e9, 4e4), "rotor_inertia": 1.0}
    stiff = follows(Scenario(joint=stiff, physics_dt=1e-6, duration=0.01))
    rate = np.sqrt(4e4 / 3.75) / (2 * np.pi)
    assert float(stiff["modes of the stretched links, motors held"].split(",")[0]) == pytest.approx(rate, rel=0.01)
    spring = {"frequency": (15.0, rate), "rotor_inertia": 1.0}
    for facts in (stiff, follows(Scenario(joint=spring, physics_dt=1e-4))):
        assert facts["stiffness of the joints"].endswith(", 4e+04 N m/rad")
        assert facts["frequency of each stretched joint alone, motor held"].endswith(f", {rate:.3g} Hz")
    bent = Scenario(link={"frequency": (8.0, 300.0)}, physics_dt=1e-5, duration=0.01)
    assert float(follows(bent)["modes of the links, joints held"].split(",")[0]) == pytest.approx(8.0, rel=0.01)
    assert "links that bend" in follows(bent)["most like"]


def test_two_scenarios_show_their_differences(fbl_gym):
    text = fbl_gym(["show", "servo-nominal", "servo-delay-2"]).out
    assert "actuator.delay" in text
    assert "friction" not in text.split("what follows")[0]
    assert "modes of the stretched" in fbl_gym(["show", "geared-nominal"]).out
    fbl_gym("show", 2)


def test_mistakes_of_units_are_named(tmp_path, fbl_gym):
    """Masses in grams, and stiffness in kN m/rad."""
    arm = "[arm]\nmass = [40, 25]\nlength = [0.1, 0.1]\ncentre = [0.05, 0.05]\ninertia = [1e-2, 1e-2]\nrotor = 0.1\n"
    arm = f'base = "servo-nominal"\nactuator.torque_limit = 0.1\n{arm}[joint]\nstiffness = 0.5\ndamping = 0.0\n'
    (tmp_path / "arm.toml").write_text(arm)
    shown = fbl_gym(["show", str(tmp_path / "arm.toml")]).err
    assert all(doubt in shown for doubt in ("of actuator.torque_limit, which is in N m", "stiffness is in N m/rad"))


DOCS = Path(__file__).parents[2] / "docs"


def test_an_option_is_listed_with_valid_values_unit_default_and_meaning(fbl_gym):
    lines = fbl_gym("list options").out.splitlines()
    texts = {name: text.strip() for name, _, text in (line.partition("  ") for line in lines)}
    form = "one or two numbers or distributions not below 0 [N m]"
    assert texts["friction.coulomb"] == form + "; default 0; Coulomb friction, f_i2."
    mass = "a number or distribution not below 0 [kg]; required; mass of the payload."
    assert texts["parameter_error.payload.mass"] == mass
    sine = "one or two numbers not below -1e+06 and not above 1e+06, or None [rad]; default None; phase"
    assert texts["disturbance[sine].phase"].startswith(sine)
    assert texts["reward.tracking"].startswith('"log" or "l1"; default log;')


def test_the_page_of_options_is_current():
    before = (DOCS / "reference" / "options.md").read_text(encoding="utf-8")
    assert before == runpy.run_path(str(DOCS / "conf.py"))["options_page"](), "run `make docs`"
