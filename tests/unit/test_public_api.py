"""The public names: they are there, say what they take in what unit, and cost nothing before they are used.

What carries the weight: the names that the table of rooms gives are those that type checkers see.
"""

import ast
import doctest
import importlib
import inspect
import os
import re
import runpy
import subprocess
import sys
import tomllib
from enum import Enum
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import fretflow as ff
import pytest
from fretflow.core.errors import PlatformError
from fretflow.core.plugins import FIGURES, MESHES, provided

SOURCE = Path(ff.__file__)
ROOT = Path(__file__).parents[2]
OF_NO_QUANTITY = {"ALL_KINDS", "Block", "add_effects"}
USE = """
import numpy as np
import fretflow as ff

K, M, C, nodes, areas, gap = np.eye(6), np.eye(6), np.eye(6), np.zeros((1, 2)), np.ones(1), np.zeros(1)
joint = ff.Joint.from_matrices(K, M, C, contact=[1], observe={"tip": 0})
problem = ff.PeriodicProblem(joint, ff.Interface(nodes, areas, gap), ff.Coulomb(0.6), ff.Harmonic(100, {"tip": 53}),
                             preload=ff.NormalLoad(60))
period = ff.solve_periodic(problem)
limit: float | None = ff.read_loop(period.hysteresis("tip"), normal_load=60).friction_limit
curve = ff.continue_response(problem, 20, 400)
wear = ff.march_wear(problem, ff.Archard(1.1e-14), cycles=1_900_000)
diagnosis = ff.diagnose(ff.read_recording("rec/"), fast=True)
diagnosis.to_html("report.html")
names: tuple[str, ...] = diagnosis.effects
run = ff.run("case.toml", out="runs", until="wear")
print(run.loops, run.summary["wear volume"].value, diagnosis.verdict, limit)
try:
    ff.load_case("case.toml")
except ff.NonConvergenceError as error:
    print(error.history)
"""


def test_type_checkers_see_the_names_that_there_are():
    """There is one list of them: the imports that type checkers read."""
    for name in ff.__all__:
        assert getattr(ff, name) is getattr(importlib.import_module(ff._ROOM_OF[name]), name)
    assert {"Joint", "run", "units"} <= set(ff.__all__)
    assert (SOURCE.parent / "py.typed").is_file()


@pytest.mark.parametrize("name", ff.__all__)
def test_public_names_are_documented(name):
    value = getattr(ff, name)
    assert name in dir(ff)
    text = inspect.getdoc(value)
    assert text
    if inspect.isfunction(value) or (inspect.isclass(value) and not issubclass(value, Exception | Enum)):
        assert "Examples\n--------" in text
    if inspect.isfunction(value) and name != "parameter":
        assert "Returns\n-------" in text
        assert "Raises\n------" in text
    if name not in OF_NO_QUANTITY and not isinstance(value, ModuleType) and not (
            inspect.isclass(value) and issubclass(value, Exception)):
        assert {"m", "N", "Hz", "SI", "units"} & set(re.findall(r"\w+", text))


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        ff.absent  # noqa: B018


def test_import_loads_no_numerical_library():
    program = ("import sys, fretflow\nheavy = {'numpy', 'scipy', 'h5py', 'mpi4py', 'dolfinx', 'gmsh', 'pyvista', "
               "'matplotlib', 'numba', 'xarray', 'pydantic'}\nsys.exit(', '.join(heavy & set(sys.modules)) or 0)")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_no_package_is_imported_by_one_that_it_imports():
    """Meshes and pictures are found by entry points; otherwise fretflow and the packages would import each other."""
    for file in SOURCE.parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else [
                alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any(module.startswith(("fretflow_post", "fretflow_meshes")) for module in modules), file


def test_no_file_is_imported_by_one_that_it_imports():
    """Imports within functions and those for type checkers included."""
    files = {".".join(file.relative_to(SOURCE.parents[1]).with_suffix("").parts).removesuffix(".__init__"): file
             for file in SOURCE.parent.rglob("*.py") if file != SOURCE}
    imports = {name: {module if module in files else node.module
                      for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
                      if isinstance(node, ast.ImportFrom) for alias in node.names
                      for module in (f"{node.module}.{alias.name}",)} for name, file in files.items()}
    assert any(imports.values())
    TopologicalSorter(imports).prepare()  # CycleError names the circle


@pytest.mark.parametrize("room", sorted(set(ff._ROOM_OF.values())))
def test_examples_in_docstrings_hold(room, monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("FRETFLOW_EFFECTS", "")
    outcome = doctest.testmod(importlib.import_module(room), optionflags=doctest.ELLIPSIS)
    assert outcome.failed == 0


def test_a_user_s_file_passes_strict_type_checks(tmp_path):
    """As the nine lines that the package aims at use the names."""
    (tmp_path / "mine.py").write_text(USE, encoding="utf-8")
    (tmp_path / "wrong.py").write_text(USE.replace("limit: float | None", "limit: str"), encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file=", "--cache-dir",
               tmp_path, "mine.py", "wrong.py"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    errors = [line for line in done.stdout.splitlines() if ": error:" in line]
    assert len(errors) == 1, done.stdout + done.stderr
    assert errors[0].startswith("wrong.py")  # the names have types, they are not Any
    assert errors[0].endswith("[assignment]")


def test_the_picture_of_the_architecture_shows_the_house_as_it_is():
    drawn = runpy.run_path(str(ROOT / "docs" / "draw_architecture.py"))["draw"]()
    assert (ROOT / "docs" / "architecture.svg").read_text(encoding="utf-8") == drawn, "run docs/draw_architecture.py"


def test_what_other_packages_provide_is_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for group in (FIGURES, MESHES):
        for name in project["entry-points"][group]:
            assert callable(provided(group, name))
    with pytest.raises(PlatformError, match=r"fretflow\.figures.*'absent'.*install"):
        provided(FIGURES, "absent")


def test_a_recording_that_is_not_there_is_named():
    with pytest.raises(ff.InputError, match="no/such: there is no such folder"):
        ff.diagnose("no/such")


def test_results_of_a_stage_that_was_not_run_are_refused_with_the_way_out(tmp_path):
    results = ff.RunResults({}, ff.load_case(ROOT / "examples" / "quick.toml"), tmp_path)
    with pytest.raises(ff.InputError, match="stage wear was not run; run the case until wear or further"):
        results.wear  # noqa: B018
    with pytest.raises(ff.InputError, match="stage reduce was not run"):
        results.loops  # noqa: B018
    assert results.curves == {}
    assert results.summary == {}


@pytest.mark.parametrize(("before", "given", "threads"), [
    ("", {}, "1"), ("", {"OPENBLAS_NUM_THREADS": "2"}, "2"), ("", {"OMP_NUM_THREADS": "2"}, "None"),
    ("import numpy; ", {}, "None")])
def test_a_script_solves_with_one_blas_thread_unless_told_otherwise(before, given, threads):
    """A second thread made `examples/matrices.py` five times as slow on a machine that had other work."""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    script = f"{before}import fretflow, os; print(os.environ.get('OPENBLAS_NUM_THREADS'))"
    done = subprocess.run([sys.executable, "-c", script], env=environment | given, capture_output=True, text=True,
                          check=True, timeout=60)
    assert done.stdout.strip() == threads
