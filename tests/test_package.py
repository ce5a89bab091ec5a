"""The package as a stranger meets it: a wheel outside the checkout, light imports. (What it says: test_docs.py.)"""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def python(code, **options):
    """Run code in a fresh interpreter; returns what it printed."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_built_wheel_works_outside_the_checkout(tmp_path):
    """Built, unpacked elsewhere, with no compile cache: it makes, resets and steps the environment and finds its policies."""
    wheel = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(tmp_path)]
    subprocess.run([*wheel, str(ROOT)], check=True, capture_output=True)
    (built,) = tmp_path.glob("*.whl")
    home = tmp_path / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(home), str(built)]
    subprocess.run(install, check=True, capture_output=True)
    code = """
import fbl_gym, controllers, benchmarks.cli, gymnasium as gym
env = gym.make("fbl_gym/TwoLinkArm-v0", scenario="everything-1")
observation, _ = env.reset(seed=0)
action, state = controllers.make("cascade-flm", env).predict(observation)
env.step(action)
print(fbl_gym.__file__)
"""
    environment = {**os.environ, "PYTHONPATH": str(home)}
    assert str(home) in python(code, cwd=tmp_path, env=environment)
    assert (home / "fbl_gym" / "py.typed").exists()
    assert not (home / "tests").exists()


def test_importing_brings_no_graphics_and_no_learning():
    code = "import sys, fbl_gym, controllers, benchmarks.cli; print([m for m in sys.modules if '.' not in m])"
    loaded = set(ast.literal_eval(python(code)))
    assert not loaded & {"matplotlib", "pygame", "torch", "stable_baselines3", "rich", "pandas"}


def test_the_environment_is_found_by_module_prefix():
    """`module:id` imports the package first, so that a tool needs no import of its own."""
    code = "import gymnasium as gym; print(gym.make('fbl_gym:fbl_gym/TwoLinkArm-v0').reset(seed=1)[0].shape)"
    assert python(code).strip() == "(12,)"


def test_make_targets_of_the_readme_exist():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.M))
    named = set(re.findall(r"^make ([a-z-]+)", (ROOT / "README.md").read_text(), flags=re.M))
    assert {"leaderboard", "test"} <= named <= targets
