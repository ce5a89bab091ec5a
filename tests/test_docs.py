"""The documentation is true: its code, commands and examples run, and its links lead somewhere.

A page runs from top to bottom in one folder, which has the files of the pages that it links to. Each Python
block has a namespace of its own, and Bash expands each shell block. A block that no test can run says so in
the line above it, `<!-- not run: REASON -->`; what it imports and which options it takes is checked all the same.

Ruff's rule D417 checks that every parameter of a public function is documented. The fields of records
and laws are checked here.
"""

import ast
import dataclasses
import importlib
import inspect
import itertools
import json
import os
import re
import runpy
import subprocess
import sys
import tomllib
from glob import glob
from importlib.util import find_spec
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

import controllers
import fbl_gym
from benchmarks import cli
from benchmarks.run.suite import load
from controllers.registry import CATALOGUE
from fbl_gym import scenarios
from fbl_gym.records.record import declarations

ROOT = Path(__file__).parents[1]
FILES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
#: Text of every page by its path.
PAGES = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in FILES}

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
PYPROJECT, MAKEFILE = ((ROOT / name).read_text(encoding="utf-8") for name in ("pyproject.toml", "Makefile"))


@dataclasses.dataclass(frozen=True)
class Block:
    """A fenced block of a page, or a cell of a notebook; `reason` says why no test runs it."""

    page: str
    line: int
    language: str
    text: str
    reason: str = ""

    @property
    def file(self):
        """The file that the block is, named by a comment in its first line."""
        return "".join(re.findall(r"\A(?:#|<!--) (\S+\.\w+)(?: -->)?\n", self.text))

    def __str__(self):
        return f"{self.page}:{self.line}"


FENCE = re.compile(r"^(?:<!-- not run: (.+) -->\n)?```(\S*).*\n((?:.*\n)*?)```$", flags=re.M)


def block(page, text, match):
    return Block(page, text.count("\n", 0, match.start(3)), match[2], match[3], match[1] or "")


BLOCKS = {page: [block(page, text, match) for match in FENCE.finditer(text)] for page, text in PAGES.items()}


def cells(path):
    """Yield the cells of a notebook that have code."""
    for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        magic, text = re.fullmatch(r"(%.*\n)?([\s\S]*)", "".join(cell["source"])).groups()
        if cell["cell_type"] == "code" and ".toml" not in (magic or ""):
            yield Block(path.name, number, "sh" if magic == "%%sh\n" else "python", text)


EVERY = [block for page in PAGES for block in BLOCKS[page]] + [cell for path in NOTEBOOKS for cell in cells(path)]
PYTHON = [block for block in EVERY if block.language == "python"]
SHELL = [block for block in EVERY if block.language in ("sh", "bash")]


@pytest.mark.parametrize("page", PAGES)
def test_code_is_in_a_block_that_says_what_it_is(page):
    """So that no code hides from the tests below: as plain text, in an indented block, or under a new name."""
    assert len(re.findall(r"^[ >\t]*(?:```|~~~)", PAGES[page], flags=re.M)) == 2 * len(BLOCKS[page])
    reasons = [block.reason for block in BLOCKS[page] if block.reason]
    assert len(re.findall("^<!-- not run", PAGES[page], flags=re.M)) == len(reasons)
    for block in BLOCKS[page]:
        assert re.fullmatch(r"python|sh|bash|toml|text|csv|xml|bibtex|markdown|\{.*", block.language), block
        if block.language == "toml":
            tomllib.loads(block.text)
        if block.language == "text":
            assert not re.search(r"^\s*(?:fbl-gym|python|pip|make|import|from) |\w\(", block.text, flags=re.M), block


@pytest.mark.parametrize("block", PYTHON, ids=str)
@pytest.mark.usefixtures("folder")
def test_what_python_imports_exists(block):
    """Each module can be imported, and has what the block takes from it; nothing else of the block runs."""
    for other in BLOCKS.get(block.page, ()):
        if other.file:
            Path(other.file).write_text(other.text)
    names, nodes = {}, [*ast.walk(ast.parse(block.text))]
    for node in nodes:
        if isinstance(node, ast.Import | ast.ImportFrom):
            try:
                exec(ast.unparse(node), names)
            except ModuleNotFoundError as missing:  # an extra is not installed
                if not block.reason and f'"{missing.name.replace("_", "-")}>=' not in PYPROJECT:
                    raise
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = names.get(node.value.id)
            assert not inspect.ismodule(module) or hasattr(module, node.attr), ast.unparse(node)


