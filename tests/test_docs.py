"""The documentation is true: its code and commands run, and its links lead somewhere.

Ruff's rule D417 checks that every parameter of a public function is documented. The fields of records
and laws are checked here.
"""

import dataclasses
import inspect
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

import controllers
import fbl_gym
from benchmarks import cli
from benchmarks.run.suite import load
from controllers import catalogue

ROOT = Path(__file__).parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
}
"""Text of every page by its path."""


def blocks(page, language):
    """Return the fenced blocks of a language in a page."""
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], flags=re.S)


def pages_with(language):
    return [page for page in PAGES if blocks(page, language)]


def named_files():
    """Return the blocks that begin with a comment with their file's name."""
    return {
        name: block
        for page in PAGES
        for block in re.findall(r"```\w+\n(.*?)```", PAGES[page], flags=re.S)
        for name in re.findall(r"\A# (\S+)\n", block)
    }


SHORTER = {
    "learn(150_000)": "learn(64)",
    "learn(300_000": "learn(64",
    'device="cpu")': 'device="cpu", n_steps=64)',
    "range(400)": "range(4)",
    "range(32)": "range(4)",
    "replace(duration=3.0)": "replace(duration=0.5)",
    "range(task.steps)": "range(500)",
    "range(10, 14)": "range(1)",
    "range(12000, 12006)": "range(1)",
    '"computed-torque-dob", "sliding-mode", "lqg"': "",
}
"""What makes the Python of a page short."""


def shortened(text):
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    return text


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with the files of the pages."""
    monkeypatch.chdir(tmp_path)
    for name, text in named_files().items():
        Path(name).write_text(shortened(text))
    return tmp_path


LEARNING = ("docs/how-to/train.md", "docs/how-to/offline-learning.md", "docs/results/agents.md")
"""Pages whose Python tests/benchmarks/rl runs."""


@pytest.mark.parametrize(
    ("page", "block"),
    [
        (page, block)
        for page in PAGES
        if page not in LEARNING
        for block in blocks(page, "python")
        if "sys.argv" not in block  # a script, which the commands of its page run
    ],
    ids=lambda text: text.partition("\n")[0],
)
@pytest.mark.usefixtures("folder")
def test_python_of_a_page_runs(page, block):
    """All pages but those on learning; without a warning."""
    if "stable_baselines3" in block:
        pytest.importorskip("stable_baselines3")
    names = {"__name__": "__main__", "__file__": str(Path("page.py").resolve())}
    exec(compile(shortened(block), page, "exec"), names)


def parser_of(command):
    return cli.prepare(command)[0]


def commands(page):
    """Return the commands of a page's shell blocks, `fbl-gym COMMAND ...` and `python FILE.py ...`, from the second word."""
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    lines = [line for line in lines if re.match(r"fbl-gym|python \w+\.py", line)]
    return [shlex.split(line, comments=True)[1:] for line in lines]


FEW = ["--seeds", "1", "--scenarios", "servo-model-error-2", "--policies", "zero", "cascade-flm", "oracle-flm"]
SHORT = {
    "leaderboard": FEW,
    "report": FEW,
    "evaluate": ["--seeds", "2"],
    "sweep": ["--seeds", "1", "--workers", "1"],
    "tune": ["--trials", "2", "--seeds", "1", "--fresh-seeds", "1", "--candidates", "1", "--workers", "1"],
    "record": ["--episodes", "2"],
    "recommend": ["--seeds", "2", "--minutes", "0", "--policies", "pd-gravity", "computed-torque", "--workers", "1"],
}
"""Arguments that make a command short."""

ELSEWHERE = ("reproduce", "train", "curves")
"""Commands that other tests run."""


LONG_PAGES = (
    "docs/start/a-day-with-a-robot.md", "docs/start/your-robot.md", "docs/how-to/identify.md", "docs/results/mujoco.md",
    "docs/start/examples.md",
)  # fmt: skip


def marked(page):
    """Return a page as a parameter of a test, slow if its commands take long."""
    return pytest.param(page, marks=[pytest.mark.slow] if page in LONG_PAGES else [])


