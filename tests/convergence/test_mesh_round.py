"""A round body's volume tends to the closed form with order 2 for degree 1 and order 4 for degree 2.

The rate carries the weight: a rim node off the circle, or a chord taken for an arc, breaks it. The sizes are
chosen so that each mesh refines the one before.
"""

import gmsh
import numpy as np
import pytest
from fretflow.case import config
from fretflow_meshes.gmsh_files import gmsh_session
from fretflow_meshes.specimen import Side, build_specimen

RADIUS = 0.75 / 0.55  # mm: the core reaches 0.75 mm, a whole number of contact elements
WIDTH, HEIGHT, RIDGE = 1.0, 0.5, 0.25


def closed_form():
    strip = WIDTH * np.sqrt(RADIUS**2 - WIDTH**2 / 4.0) + 2.0 * RADIUS**2 * np.arcsin(WIDTH / (2.0 * RADIUS))
    return np.pi * RADIUS**2 * HEIGHT + strip * RIDGE


def volume(path):
    with gmsh_session(path):
        gmsh.merge(str(path))
        (kind,), *_ = gmsh.model.mesh.getElements(3, 3)
        points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss6")
        _, determinants, _ = gmsh.model.mesh.getJacobians(kind, points, 3)
    return 1e9 * np.sum(determinants.reshape(-1, len(weights)) @ weights)


@pytest.mark.parametrize("degree", [1, 2])
def test_round_volume_converges(tmp_path, degree):
    shape = config.Specimen(
        body=config.BodyShape.ROUND, body_width=f"{2 * RADIUS!r} mm", body_height=f"{HEIGHT} mm",
        contact_width=f"{WIDTH} mm", ridge_height=f"{RIDGE} mm", observation_distance=f"{RIDGE} mm")
    elements = np.array([4, 8, 16])
    errors = []
    for n in elements:
        mesh = config.Mesh(contact_elements=int(n), degree=degree, growth=1.0)
        build_specimen(shape, mesh, Side.UPPER, tmp_path / "a.msh")
        errors.append(abs(volume(tmp_path / "a.msh") / closed_form() - 1.0))
    rate = -np.polyfit(np.log(elements), np.log(errors), 1)[0]
    assert rate == pytest.approx(2.0 * degree, abs=0.1)
    assert errors[-1] < {1: 2e-3, 2: 2e-6}[degree]
