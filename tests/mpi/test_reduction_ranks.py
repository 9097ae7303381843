"""The reduction on two ranks.

What carries the weight: the reduced matrices of one and of two ranks agree to 1e-9, block by block since their
units differ, though meshes are partitioned and summed in another order; and a bad file stops both ranks.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fretflow.case import config
from fretflow.core.store import read_record, write_record
from fretflow.structure.reduction.reduce import reduce_specimen
from fretflow.structure.reduction.reduced_specimen import ModeShapes, ReducedSpecimen
from fretflow_meshes.specimen import Side, build_specimen
from mpi4py import MPI

pytestmark = [pytest.mark.fem, pytest.mark.mpi]

SCRIPT = Path(__file__).with_name("reduction_run.py")


def on_two_ranks(mesh, summary, result):
    command = ["mpirun", "--allow-run-as-root", "--oversubscribe", "-n", "2",
               sys.executable, str(SCRIPT), str(mesh), str(summary), str(result)]
    # A copy: MPI, started in this process, has put its own variables in the environment behind Python's back.
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False, env=dict(os.environ))


@pytest.fixture(scope="module")
def meshed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ranks")
    specimen = config.Specimen()
    summary = build_specimen(specimen, config.Mesh(contact_elements=2, growth=2.0), Side.UPPER, folder / "upper.msh")
    write_record(folder / "upper.h5", summary)
    return folder, summary


def test_two_ranks_give_the_same_matrices(meshed):
    folder, summary = meshed
    done = on_two_ranks(folder / "upper.msh", folder / "upper.h5", folder / "two.h5")
    assert done.returncode == 0, done.stderr
    two = read_record(folder / "two.h5", ReducedSpecimen)
    one, shapes = reduce_specimen(folder / "upper.msh", summary, config.Specimen(), config.Reduction(), 1,
                                  MPI.COMM_SELF)
    blocks = [slice(0, one.contact_size), one.rigid, one.observation, one.modal]
    for ours, theirs in ((one.stiffness, two.stiffness), (one.mass, two.mass)):
        scale = np.sqrt(np.diag(ours))
        difference = np.abs(ours - theirs) / np.outer(scale, scale)
        assert max(difference[r, c].max() for r in blocks for c in blocks) < 1e-9
    assert two.contact_areas == pytest.approx(one.contact_areas, rel=1e-12)
    assert two.observation_point == pytest.approx(one.observation_point, abs=1e-15)
    assert two.full_frequencies == pytest.approx(one.full_frequencies, rel=1e-9)
    gathered = read_record(folder / "two_modes.h5", ModeShapes)
    order, other = (np.lexsort(np.round(modes.points, 9).T) for modes in (gathered, shapes))
    assert gathered.points[order] == pytest.approx(shapes.points[other], abs=1e-12)
    assert gathered.shape[0, order] == pytest.approx(shapes.shape[0, other], abs=1e-6 * shapes.shape[0].max())


def test_a_bad_mesh_stops_both_ranks_with_the_same_line(meshed):
    folder, _ = meshed
    done = on_two_ranks(folder / "none.msh", folder / "upper.h5", folder / "bad.h5")
    assert done.returncode == 2
    messages = [(folder / f"error{rank}").read_text() for rank in (0, 1)]
    assert messages[0] == messages[1]
    assert "none.msh: no such mesh file" in messages[0]