@pytest.mark.parametrize("page", [marked(page) for page in pages_with("sh") if commands(page)])
def test_commands_of_a_page_run(page, folder, monkeypatch):
    """In the page's order and in one folder, each with arguments that make it short; long ones are only parsed."""
    monkeypatch.syspath_prepend(folder)  # scripts import each other
    for archive in {word for command in commands(page) for word in command if word.endswith(".zip")}:
        sb3 = pytest.importorskip("stable_baselines3")
        sb3.PPO("MlpPolicy", gym.make("fbl_gym/TwoLinkArmTracking-v0"), device="cpu").save(archive)
    for command in commands(page):
        if command[0].endswith(".py"):
            monkeypatch.setattr(sys, "argv", command)
            runpy.run_path(command[0], run_name="__main__")
            continue
        parser_of(command[0]).parse_args(command[1:])
        if command[0] not in ELSEWHERE:
            short = SHORT.get(command[0], [])
            if "--trials" in command and command[0] == "evaluate":
                short = ["--seeds", "2", "--trials", "2"]
            if "--world" in command:
                short = ["--seeds", "4", "--scenarios", "servo-nominal"]
            if "--trace" in command:  # a log has one run
                short = ["--seeds", "1"]
            if "my_paper.toml" in command:
                short = ["--seeds", "1", *(["--workers", "1"] if command[0] == "leaderboard" else [])]
            assert cli.main([*command, *short]) == 0, command


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path):
    """In an empty folder, from its first cell to its last."""
    pytest.importorskip("nbclient")
    if path.stem == "agent":
        pytest.importorskip("stable_baselines3")
    runpy.run_path(path.with_name("execute.py"))["execute"](path, tmp_path)


@pytest.mark.usefixtures("folder")
def test_the_suite_of_the_documentation_is_read():
    """The file of docs/how-to/own-suite.md, with the law of docs/start/your-robot.md beside it."""
    suite = load("mine.toml").build()
    assert suite.cells[-1].policy.name == "my_law.py"
    assert {"noise-1", "heavy"} <= {scenario.name for scenario in suite.scenarios}


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_the_text_exist(page):
    """Each command in the text has the options that stand there."""
    for text in re.findall(r"`fbl-gym ([^`]+)`", PAGES[page]):
        command = text.split()
        known = parser_of(command[0]).format_help()
        for option in command[1:]:
            assert not option.startswith("--") or option in known, f"fbl-gym {text}"


def test_the_torch_that_is_named_is_the_one_that_is_pinned():
    (pinned,) = re.findall(r"^torch(==\S+)$", (ROOT / "constraints.txt").read_text(), flags=re.M)
    assert {named for page in PAGES for named in re.findall(r"torch(==\S+)", PAGES[page])} == {pinned}


# Links.


def anchors(page):
    """Return the anchors of a page's headings, as GitHub and MyST make them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", PAGES[page], flags=re.S), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_of_a_page_lead_somewhere(page):
    """Links within the repository lead to a file, and to a heading of it."""
    text = re.sub(r"```.*?```|`[^`\n]*`", "", PAGES[page], flags=re.S)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http:", "https:")):
            continue
        path, _, anchor = link.partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), f"{link} in {page}"
        if anchor:
            assert anchor in anchors(str(target.resolve().relative_to(ROOT))), f"{link} in {page}"


@pytest.mark.slow
def test_the_documentation_builds_without_a_warning(tmp_path):
    """Every link has a target, and mathematics is shown without a network."""
    pytest.importorskip("sphinx")
    command = ["sphinx", "-q", "-E", "-W", "--keep-going", "-d", str(tmp_path / "trees"), str(ROOT / "docs")]
    built = tmp_path / "html"
    done = subprocess.run([sys.executable, "-m", *command, str(built)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (built / "reference" / "controllers" / "computed-torque-eso.html").read_text()
    assert not re.findall(r"(?:src|href)=\"(?:https?:)?//[^\"]*\.(?:js|css)", page)
    (mathjax,) = re.findall(r"src=\"([^\"?]*mathjax[^\"?]*)", page, flags=re.I)
    assert (built / "reference" / "controllers" / mathjax).exists()


# Fields.


RECORDS = [
    thing
    for name in fbl_gym.__all__
    if isinstance(thing := getattr(fbl_gym, name), type) and dataclasses.is_dataclass(thing)
]


def test_every_law_is_named_on_a_page():
    pages = " ".join(path.read_text() for path in (ROOT / "docs/reference/controllers").glob("*.md"))
    words = set(re.findall(r"[\w-]+", pages))
    assert {name for name, *_ in catalogue.LAWS} - words <= {"zero"}


LAWS = [controllers.factory(name) for name in controllers.names() if controllers.kind(name) == "classical"]


@pytest.mark.parametrize("record", [*RECORDS, *LAWS], ids=lambda record: record.__name__)
def test_every_option_of_a_record_and_gain_of_a_law_is_documented(record):
    text = "\n".join(inspect.getdoc(base) or "" for base in record.__mro__[:-1])
    for field in dataclasses.fields(record):
        assert re.search(rf"^ *(\w+, )*{field.name}(, \w+)*:", text, flags=re.M), field.name
