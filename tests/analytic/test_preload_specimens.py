"""The static preload of two meshed specimens with crossed ridges, through mesh, assembly and reduction.

What carries the weight: the pair looks the same when x and y are exchanged although neither specimen does, and
flat ridges press hardest at their edges, as a flat punch does.
"""

import numpy as np
import pytest
from fretflow.case import config
from fretflow.structure.fem.preload import frictionless_preload
from fretflow.structure.reduction.reduce import reduce_specimen
from fretflow_meshes.specimen import Side, build_specimen
from mpi4py import MPI

pytestmark = pytest.mark.fem

LOAD, SIDE = 60.0, 7  # nodes a side


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    reduction = config.Reduction(fixed_interface_modes=1, checked_frequencies=1)
    specimens = []
    for side in (Side.UPPER, Side.LOWER):
        path = folder / f"{side}.msh"
        summary = build_specimen(config.Specimen(), config.Mesh(contact_elements=SIDE - 1), side, path)
        specimens.append(reduce_specimen(path, summary, config.Specimen(), reduction, 1, MPI.COMM_WORLD)[0])
    return specimens


def flexibility(specimen):
    """Return the flexibility (n, n) of the contact nodes along z, clamped face fixed."""
    free = np.setdiff1d(np.arange(len(specimen.stiffness)), np.arange(len(specimen.stiffness))[specimen.rigid])
    inverse = np.linalg.inv(specimen.stiffness[np.ix_(free, free)])
    return inverse[2:specimen.contact_size:3, 2:specimen.contact_size:3]


def test_crossed_ridges_are_symmetric_and_pressed_as_a_punch(pair):
    upper, lower = pair
    assert upper.contact_nodes == pytest.approx(lower.contact_nodes, abs=1e-12)
    both = flexibility(upper) + flexibility(lower)
    preload = frictionless_preload(both, np.zeros(SIDE**2), upper.contact_areas, LOAD)
    assert preload.force.sum() == pytest.approx(LOAD, rel=1e-10)
    pressure = preload.pressure.reshape(SIDE, SIDE)
    assert pressure == pytest.approx(pressure.T, rel=1e-8)
    assert pressure == pytest.approx(pressure[::-1], rel=1e-8)
    edges = np.concatenate([pressure[0], pressure[-1], pressure[:, 0], pressure[:, -1]])
    assert edges.min() > pressure[1:-1, 1:-1].max()
    assert pressure.argmax() in (0, SIDE - 1, SIDE * (SIDE - 1), SIDE**2 - 1)
    alone = frictionless_preload(flexibility(upper), np.zeros(SIDE**2), upper.contact_areas, LOAD).pressure
    alone = alone.reshape(SIDE, SIDE)
    assert np.abs(alone - alone.T).max() > 0.01 * alone.mean()


def test_one_specimen_mirrors_the_other(pair):
    """Exchanging x and y turns the upper specimen into the lower one."""
    upper, lower = (flexibility(s).reshape((SIDE,) * 4) for s in pair)
    assert upper.transpose(1, 0, 3, 2) == pytest.approx(lower, rel=1e-8)
