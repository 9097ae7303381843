"""Mesh files that cannot be used.

What carries the weight: each gives one line that names the file and the way out, and no other exception.
"""

import gmsh
import pytest
from fretflow.core.errors import MeshError
from fretflow.structure.fem.mesh_file import read_mesh
from mpi4py import MPI

pytestmark = pytest.mark.fem

GROUPS = {"contact": 2, "clamped": 2, "body": 3}


def block(path, names=tuple(GROUPS), recombine=True, offset=0, generate=True, first_node=1):
    """Write a block of 2 x 2 x 2 elements with the groups `names`, their tags shifted by `offset`."""
    gmsh.initialize(readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.FirstNodeTag", first_node)
        gmsh.model.add("block")
        base = gmsh.model.occ.addRectangle(0, 0, 0, 1e-3, 1e-3)
        out = gmsh.model.occ.extrude([(2, base)], 0, 0, 1e-3, numElements=[2], recombine=recombine)
        gmsh.model.occ.synchronize()
        for dim, curve in gmsh.model.getEntities(1):
            assert dim == 1
            gmsh.model.mesh.setTransfiniteCurve(curve, 3)
        gmsh.model.mesh.setTransfiniteSurface(base)
        if recombine:
            gmsh.model.mesh.setRecombine(2, base)
        members = {"contact": [base], "clamped": [out[0][1]], "body": [out[1][1]]}
        for tag, name in enumerate(names, start=1 + offset):
            group = gmsh.model.addPhysicalGroup(GROUPS[name], members[name], tag)
            gmsh.model.setPhysicalName(GROUPS[name], group, name)
        if generate:
            gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    return path


def test_groups_are_found_by_name(tmp_path):
    mesh = read_mesh(block(tmp_path / "own.msh", offset=40), MPI.COMM_WORLD)
    assert (mesh.contact_tag, mesh.clamped_tag) == (41, 42)
    assert len(mesh.facet_tags.find(41)) == 4


def test_node_numbers_may_start_anywhere(tmp_path):
    mesh = read_mesh(block(tmp_path / "shifted.msh", first_node=501), MPI.COMM_WORLD)
    assert mesh.domain.topology.index_map(3).size_local == 8
    assert mesh.domain.geometry.x.max() == pytest.approx(1e-3, rel=1e-12)


@pytest.mark.parametrize("missing", list(GROUPS))
def test_a_missing_group_is_named(tmp_path, missing):
    path = block(tmp_path / "m.msh", names=[n for n in GROUPS if n != missing])
    with pytest.raises(MeshError, match=rf"m\.msh: has no physical \w+ named '{missing}'"):
        read_mesh(path, MPI.COMM_WORLD)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MeshError, match=r"none\.msh: no such mesh file"):
        read_mesh(tmp_path / "none.msh", MPI.COMM_WORLD)


def test_a_file_that_is_no_mesh_is_refused(tmp_path):
    path = tmp_path / "text.msh"
    path.write_text("$MeshFormat\nnonsense\n")
    with pytest.raises(MeshError, match=r"text\.msh"):
        read_mesh(path, MPI.COMM_WORLD)


def test_a_truncated_file_is_refused(tmp_path):
    path = block(tmp_path / "half.msh")
    text = path.read_bytes()
    path.write_bytes(text[:text.index(b"$Elements") + 60])
    with pytest.raises(MeshError, match=r"half\.msh"):
        read_mesh(path, MPI.COMM_WORLD)


def test_tetrahedra_are_refused(tmp_path):
    with pytest.raises(MeshError, match="other elements than hexahedra"):
        read_mesh(block(tmp_path / "tets.msh", recombine=False), MPI.COMM_WORLD)


def test_geometry_without_a_mesh_is_refused(tmp_path):
    with pytest.raises(MeshError, match=r"empty\.msh"):
        read_mesh(block(tmp_path / "empty.msh", generate=False), MPI.COMM_WORLD)
