"""The cache of compiled code: shared by processes; without one, an environment still works."""

import contextlib
import gc
import importlib.util
import os
import pkgutil
import shutil
import subprocess
import sys
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grimp
import pytest
from numba.core import config
from numba.core.dispatcher import Dispatcher

import fbl_gym
from fbl_gym.kernel.maths import fastmath
from fbl_gym.kernel.step import api
from fbl_gym.model.arm import inertia_terms


def run(*arguments, cache=None):
    """Run code in a process of its own, which keeps compiled code in a folder."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)} if cache else None
    return subprocess.run([sys.executable, "-c", *arguments], env=environment, capture_output=True, text=True)


WITHOUT_CACHE = """
from numba.core import caching
caching.CacheImpl._locator_classes = []  # as in a container whose file system is read-only
import numpy as np
import fbl_gym
env = fbl_gym.TwoLinkArmEnv()
env.reset(seed=0)
print(env.step(np.zeros(2))[0].shape)
from fbl_gym.kernel.step import api
print(api.STEPS[0]._cache.cache_path or "memory alone")
"""


@pytest.mark.slow
def test_an_environment_works_without_a_writable_cache():
    done = run(WITHOUT_CACHE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["(12,)", "memory alone"]
    assert done.stderr.count("RuntimeWarning: compiled code cannot be kept") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


TOGETHER = """
import numpy as np
import fbl_gym
env = fbl_gym.TwoLinkArmEnv("everything-2")
env.reset(seed=3)
print(env.step(np.array([0.1, -0.2]))[0].tobytes().hex())
"""


@pytest.mark.slow
def test_processes_share_what_one_has_compiled(tmp_path):
    """Two processes compile at once; a later one compiles nothing."""
    with ThreadPoolExecutor() as threads:
        workers = [*threads.map(lambda _: run(TOGETHER, cache=tmp_path), range(2))]
    assert [worker.returncode for worker in workers] == [0, 0]
    assert sum("compiles code for this" in worker.stderr for worker in workers) == 1
    files = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}
    assert files
    later = run(TOGETHER, cache=tmp_path)
    assert [worker.stdout for worker in workers] == [later.stdout] * 2
    assert (later.returncode, later.stderr) == (0, "")
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")} == files
    for path in files:
        path.write_bytes(path.read_bytes()[:100])  # as a full disk leaves it
    damaged, mended = run(TOGETHER, cache=tmp_path), run(TOGETHER, cache=tmp_path)
    assert (damaged.returncode, damaged.stdout, mended.stdout, mended.stderr) == (0, later.stdout, later.stdout, "")


def test_one_process_says_that_code_is_compiled_and_another_does_a_while_later(tmp_path, capsys):
    for _ in range(3):
        fastmath.say_once(tmp_path)
    assert (
        capsys.readouterr().err == "fbl-gym: compiles code for this kind of arm, once, some 20 s; it is kept on disk\n"
    )
    os.utime(tmp_path / "compiling", (0, 0))
    fastmath.say_once(tmp_path)
    assert capsys.readouterr().err.count("\n") == 1


def test_every_compiled_function_has_a_name_of_its_own():
    """Numba tells functions of one name apart by a counter of the process, which a cache outlives."""
    packages, functions = ("fbl_gym", "controllers", "benchmarks"), defaultdict(set)
    for name in packages:
        for module in pkgutil.walk_packages(importlib.import_module(name).__path__, f"{name}."):
            if not module.name.endswith("__main__"):
                with contextlib.suppress(ImportError):  # of an extra
                    importlib.import_module(module.name)
    for function in (thing.py_func for thing in gc.get_objects() if issubclass(type(thing), Dispatcher)):
        if function.__module__.startswith(packages):
            functions[function.__module__, function.__qualname__].add(function)
    assert len(functions) > 100
    assert not [name for name, several in functions.items() if len(several) > 1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "order",
    ["springs friction", "friction springs", "bending plain friction", "events springs bending",
     "plain events friction", "friction bending events"],
)  # fmt: skip
def test_readings_are_true_whichever_process_filled_the_cache(tmp_path, order):
    """Each process compiles one class of steps; the last one loads all of them."""
    check = "import sys; from benchmarks.cli import doctor; "
    check += "doctor.CLASSES = {name: doctor.CLASSES[name] for name in sys.argv[1].split()}; sys.exit(doctor._check_readings())"
    for classes in (*order.split(), order, " ".join(reversed(order.split()))):
        done = run(check, classes, cache=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr


def test_a_configuration_in_the_current_folder_does_not_move_the_cache(tmp_path, monkeypatch):
    """Whoever writes a cache writes code."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(config, "CACHE_LOCATOR_CLASSES", "nowhere.Locator", raising=False)
    assert not fastmath.cached_njit(inertia_terms)._cache.cache_path.startswith(str(tmp_path))
    assert str(tmp_path) == config.CACHE_DIR


def test_a_change_of_any_source_changes_the_key(tmp_path):
    """Numba itself notices changes in the file of a cached function only; the layout follows from the options."""
    package = Path(fbl_gym.__file__).parent
    copy = Path(shutil.copytree(package, tmp_path / "fbl_gym", ignore=shutil.ignore_patterns("__pycache__")))
    digests = {fastmath.digest(copy)}
    sources = sorted(grimp.build_graph("fbl_gym", cache_dir=None).find_upstream_modules("fbl_gym.kernel.step.api"))
    assert {"fbl_gym.options.actuator", "fbl_gym.records.record", "fbl_gym.scenarios.scenario"} <= {*sources}
    for name in sources:
        file = copy / Path(importlib.util.find_spec(name).origin).relative_to(package)
        file.write_bytes(file.read_bytes() + b"#")
        digests.add(fastmath.digest(copy))
    assert len(digests) == 1 + len(sources)
    assert fastmath.digest(package) == fastmath.DIGEST
    keys = {step._cache._index_key(None, step.targetctx.codegen()) for step in api.STEPS}
    assert len({step._cache._impl.filename_base for step in api.STEPS}) == len(api.STEPS)
    assert {key[-1] for key in keys} == {fastmath.DIGEST}
