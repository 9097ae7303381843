"""The compiled equations are kept, and a cache that a stop, a full disk or a fault has left behind heals itself.

What carries the weight: after each of these the next run assembles the right mass. Before, ffcx waited for a file that
an interrupted compiler never wrote, and every later run ended with `JIT compilation timed out`.
"""

import os
import shutil
import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.fem

PROGRAM = """
import signal, fretflow.structure.fem, ufl
from dolfinx.mesh import CellType, create_unit_cube
from fretflow.core.errors import FretflowError
from fretflow.structure.fem import compat
from mpi4py import MPI
signal.signal(signal.SIGINT, signal.default_int_handler)  # as in a run; gmsh takes the key when it is imported
mesh = create_unit_cube(MPI.COMM_SELF, 1, 1, 1, CellType.hexahedron)
try:
    space = compat.vector_space(mesh, 1)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    mass = compat.assemble_matrix(ufl.inner(u, v) * ufl.dx)
except FretflowError as error:
    print("refused", error)
else:
    ones = mass.createVecRight()
    ones.set(1.0)
    print(f"mass {ones.dot(mass * ones):.12g}")
"""
RIGHT = "mass 3"  # a unit cube of unit density, moved in three directions
COMPILER = "x86_64-linux-gnu-gcc"


@pytest.fixture
def assemble(tmp_path):
    """Return a way to assemble in a process of its own, with a compiler that is the machine's or a shell script."""
    def run(script=None, cache=tmp_path / "cache"):
        tools = tmp_path / "tools"
        shutil.rmtree(tools, ignore_errors=True)
        tools.mkdir()
        if script is not None:
            for name in (COMPILER, "gcc", "cc"):
                (tools / name).write_text(f"#!/bin/sh\n{script}\n")
                (tools / name).chmod(0o755)
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PATH": f"{tools}:{os.environ['PATH']}"}
        return subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60,
                              env=environment, cwd=tmp_path)

    return run


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """Return a cache that holds all that is needed."""
    cache = tmp_path_factory.mktemp("complete")
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60,
                          env={**os.environ, "XDG_CACHE_HOME": str(cache)}, cwd=cache)
    assert done.stdout.strip() == RIGHT, done.stderr
    return cache


@pytest.fixture
def filled(complete, tmp_path):
    """Return the folders of a cache that holds all that is needed, to be spoilt."""
    shutil.copytree(complete, tmp_path / "cache")
    return list((tmp_path / "cache" / "fretflow" / "forms").iterdir())


def libraries(tmp_path):
    return sorted((tmp_path / "cache").rglob("*.so"))


def test_what_was_compiled_is_kept(assemble, filled, tmp_path):
    kept = libraries(tmp_path)
    assert len(kept) == len(filled) >= 1
    assert assemble("exit 1").stdout.strip() == RIGHT  # needs no compiler any more
    assert libraries(tmp_path) == kept


def test_a_kill_while_the_compiler_is_at_work_breaks_no_later_run(assemble):
    assert assemble("kill -9 $PPID; sleep 0.1").returncode == -signal.SIGKILL
    assert assemble().stdout.strip() == RIGHT


def test_an_interrupt_while_the_compiler_is_at_work_leaves_nothing_behind(assemble, tmp_path):
    assert assemble("kill -INT $PPID; sleep 2; exit 1").returncode != 0
    assert list((tmp_path / "cache" / "fretflow" / "forms").iterdir()) == []
    assert assemble().stdout.strip() == RIGHT


def test_a_compiler_that_fails_is_one_line_and_the_next_run_tries_again(assemble, tmp_path):
    done = assemble("echo 'No space left on device' >&2; exit 1")
    assert done.stdout.startswith("refused the equations cannot be compiled (")
    assert "XDG_CACHE_HOME" in done.stdout
    assert libraries(tmp_path) == []
    assert assemble().stdout.strip() == RIGHT


def test_a_cache_that_takes_nothing_costs_a_compilation_but_no_run(assemble, tmp_path):
    (tmp_path / "file").touch()
    assert assemble(cache=tmp_path / "file").stdout.strip() == RIGHT


@pytest.mark.parametrize("damage", ["cut off", "gone", "unfinished"])
def test_damaged_code_is_compiled_again(assemble, filled, tmp_path, damage):
    for library in libraries(tmp_path):
        if damage == "cut off":
            os.truncate(library, 100)
        else:
            library.unlink()
        if damage == "unfinished":
            [ready] = library.parent.glob("*.cached")
            ready.unlink()
    assert assemble().stdout.strip() == RIGHT
    assert all(library.stat().st_size > 100 for library in libraries(tmp_path))
    assert assemble("exit 1").stdout.strip() == RIGHT


def test_code_that_others_may_have_put_into_the_cache_is_not_run(assemble, filled):
    for folder in filled:
        folder.chmod(0o777)
    assert assemble("exit 1").stdout.startswith("refused")


@pytest.mark.parametrize("name", ["dolfinx_jit_parameters.json", "dolfinx_jit_options.json"])
def test_options_of_the_compiler_are_not_taken_from_the_working_folder(assemble, tmp_path, name):
    """Among them would be `-fplugin`, which has gcc load a library."""
    (tmp_path / name).write_text('{"cffi_extra_compile_args": ["-fplugin=./absent.so"], "cache_dir": "elsewhere"}')
    assert assemble().stdout.strip() == RIGHT
    assert not (tmp_path / "elsewhere").exists()


def test_two_that_start_at_once_do_not_disturb_each_other(tmp_path):
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    both = [subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True, env=environment,
                             cwd=tmp_path) for _ in range(2)]
    assert [one.communicate(timeout=60)[0].strip() for one in both] == [RIGHT, RIGHT]
