"""Flips signs in the dynamics, one at a time, and sees whether the physics tests fail: `python tests/mutate.py` (minutes).

A mutant that survives is a sign that nobody watches. Each runs in a copy of the package, so that the checkout stays as it is.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
WATCHED = ("lumped_terms", "inertia_terms", "coriolis_terms", "gravity_terms", "solve_terms")
TESTS = ["tests/fbl_gym/test_arm.py"]


def mutants():
    """Every source of `arm.py` with one plus or minus of a term's formula turned around, with its line."""
    source = (ROOT / "fbl_gym" / "arm.py").read_text()
    for name in WATCHED:
        start = source.index(f"def {name}(")
        end = source.index("\n\n\n", start)
        body = source.index('"""', source.index('"""', start) + 3) + 3
        for found in re.finditer(r" [+-] |(?<=[ (])-(?=\w)", source[body:end]):
            sign = found.group()
            other = sign.replace("+", "-") if "+" in sign else sign.replace("-", "+")
            at = body + found.start()
            line = source.count("\n", 0, at) + 1
            yield (
                f"{name}, line {line}: {sign.strip()} to {other.strip()}",
                source[:at] + other + source[at + len(sign) :],
            )


def survives(source):
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for part in ("fbl_gym", "controllers", "benchmarks", "tests"):
            shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", copy)
        (copy / "fbl_gym" / "arm.py").write_text(source)
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *TESTS],
            cwd=copy, capture_output=True, env={"PYTHONPATH": folder, "PATH": "/usr/bin:/bin"}, check=False,
        )  # fmt: skip
        return done.returncode == 0


if __name__ == "__main__":
    alive = [name for name, source in mutants() if survives(source)]
    sys.stdout.write(f"{len(list(mutants()))} mutants, {len(alive)} survive: {alive}\n")
    sys.exit(bool(alive))
