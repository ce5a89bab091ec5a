"""Policies of installed packages, by entry points: broken ones, and those that take a name of fbl-gym."""

import subprocess
import sys

import pytest

BROKEN = "raise ImportError('my dependency is missing')\n"
WORKS = "from controllers.simple import Zero as make_policy\n"


@pytest.fixture
def fbl_gym(tmp_path):
    """Run a command where a package registers three policies."""
    (tmp_path / "site" / "theirs-1.0.dist-info").mkdir(parents=True)
    for name, text in (("broken_law", BROKEN), ("works_law", WORKS)):
        (tmp_path / "site" / f"{name}.py").write_text(text)
    (tmp_path / "site" / "theirs-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n"
    )
    (tmp_path / "site" / "theirs-1.0.dist-info" / "entry_points.txt").write_text(
        "[fbl_gym.policies]\nbroken = broken_law:make_policy\n"
        "works = works_law:make_policy\nppo-torque = works_law:make_policy\n"
    )
    code = (
        f"import sys; sys.path.append({str(tmp_path / 'site')!r}); from fbl_gym.__main__ import main; sys.exit(main())"
    )

    def run(*arguments):
        line = [sys.executable, "-c", code, *arguments]
        return subprocess.run(line, capture_output=True, text=True, check=False, cwd=tmp_path)

    return run


def test_a_broken_plugin_is_named_and_the_rest_works(fbl_gym):
    listed = fbl_gym("list", "policies")
    assert listed.returncode == 0, listed.stderr
    lines = {line.split()[0]: line for line in listed.stdout.splitlines()}
    assert "cannot be loaded: ImportError: my dependency is missing" in lines["broken"]
    assert "access: none" in lines["works"]
    assert "trained on everything-2" in lines["ppo-torque"]
    few = ["--scenarios", "nominal", "--seeds", "1", "--workers", "1"]
    board = fbl_gym("leaderboard", "--policies", "zero", "broken", "works", *few)
    assert "Left out: broken: ImportError: my dependency is missing" in board.stdout
    assert " works " in board.stdout
    assert "Traceback" not in board.stderr
