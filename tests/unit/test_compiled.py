"""The products and factors that compiled loops take from BLAS and LAPACK, against NumPy."""

import os
import subprocess
import sys

import numpy as np
import pytest
from fretflow.core.compiled import compiled, factorise, multiply, multiply_symmetric, substitute


@pytest.mark.parametrize(("m", "s", "p"), [(5, 3, 4), (1, 7, 1), (4, 0, 2), (0, 3, 2), (3, 2, 0),
                                       (5, 7, 1), (7, 5, 1), (0, 3, 1), (3, 0, 1)])
def test_product_is_that_of_numpy(m, s, p):
    rng = np.random.default_rng(3)
    a, b, product = rng.normal(size=(m, s)), rng.normal(size=(s, p)), np.full((m, p), np.nan)
    multiply(a, b, product)
    np.testing.assert_allclose(product, a @ b, rtol=1e-13, atol=1e-13)


def test_product_with_a_symmetric_matrix_is_that_of_numpy():
    rng = np.random.default_rng(5)
    half, vector, product = rng.normal(size=(7, 7)), rng.normal(size=7), np.full(7, np.nan)
    multiply_symmetric(half + half.T, vector, product)
    np.testing.assert_allclose(product, (half + half.T) @ vector, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(("precision", "error"), [(np.float64, 1e-11), (np.float32, 1e-4)])
def test_factors_solve_for_matrices_that_are_given_by_columns(precision, error):
    rng = np.random.default_rng(4)
    matrix, right = rng.normal(size=(6, 6)), rng.normal(size=(6, 3))
    columns, solved = (np.ascontiguousarray(values.T, dtype=precision) for values in (matrix, right))
    pivots = np.empty(6, dtype=np.int32)
    assert factorise(columns, pivots)
    substitute(columns, pivots, solved)
    np.testing.assert_allclose(matrix @ solved.T, right, rtol=error, atol=error)


def test_right_hand_sides_of_another_precision_are_refused():
    with pytest.raises(ValueError, match="precision"):
        substitute(np.eye(2, dtype=np.float32), np.arange(1, 3, dtype=np.int32), np.ones((1, 2)))


def test_singular_matrix_is_told():
    assert not factorise(np.ones((3, 3)), np.empty(3, dtype=np.int32))


def test_division_by_zero_is_infinite_as_in_numpy():
    @compiled
    def ratio(a: float, b: float) -> float:
        return a / b

    assert ratio(1.0, 0.0) == np.inf
    assert np.isnan(ratio(0.0, 0.0))


def test_constants_make_no_versions_of_their_own():
    @compiled
    def either(value: float, first: bool, count: int) -> float:
        return value if first else count * value

    @compiled
    def both(value: float) -> float:
        return either(value, True, 0) + either(value, False, 2)

    assert both(1.5) == 4.5
    assert len(either.signatures) == 1


def test_code_kept_of_an_earlier_version_is_no_obstacle(tmp_path):
    """Its types may be gone: numba reads them before it sees that the source has changed."""
    source = """
from typing import NamedTuple
from fretflow.core.compiled import compiled


class {name}(NamedTuple):
    value: float


@compiled
def double(pair):
    return 2.0 * pair.value


print(double({name}(3.0)))
"""
    module, path = tmp_path / "kept.py", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    for name in ("Earlier", "Later"):
        module.write_text(source.format(name=name), encoding="utf-8")
        done = subprocess.run([sys.executable, "-c", "import kept"], cwd=tmp_path, capture_output=True, text=True,
                              timeout=120, env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
                                                "PYTHONPATH": path})
        assert done.stdout == "6.0\n", done.stderr


def test_a_full_disk_costs_a_compilation_but_no_run(tmp_path):
    """Any write fails as it does on a full disk: what numba keeps goes into a folder whose files may have no size."""
    source = "from fretflow.core.compiled import compiled\n\n\n@compiled\ndef twice(x):\n    return 2.0 * x\n"
    (tmp_path / "kept.py").write_text(source, encoding="utf-8")
    program = ("import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
               "import kept; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)); print(kept.twice(3.0), flush=True)")
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=120,
                          env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)})
    assert done.stdout == "6.0\n", done.stderr


def test_it_is_told_whether_the_first_call_has_to_wait(tmp_path):
    """The first run stood at 0 % for half a minute without a word of why."""
    script = ("import numpy, fretflow.core.compiled as own; before = own.is_compiled(own.largest); "
              "own.largest(numpy.ones(2)); print(before, own.is_compiled(own.largest))")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    said = [subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True,
                           timeout=120).stdout.split() for _ in range(2)]
    assert said == [["False", "True"], ["True", "True"]]