#: Bash prints the words of each command in place of running it.
EXPAND = 'exec 3>&1; command_not_found_handle() { printf "%s\\0" "$@" "" >&3; }; PATH=/none; set -f\n'


def commands(text):
    """Return the words of each command of a shell block."""
    text = re.sub(r"^\S+/", "", text, flags=re.M)  # of a command that is given by its path
    done = subprocess.run(["bash", "-c", EXPAND + text], capture_output=True, text=True)
    assert (done.returncode, done.stderr, "||" in text) == (0, "", False)  # what follows || would not be seen
    return [command.split("\0") for command in done.stdout.split("\0\0")[:-1]]


@pytest.mark.parametrize("block", SHELL, ids=str)
def test_commands_exist(block):
    """Each command, with its options, and the files of the repository that it names."""
    for program, first, *words in commands(block.text):
        if program == "fbl-gym":
            cli.prepare(first)[0].parse_args(words)
        elif program == "make":
            assert re.search(rf"^{first}:", MAKEFILE, flags=re.M), first
        elif program == "pip":
            for extra in re.findall(r"\[(.+)\]", " ".join(words)):
                assert re.search(rf"^{extra} = ", PYPROJECT, flags=re.M), extra
        elif program == "python" and first == "-m":
            assert find_spec(words[0].partition(".")[0]) is None or find_spec(words[0]), words[0]
        elif program == "python" and first.startswith("examples/"):
            assert (ROOT / first).exists(), first
        elif block.page in PAGES:
            assert block.reason or first in {other.file for other in BLOCKS[block.page]}, program
        for word in words:
            assert not re.match(r"(benchmarks|docs|tests)/", word) or (ROOT / word).exists(), word


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_the_text_exist(page):
    """Each command in the text has the options that stand there."""
    for text in re.findall(r"`fbl-gym ([^`]+)`", PAGES[page]):
        command = text.split()
        known = cli.prepare(command[0])[0].format_help()
        for option in command[1:]:
            assert not option.startswith("--") or option in known, f"fbl-gym {text}"
    for module in re.findall(r"`(?:\w+=\S* )*python\s-m\s([\w.]+)", PAGES[page]):
        assert find_spec(module), module


#: What makes code and commands of pages and examples short; arguments of examples, and what they
#: print; programs of pages, and the numbers that they print.
TABLES = (ROOT / "tests/shorter.toml").read_text(encoding="utf-8")
SHORTER, SHORT, ARGUMENTS, PRINTED, NUMBERS = tomllib.loads(TABLES).values()


def shortened(text):
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    return text


