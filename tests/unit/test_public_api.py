"""The public names: they are there, say what they take in what unit, and cost nothing before they are used.

What carries the weight: the names that the table of rooms gives are those that type checkers see.
"""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import fretflow as ff
import pytest

SOURCE = Path(ff.__file__)


def test_type_checkers_see_the_names_that_there_are():
    tree = ast.parse(SOURCE.read_text(encoding="utf-8"))
    seen = {(node.module, alias.name) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module
            for alias in node.names if alias.asname}
    assert seen == {(f"fretflow.{room}", name) for room, names in ff._PUBLIC.items() for name in names}
    assert sorted(name for _, name in seen) == sorted(ff.__all__)
    assert (SOURCE.parent / "py.typed").is_file()


@pytest.mark.parametrize("name", ff.__all__)
def test_public_names_are_documented(name):
    value = getattr(ff, name)
    assert name in dir(ff)
    assert inspect.getdoc(value)


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
