"""What is written is true: code and commands run, links lead somewhere, and every public parameter is documented."""

import dataclasses
import importlib
import inspect
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import controllers
import fbl_gym
from benchmarks import cli
from benchmarks.run.suite import load

ROOT = Path(__file__).parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
}
"""Every page by its path."""


def blocks(page, language):
    """The fenced blocks of a language in a page."""
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], flags=re.S)


def pages_with(language):
    return [page for page in PAGES if blocks(page, language)]


def named_files():
    """The blocks that begin with the name of the file they belong into."""
    return {
        name: block
        for page in PAGES
        for block in re.findall(r"```\w+\n(.*?)```", PAGES[page], flags=re.S)
        for name in re.findall(r"\A# (\S+)\n", block)
    }


# Code and commands.


@pytest.mark.parametrize(
    ("page", "block"),
    [(page, block) for page in PAGES if page != "docs/rl.md" for block in blocks(page, "python")],
    ids=lambda text: text.partition("\n")[0],
)
def test_python_of_a_page_runs(page, block, tmp_path):
    """docs/rl.md is run by tests/benchmarks/rl."""
    if "stable_baselines3" in block:
        pytest.importorskip("stable_baselines3")
    done = subprocess.run([sys.executable, "-c", block], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, f"{page}\n{done.stderr}"


def parser_of(command):
    if command == "train":
        pytest.importorskip("torch")
    return cli.prepare(command)[0]


def commands(page):
    """The `fbl-gym` commands of a page's shell blocks."""
    lines = [line for block in blocks(page, "sh") for line in block.splitlines() if line.startswith("fbl-gym")]
    return [shlex.split(line, comments=True)[1:] for line in lines]


SHORT = {
    "leaderboard": ["--seeds", "1", "--scenarios", "mass-error-2", "--policies", "zero", "cascade-flm", "oracle-flm"],
    "report": ["--seeds", "1", "--scenarios", "mass-error-2", "--policies", "zero", "cascade-flm", "oracle-flm"],
    "speed": ["--rounds", "1"],
    "evaluate": ["--seeds", "2"],
    "compare": ["--seeds", "2"],
}
"""What makes a command short, where that changes nothing but how much is run."""

ELSEWHERE = ("reproduce", "train", "tune")
"""Run in short form by the tests of their own."""


@pytest.mark.parametrize("page", [page for page in pages_with("sh") if commands(page)])
def test_commands_of_a_page_run(page, tmp_path, monkeypatch):
    """In a page's order and in one folder, each as written but short; those of minutes are only parsed."""
    monkeypatch.chdir(tmp_path)
    Path("my_law.py").write_text(named_files()["my_law.py"])
    for command in commands(page):
        parser_of(command[0]).parse_args(command[1:])
        if command[0] not in ELSEWHERE and "--radius" not in command:
            assert cli.main([*command, *SHORT.get(command[0], [])]) == 0, command


def test_a_suite_of_ones_own_is_read(tmp_path, monkeypatch):
    """The page's file, with the law of docs/tutorials.md beside it."""
    monkeypatch.chdir(tmp_path)
    for name, text in named_files().items():
        Path(name).write_text(text)
    suite = load("mine.toml")
    assert suite.policies[-1] == "my_law.py"
    assert {"noise-1@500Hz", "heavy@500Hz"} <= {scenario.name for scenario in suite.scenarios}


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_the_text_exist(page):
    """With all their options."""
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
    """The anchors of a page's headings, as GitHub and MyST make them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", PAGES[page], flags=re.S), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_of_a_page_lead_somewhere(page):
    """Those within the repository: to a file, and to a heading of it."""
    text = re.sub(r"```.*?```|`[^`\n]*`", "", PAGES[page], flags=re.S)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http:", "https:")):
            continue
        path, _, anchor = link.partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), f"{link} in {page}"
        if anchor:
            assert anchor in anchors(str(target.resolve().relative_to(ROOT))), f"{link} in {page}"


def test_the_documentation_builds_without_a_warning(tmp_path):
    """With no link to what is not there, and with what mathematics needs to be shown offline."""
    pytest.importorskip("sphinx")
    command = ["sphinx", "-q", "-E", "-W", "--keep-going", "-d", str(tmp_path / "trees"), str(ROOT / "docs")]
    built = tmp_path / "html"
    done = subprocess.run([sys.executable, "-m", *command, str(built)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (built / "controllers" / "adrc.html").read_text()
    assert not re.findall(r"(?:src|href)=\"(?:https?:)?//[^\"]*\.(?:js|css)", page)
    (mathjax,) = re.findall(r"src=\"([^\"?]*mathjax[^\"?]*)", page, flags=re.I)
    assert (built / "controllers" / mathjax).exists()


# Parameters.

_NAMES = r"(?:[`*]*\w+`?, )*[`*]*\w+`?"
ENTRY = re.compile(rf"(?:^\W*|[.;,:] +)({_NAMES}(?:,\n? *{_NAMES})*):\s", flags=re.M)
"""What documents parameters: `name, name: text`, in a list of arguments or behind a sentence."""


def documented(*texts):
    """The names that the texts have an entry for."""
    return {name for text in texts for entry in ENTRY.findall(text or "") for name in re.findall(r"\w+", entry)}


def parameters(thing):
    """The names of a callable's parameters."""
    return [name for name in inspect.signature(thing).parameters if name not in ("self", "cls", "args", "kwargs")]


def undocumented(path, thing, methods=True):
    """Every parameter of a function, or of a class and its public methods, that no entry of its docstring names.

    Fields may be documented by a base, and what a method shares with the one that it overrides is documented there.
    """
    known = documented(inspect.getdoc(thing))
    if not inspect.isclass(thing):
        return [f"{path}({name})" for name in parameters(thing) if name not in known]
    bases = inspect.getmro(thing)[1:]
    found = []
    if dataclasses.is_dataclass(thing) or "__init__" in vars(thing):
        known = known.union(*(documented(inspect.getdoc(base)) for base in bases))
        found += [f"{path}({name})" for name in parameters(thing) if name not in known]
    for name, member in vars(thing).items() if methods else ():
        function = getattr(member, "__func__", member)
        if inspect.isfunction(function) and not name.startswith("_"):
            known = documented(function.__doc__)
            known = known.union(*(parameters(vars(base)[name]) for base in bases if name in vars(base)))
            found += [f"{path}.{name}({p})" for p in parameters(function) if p not in known]
    return found


def public():
    """All that is public, by its path: what the documentation lists, and the packages' `__all__`."""
    found = {}
    listed = re.findall(r"^\.\. auto(module|class):: (\S+)\n((?:   :.*\n)*)", "".join(PAGES.values()), flags=re.M)
    for kind, path, options in listed:
        module, _, name = path.rpartition(".") if kind == "class" else (path, "", "")
        chosen = re.search(r":members: (\S.*)", options)
        names = [name] if name else chosen[1].split(", ") if chosen else vars(importlib.import_module(module))
        for name in [] if ":no-members:" in options else names:
            thing = getattr(importlib.import_module(module), name)
            if not name.startswith("_") and callable(thing) and (kind == "class" or thing.__module__ == module):
                found[f"{thing.__module__}.{name}"] = thing
    for package in (fbl_gym, controllers):
        found |= {f"{t.__module__}.{n}": t for n in package.__all__ if callable(t := getattr(package, n))}
    return found


PUBLIC = public()


@pytest.mark.parametrize("path", PUBLIC)
def test_every_public_parameter_is_documented(path):
    assert undocumented(path, PUBLIC[path]) == []


@pytest.mark.parametrize("name", [name for name in controllers.names() if controllers.kind(name) == "classical"])
def test_every_gain_of_a_law_is_documented(name):
    assert undocumented(name, controllers.factory(name), methods=False) == []


def test_an_undocumented_parameter_is_noticed():
    """In a function, a field, a constructor and a method; in a list of arguments and behind a sentence."""

    def half(a, b, c, d):
        """Words that name c and `d`.  a, b: [n x 2] rad."""

    @dataclasses.dataclass
    class Fields:
        """Words.

        Args:
            gain: [1/s].
            low, high: [rad].
        """

        gain: float
        low: float
        high: float
        lost: float = 1.0

        def move(self, far, wide):
            """Words.

            Args:
                far: [m].
            """

    class Heir(Fields):
        def move(self, far, wide, deep):
            """Words."""

    assert undocumented("half", half) == ["half(c)", "half(d)"]
    assert undocumented("F", Fields) == ["F(lost)", "F.move(wide)"]
    assert undocumented("H", Heir) == ["H(lost)", "H.move(deep)"]


def test_the_documentation_lists_what_is_public():
    """Enough of it that the test above means something."""
    assert len(PUBLIC) > 130
    assert {"fbl_gym.env.TwoLinkArmEnv", "fbl_gym.batch.Truth", "benchmarks.analysis.statistics.iqm"} <= set(PUBLIC)