def run(program, first, *words):
    """Run a command of a page in this process, with arguments that make it short."""
    module = program == "python" and first == "-m"
    name, words = (words[0], words[1:]) if module else (first, words)
    words = [match for word in words for match in sorted(glob(word)) or [word]]
    # Two scenarios of a board, and two policies of a table.
    words = re.sub(r"(--scenarios(?: (?!--)\S+){1,2})(?: (?!--)\S+)*", r"\1", " ".join(words)).split()
    own_suite = "--suite" in words and any(word.endswith(".toml") for word in words)
    for option, *values in map(str.split, re.findall(r"--.*?(?= --|$)", SHORT.get(name, ""))):
        if option not in ("--policies", "--scenarios") or not (own_suite or option in words):
            words += [option, *values]
    for option, seeds in (("--trace", "1"), ("--world", "4")):  # one run of a log, and two halves of the seeds
        words += ["--seeds", seeds] if option in words else []
    if name == "evaluate" and "--scenario" in words and "--trace" not in words:  # episodes of two seconds
        place = words.index("--scenario") + 1
        Path("short.toml").write_text(f"base = {json.dumps(words[place])}\nduration = 2.0\n")
        words[place] = "short.toml"
    if program == "fbl-gym":
        assert cli.main([name, *words]) == 0, (name, words)
        return
    with mock.patch.object(sys, "argv", [name, *words]):
        if module:
            package = find_spec(name).submodule_search_locations
            assert not importlib.import_module(f"{name}.__main__" if package else name).main()
            return
        if name.startswith("examples/"):
            name = Path(name).name
            Path(name).write_text(shortened((ROOT / "examples" / name).read_text()))
        runpy.run_path(name, run_name="__main__")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, from which Python imports, with hyperparameters of a short training."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    each = {name: {"learning_starts": 20, "buffer_size": 300} for name in ("sac", "td3", "tqc", "crossq")}
    each |= {"ppo": {"n_steps": 10, "batch_size": 40, "horizon": 0.5}, "sb3-ppo": {"n_steps": 10, "batch_size": 20}}
    short = {name: {"lanes": 4, "steps": 40, "arguments": {"learning_rate": 1e-3} | each[name]} for name in each}
    Path("short.json").write_text(json.dumps(short))
    yield tmp_path
    for name, module in [*sys.modules.items()]:
        if (getattr(module, "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]


#: Pages that take more than some ten seconds. `make test` runs them where pages or names changed.
SLOW = (
    "how-to/identify", "how-to/offline-learning", "how-to/recommend", "how-to/tune", "reference/classes",
    "reference/controllers/oracles", "reference/tracking", "results/performance", "start/examples", "start/your-robot",
)  # fmt: skip

#: Pages that take minutes. `make test-long` runs them.
SLOWEST = ("how-to/rl-tracks", "results/agents", "results/mujoco", "start/a-day-with-a-robot")

RUN = [page for page in PAGES if any(not b.reason and (b.file or b in PYTHON + SHELL) for b in BLOCKS[page])]


def marked(page):
    """Return a page as a parameter of a test, with its marks."""
    slow, slowest = page[5:-3] in SLOW, page[5:-3] in SLOWEST
    return pytest.param(page, marks=[pytest.mark.slow] * (slow or slowest) + [pytest.mark.page] * slow)


@pytest.mark.parametrize("page", [marked(page) for page in RUN])
@pytest.mark.usefixtures("folder")
@pytest.mark.filterwarnings("ignore::fbl_gym.model.urdf.RobotFileWarning")
def test_a_page_runs(page):
    """From top to bottom, without a warning but what was read from a robot's file."""
    links = {os.path.normpath(Path(page).parent / link) for link in re.findall(r"\]\(([^)#\s]+\.md)", PAGES[page])}
    for block in EVERY:
        if block.file and block.page in links - {page}:
            Path(block.file).write_text(shortened(block.text))
    todo = [block for block in BLOCKS[page] if not block.reason]
    started = {first for block in todo if block in SHELL for _, first, *_ in commands(block.text)}
    texts = [block.text for block in todo]
    texts += [(ROOT / name).read_text() for text in texts for name in re.findall(r"examples/\w+\.py", text)]
    for root in ("stable_baselines3", "sb3_contrib", "torch"):
        if any(f"import {root}" in text or f"from {root}" in text for text in texts):
            pytest.importorskip(root)
    if "offline.py" in PAGES[page]:  # what d3rlpy would train
        np.savez("weights.npz", *map(np.zeros, ((64, 56), (64,), (64, 64), (64,), (2, 64), (2,))))
    for block in todo:
        text = shortened(block.text)
        if block.file:
            Path(block.file).write_text(text)
        if block.language == "toml" and block.file:
            load(block.file, trust=True).build() if "policies" in text else scenarios.get(block.file)
        elif block in SHELL:
            for command in commands(text):
                run(*command)
        elif block in PYTHON and block.file not in started:
            names = {"__name__": "__main__", "__file__": str(Path(block.file or "page.py").resolve())}
            with mock.patch.dict(os.environ):
                exec(compile(text, str(block), "exec"), names)


@pytest.mark.slow
@pytest.mark.parametrize("page", NUMBERS)
@pytest.mark.usefixtures("folder")
def test_a_page_has_the_numbers_that_its_code_prints(page, capsys):
    """In full length, not short; the page may round them."""
    command, pattern = NUMBERS[page]
    if command:
        with mock.patch.object(sys, "argv", command.split()):
            runpy.run_path(str(ROOT / sys.argv[0]), run_name="__main__")
    else:
        exec(next(block.text for block in BLOCKS[page] if block in PYTHON), {})
    stated = [text.replace(",", "") for text in re.findall(r"\d[\d,]*\d(?:\.\d+)?|\d\.\d+", PAGES[page])]
    printed = [number for match in re.finditer(pattern, capsys.readouterr().out) for number in match.groups()]
    half = {text: 0.501 * 0.1 ** len(text.partition(".")[2]) for text in stated}  # of the last digit
    wrong = [x for x in printed if not any(abs(float(x) - float(text)) <= half[text] for text in stated)]
    assert (printed != [], wrong) == (True, [])


EXAMPLES = {path.stem: path.read_text() for path in sorted((ROOT / "examples").glob("*.py"))}
#: Examples that pages run, and `controllers/test_runner.py`; those with arguments run here too.
BY_PAGES = re.findall(r"^python examples/(\w+)\.py", "\n".join(b.text for b in SHELL if not b.reason), flags=re.M)
ELSEWHERE = {*BY_PAGES, "run_on_robot"} - {*ARGUMENTS}


@pytest.mark.parametrize("name", [name for name in EXAMPLES if name not in ELSEWHERE])
@pytest.mark.usefixtures("folder")
def test_an_example_runs(name, capsys):
    if "import torch" in EXAMPLES[name]:
        pytest.importorskip("torch")
    run("python", f"examples/{name}.py", *ARGUMENTS.get(name, "").split())
    assert re.search(PRINTED.get(name, "."), capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.page
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path):
    """In an empty folder, from its first cell to its last."""
    pytest.importorskip("nbclient")
    if path.stem == "agent":
        pytest.importorskip("stable_baselines3")
    runpy.run_path(path.with_name("execute.py"))["execute"](path, tmp_path)


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
    for path, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)#?([^)\s]*)\)", text):
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), path
        assert not anchor or anchor in anchors(str(target.resolve().relative_to(ROOT))), anchor


