"""Flip signs in the dynamics, one at a time, and check that the tests fail: `python tests/mutate.py` (minutes).

A mutant survives if no test fails: nothing tests that sign. Each mutant runs in a copy of the package.
Arguments select mutants by their names: `python tests/mutate.py lump` flips the signs of `lump` only.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
TARGETS = {
    "fbl_gym/model/arm.py": ("lumped_terms", "inertia_terms", "coriolis_terms", "gravity_terms", "solve_terms"),
    "fbl_gym/kernel/arm/physics.py": ("load_on_joints", "_stage", "moved", "weighted", "hold", "lump"),
    "fbl_gym/model/chain.py": ("segment_terms", "chain_inertia", "chain_load", "reduce_terms", "bend_terms"),
}
"""Functions by their file."""

TESTS = {"arm.py": ("arm",), "physics.py": ("physics", "friction"), "chain.py": ("flexible", "mujoco")}
"""Names of the files of tests that must fail, by the name of that file."""


def mutants(path, functions):
    """Yield name and source of every mutant: one plus or minus of a function's formulas is flipped."""
    source = (ROOT / path).read_text()
    for function in functions:
        start = source.index(f"def {function}(")
        end = source.find("\n\n\n", start)
        end = len(source) if end < 0 else end
        body = source.index('"""', source.index('"""', start) + 3) + 3
        for match in re.finditer(r" [+-] | [+-](?== )|(?<=[ (])-(?=\w)", source[body:end]):
            sign, place = match.group(), body + match.start()
            other = sign.replace("+", "-") if "+" in sign else sign.replace("-", "+")
            line = source.count("\n", 0, place) + 1
            name = f"{function}, line {line}: {sign.strip()} to {other.strip()}"
            yield name, source[:place] + other + source[place + len(sign) :]


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


def main(words):
    """Run the mutants whose name contains one of the words, or all; return 1 if one survives."""
    survivors, count = [], 0
    for path, functions in TARGETS.items():
        tests = [f"tests/fbl_gym/test_{name}.py" for name in TESTS[Path(path).name]]
        for name, source in mutants(path, functions):
            if not words or any(word in name for word in words):
                count += 1
                if survives(path, source, tests):
                    survivors.append(name)
    sys.stdout.write(f"{count} mutants, {len(survivors)} survive: {survivors}\n")
    return int(bool(survivors))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
