"""The examples run, each in a process and a folder of its own, and what they assert of their numbers holds."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
MESHED = {"bolted_beam", "run_case"}  # needs finite elements


@pytest.mark.parametrize("name", [pytest.param(path.stem, marks=[pytest.mark.fem] if path.stem in MESHED else [])
                                  for path in sorted(EXAMPLES.glob("*.py"))])
def test_example(name, tmp_path):
    done = subprocess.run([sys.executable, EXAMPLES / f"{name}.py"], capture_output=True, text=True, cwd=tmp_path,
                          timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert not list(tmp_path.iterdir())  # what is written goes where it was asked for