def test_each_path_of_the_index_is_a_chain_of_pages():
    """Four pages for each reader, of which each leads to the next one."""
    for path in re.findall(r"^- \*\*I .*(?:\n  .*)*", PAGES["docs/index.md"], flags=re.M):
        pages = re.findall(r"\]\((.+?)\)", path)
        assert len(pages) == 4
        for page, following in itertools.pairwise(pages):
            link = Path(os.path.relpath(following, Path(page).parent)).as_posix()
            assert f"]({link})" in PAGES[f"docs/{page}"].rpartition("**Next**")[2], page


@pytest.mark.slow
@pytest.mark.page
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


PUBLIC = [getattr(fbl_gym, name) for name in fbl_gym.__all__]
RECORDS = [thing for thing in PUBLIC if isinstance(thing, type) and dataclasses.is_dataclass(thing)]


def test_every_law_is_named_on_a_page():
    pages = " ".join(text for page, text in PAGES.items() if page.startswith("docs/reference/controllers/"))
    assert {*CATALOGUE}.difference(re.findall(r"[\w-]+", pages)) <= {"zero"}


LAWS = [controllers.factory(name) for name in controllers.names() if controllers.kind(name) == "classical"]


@pytest.mark.parametrize("record", [*RECORDS, *LAWS], ids=lambda record: record.__name__)
def test_every_option_of_a_record_and_gain_of_a_law_is_documented(record):
    text = "\n".join(inspect.getdoc(base) or "" for base in record.__mro__[:-1])
    for field in dataclasses.fields(record):
        assert re.search(rf"^ *(\w+, )*{field.name}(, \w+)*:", text, flags=re.M), field.name
    for gain, declaration in declarations(record).items() if record in LAWS else ():
        assert declaration.unit == "" or f"[{declaration.unit}]" in text, gain
