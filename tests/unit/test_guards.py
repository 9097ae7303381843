"""The guards of the test session: tests that need something absent skip for a user and fail in CI.

What carries the weight: the same four tests, run by a pytest of their own under this project's conftest.py,
end differently with CI set and without; an expected failure or an unmarked skip never turns into a failure.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

CONFTEST = Path(__file__).parents[1] / "conftest.py"

MARKED = """
import pytest

@pytest.mark.fem
def test_fem():
    pytest.skip("no dolfinx")

@pytest.mark.real_data
def test_recordings(recordings):
    assert recordings.is_dir()

@pytest.mark.mpi
@pytest.mark.xfail(strict=True)
def test_expected():
    assert False

def test_unmarked():
    pytest.skip("a choice")
"""


def run_pytest(folder: Path, source: str, **environment: str) -> str:
    """Run the tests in `source` under the project's conftest and return pytest's summary line."""
    (folder / "tests").mkdir()
    (folder / "tests" / "conftest.py").write_text(CONFTEST.read_text())
    (folder / "tests" / "test_it.py").write_text(source)
    (folder / "pytest.ini").write_text("[pytest]\nmarkers =\n  fem:\n  mpi:\n  real_data:\n")
    clean = {k: v for k, v in os.environ.items()
             if k not in ("CI", "FRETFLOW_RECORDINGS") and not k.startswith("PYTEST")}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]
    result = subprocess.run(command, cwd=folder, env={**clean, **environment}, capture_output=True, text=True,
                            timeout=60, check=False)
    return result.stdout.strip().rpartition("\n")[2]


def test_a_user_may_lack_things(tmp_path):
    assert run_pytest(tmp_path, MARKED).startswith("3 skipped, 1 xfailed in")


@pytest.mark.parametrize("value", ["true", "1"])
def test_ci_may_not(tmp_path, value):
    assert run_pytest(tmp_path, MARKED, CI=value).startswith("1 failed, 1 skipped, 1 xfailed, 1 error in")


def test_a_user_names_the_folder_of_recordings(tmp_path):
    summary = run_pytest(tmp_path, MARKED, FRETFLOW_RECORDINGS=str(tmp_path), CI="true")
    assert summary.startswith("1 failed, 1 passed, 1 skipped, 1 xfailed in")


@pytest.mark.parametrize(("ci", "summary"), [("", "1 skipped in"), ("true", "1 error in")])
def test_a_file_that_skips_itself(tmp_path, ci, summary):
    source = "import pytest\npytest.importorskip('no_such_module')\n"
    assert run_pytest(tmp_path, source, CI=ci).startswith(summary)
