"""The package as a stranger meets it: a wheel outside the checkout, light imports. (What it says: test_docs.py.)"""

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMMAND = "import sys; sys.argv = ['fbl-gym', '--version']; sys.orig_argv = []; import fbl_gym.__main__"


def run(line, **options):
    """Run a command."""
    done = subprocess.run(line, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def python(code, **options):
    """Run code in a fresh interpreter; return what it printed."""
    return run([sys.executable, "-c", code], **options).stdout


def build(target, tmp_path, source=ROOT):
    """Build a wheel or an sdist, without network, and return it."""
    code = f"import hatchling.build as b; print(b.build_{target}({str(tmp_path)!r}))"
    return tmp_path / python(code, cwd=source).splitlines()[-1]


@pytest.mark.slow
def test_a_built_package_works_outside_the_checkout(tmp_path):
    """The sdist is built, a wheel is built from it and installed in a fresh environment, used, and uninstalled."""
    sdist = build("sdist", tmp_path)
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    wheel = build("wheel", tmp_path, tmp_path / sdist.name.removesuffix(".tar.gz"))
    home = tmp_path / "environment"
    run([sys.executable, "-m", "venv", "--without-pip", str(home)])
    scripts = home / ("Scripts" if os.name == "nt" else "bin")
    (site,) = home.rglob("site-packages")
    # The dependencies are those of this environment; an editable fbl-gym in it is not found by a path.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    pip = [sys.executable, "-m", "pip", "--python", str(scripts / "python"), "--disable-pip-version-check"]
    subprocess.run([*pip, "install", "--quiet", "--no-deps", "--ignore-installed", str(wheel)], check=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def installed(program, *words):
        return run([str(scripts / program), *words], cwd=tmp_path, env=environment).stdout

    assert str(site) in installed("python", "-c", "import fbl_gym, benchmarks, controllers; print(fbl_gym.__file__)")
    few = ["--policies", "zero", "ppo-blend", "--scenarios", "nominal", "--seeds", "1"]
    assert "ppo-blend" in installed("fbl-gym", "leaderboard", *few, "--workers", "1")
    installed("fbl-gym", "report", *few)
    assert (tmp_path / "results" / "report" / "board.html").stat().st_size > 1e6
    few = ["--trials", "2", "--seeds", "1", "--fresh-seeds", "1", "--candidates", "1", "--scenarios", "nominal"]
    assert "use them as pd-gravity@" in installed("fbl-gym", "tune", "pd-gravity", *few)
    assert (site / "fbl_gym" / "py.typed").exists()
    assert not (site / "tests").exists()
    subprocess.run([*pip, "uninstall", "--quiet", "--yes", "fbl-gym"], check=True)
    left = {path.suffix for room in ("fbl_gym", "controllers", "benchmarks") for path in (site / room).rglob("*.*")}
    assert left <= {".nbi", ".nbc"}  # what Numba compiled


def test_the_sdist_has_all_that_the_readme_names(tmp_path):
    with tarfile.open(build("sdist", tmp_path)) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    links = re.findall(r"\]\((?!https?:)([^)#]+)", (ROOT / "README.md").read_text())
    assert {"Makefile", "constraints.txt", "pyproject.toml", *links} <= names


def test_the_readme_of_the_index_has_no_dead_link():
    """Its links follow from one URL, and are words without one."""
    pytest.importorskip("hatchling")
    code = "import sys, hatch_build as h; t = open('README.md').read(); print({}, h.readme(t, {!r}, 'v1'))"
    with_url = python(code.format("h.links('https://github.com/a/b', 'v1')", "https://github.com/a/b"), cwd=ROOT)
    without = python(code.format("h.links('', 'v1')", ""), cwd=ROOT)
    assert re.findall(r"\]\((?!https:)", with_url) == re.findall(r"\]\((?!https:)", without) == []
    pictures = 'src="{}arm.gif"', 'srcset="{}arm-dark.gif"', "https://a.github.io/b/"
    for text in pictures:
        assert text.format("https://github.com/a/b/raw/v1/docs/pictures/") in with_url
    assert not re.search("github.com/a/b|docs/pictures", without)


STEP = """
import sys, gymnasium as gym
env = gym.make("fbl_gym:fbl_gym/TwoLinkArm-v0", render_mode="rgb_array")  # by the prefix of its module
import controllers, benchmarks.cli
env.reset(seed=0)
env.step(env.action_space.sample())
print([*sys.modules])
env.render()
import pygame
assert not pygame.display.get_init()
"""


def test_importing_and_stepping_brings_no_graphics_and_no_learning():
    heavy = "matplotlib pygame torch stable_baselines3 rich plotly control optuna filterpy fbl_gym.view.render"
    assert not {*heavy.split()} & {*ast.literal_eval(python(STEP).splitlines()[0])}


def test_the_list_of_commands_imports_nothing():
    """And the package alone imports no compiler."""
    show = "; import sys; print([m for m in sys.modules if '.' not in m])"
    for code, heavy in ((COMMAND, {"numpy", "gymnasium"}), ("import fbl_gym", {"numba", "scipy"})):
        assert not heavy & set(ast.literal_eval(python(code + show).splitlines()[-1]))


@pytest.fixture
def first(tmp_path):
    """Options of a process in whose path a folder comes first."""
    return {"cwd": tmp_path, "env": os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}}


def users(folder, name, text=""):
    """Write a file into folders `controllers` and `benchmarks` of a user."""
    for package in ("controllers", "benchmarks"):
        (folder / package).mkdir()
        (folder / package / name).write_text(text)


def test_a_users_package_that_hides_one_of_these_is_named(tmp_path, first):
    users(tmp_path, "__init__.py")
    shutil.rmtree(tmp_path / "benchmarks")
    shown = run([sys.executable, "-c", "import fbl_gym"], **first).stderr
    assert f"UserWarning: `import controllers` takes {tmp_path}" in shown
    assert "benchmarks" not in shown


def test_a_users_folder_of_the_same_name_keeps_its_modules(tmp_path):
    users(tmp_path, "mine.py")
    python("import controllers.mine, benchmarks.mine, controllers.base", cwd=tmp_path)


def test_a_users_folder_of_the_same_name_does_not_break_the_command(tmp_path, first):
    """Folders `controllers` and `benchmarks` come first in the path; workers and policies get fbl-gym's too."""
    users(tmp_path, "__init__.py", "raise RuntimeError('the wrong one')\n")
    (tmp_path / "law.py").write_text("from controllers.laws.simple import Zero as make_policy\n")
    command = "leaderboard --policies zero law.py --scenarios nominal --seeds 1 --workers 2"
    run([sys.executable, "-m", "fbl_gym", *command.split()], **first)
