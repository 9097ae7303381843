"""The command line under mpirun: rank 0 leads, all join the collective stage, no error leaves a rank waiting.

What carries the weight: each way of failing ends all ranks in bounded time, with the exit code and one line
where all ranks meet the error.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from fretflow.pipeline.stage import Manifest

pytestmark = pytest.mark.mpi

SCRIPT = Path(__file__).with_name("collective_run.py")
CASE = 'format = "fretflow-case/1"\nname = "{}"\n[test]\nexcitation_amplitude = "1 N"\ncycles = 1\n'


def mpirun(kind, folder, cases=1):
    files = []
    for index in range(cases):
        files.append(folder / f"case{index}.toml")
        files[-1].write_text(CASE.format(f"c{index}"))
    command = [
        "mpirun",
        "--allow-run-as-root",
        "--oversubscribe",
        "-n",
        "2",
        sys.executable,
        SCRIPT,
        kind,
        "run",
        *files,
        "--out",
        folder / "out",
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment)


def test_every_rank_joins_for_each_of_several_cases(tmp_path):
    done = mpirun("well", tmp_path, cases=2)
    assert done.returncode == 0, done.stderr
    for name in ("c0", "c1"):
        [folder] = (tmp_path / "out" / name).glob("reduce-*")
        assert (folder / "total.txt").read_text() == "3"
        assert Manifest.read(folder).ranks == 2
        assert Manifest.read(folder).figures == {"total": 3}
        assert done.stdout.count(str(folder)) == 1  # told once a case, not once a rank
    again = mpirun("well", tmp_path, cases=2)
    assert again.returncode == 0
    assert again.stdout.count("reused") == 4


@pytest.mark.parametrize(("kind", "code", "message"), [
    ("all-fail", 2, "contact: the mesh has no such group"),
    ("no-convergence", 3, "eigenvalues; residual history in "),
    ("rank-1-fails-late", 2, "rank 1 fails at its end"),
])
def test_an_error_that_ends_every_rank_is_one_line_with_its_code(tmp_path, kind, code, message):
    done = mpirun(kind, tmp_path)
    assert done.returncode == code
    ours = [line for line in done.stderr.splitlines() if line.startswith("fretflow: ")]
    assert len(ours) == 1
    assert message in ours[0]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("kind", ["rank-0-fails", "rank-1-fails"])
def test_an_error_of_one_rank_ends_the_other_that_waits_for_it(tmp_path, kind):
    done = mpirun(kind, tmp_path)  # without an end it runs into the timeout
    assert done.returncode == 2
    assert f"only {kind.removesuffix('-fails').replace('-', ' ')} fails" in done.stderr
