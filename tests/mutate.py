"""Flip signs in the dynamics, one at a time, and check that the tests fail: `python tests/mutate.py` (minutes).

A mutant survives if no test fails: nothing tests that sign. Each mutant runs in a copy of the package.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
#: Functions, and the files of tests of which one must fail, by the file of the functions.
TARGETS = {
    "model/arm": ("lumped_terms inertia_terms coriolis_terms gravity_terms solve_terms", "arm"),
    "kernel/arm/physics": ("load_on_joints _stage moved weighted hold lump", "physics friction"),
    "model/chain": ("segment_terms chain_inertia chain_load reduce_terms bend_terms", "elastic mujoco"),
}


def mutants(path, functions):
    """Yield name and source of every mutant: one plus or minus of a function's formulas is flipped."""
    source = (ROOT / path).read_text()
    for function in functions:
        start = source.index(f"def {function}(")
        body, end = source.index('"""', source.index('"""', start) + 3) + 3, f"{source}\n\n\n".index("\n\n\n", start)
        for match in re.compile(r" [+-] | [+-](?== )|(?<=[ (])-(?=\w)").finditer(source, body, end):
            sign, line = match.group(), source.count("\n", 0, match.start()) + 1
            other = sign.translate({ord("+"): "-", ord("-"): "+"})
            name = f"{function}, line {line}: {sign.strip()} to {other.strip()}"
            yield name, source[: match.start()] + other + source[match.end() :]


def survives(path, source, tests):
    """Return True if the tests pass with another source of one file."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for part in ("fbl_gym", "controllers", "benchmarks", "tests"):
            shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", copy)
        (copy / path).write_text(source)
        result = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests],
            cwd=copy, capture_output=True, env={"PYTHONPATH": folder, "PATH": "/usr/bin:/bin"}, check=False,
        )  # fmt: skip
        return result.returncode == 0


def main():
    """Run all mutants, print those that survive, and return their number."""
    survivors = []
    for module, (functions, files) in TARGETS.items():
        path, tests = f"fbl_gym/{module}.py", [f"tests/fbl_gym/test_{name}.py" for name in files.split()]
        survivors += [name for name, source in mutants(path, functions.split()) if survives(path, source, tests)]
    print(f"{len(survivors)} survive: {survivors}")
    return len(survivors)


if __name__ == "__main__":
    sys.exit(main())
