"""Property: bodies whose faces are meshed apart press, move and vibrate as those do whose facets lie on one another.

And a mesh is the same in whatever format it is kept.
"""

from __future__ import annotations

import contextlib

import h5py
import meshio
import numpy as np
import pytest
from fretflow.core.errors import InputError, MeshError
from scipy.sparse.linalg import spsolve

pytestmark = pytest.mark.fem

STEEL = {"youngs_modulus": 210e9, "poissons_ratio": 0.0, "density": 7800.0}
LENGTH, WIDTH, HEIGHT = 40e-3, 12e-3, 6e-3


def blocks(path, upper, lower, lift=0.0, shift=0.0, longer=0.0, recombine=False):
    """Write two blocks, one on the other, of `upper` and `lower` elements along and across."""
    import gmsh

    gmsh.initialize(readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        made = []
        for x, z, length, up in ((shift, lift, LENGTH, HEIGHT), (0.0, 0.0, LENGTH + longer, -HEIGHT)):
            base = gmsh.model.occ.addRectangle(x, 0.0, z, length, WIDTH)
            far, body, *_ = gmsh.model.occ.extrude([(2, base)], 0.0, 0.0, up, [2] if recombine else [],
                                                           recombine=recombine)
            made.append((base, far[1], body[1]))
        gmsh.model.occ.synchronize()
        for (base, far, _), cells, names in zip(made, (upper, lower), (("upper", "top"), ("lower", "bottom")),
                                                strict=True):
            for (_, curve), count in zip(gmsh.model.getBoundary([(2, base)], oriented=False), cells * 2, strict=True):
                gmsh.model.mesh.setTransfiniteCurve(curve, count + 1)
            gmsh.model.mesh.setTransfiniteSurface(base)
            if recombine:
                gmsh.model.mesh.setRecombine(2, base)
            for name, face in zip(names, (base, far), strict=True):
                gmsh.model.setPhysicalName(2, gmsh.model.addPhysicalGroup(2, [face]), name)
        for (_, _, body), name in zip(made, ("pad", "rail"), strict=True):
            gmsh.model.setPhysicalName(3, gmsh.model.addPhysicalGroup(3, [body]), name)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    return path


def assembled(path, clamped=(), interface=("upper", "lower"), degree=2, materials=None, unit=1.0):
    from fretflow.structure.bodies import Material
    from fretflow.structure.fem.bodies import structure_from_mesh

    return structure_from_mesh(path, Material(**STEEL), [interface], clamped=clamped, degree=degree,
                               materials=materials, unit=unit)


def moved_as_one(matrices):
    """Return the three translations and three turns (n, 6) of what has no clamp, from the null space of K."""
    from scipy.sparse.linalg import eigsh

    shift = 1e-9 * matrices.stiffness.diagonal().max() / matrices.mass.diagonal().max()
    values, modes = eigsh(matrices.stiffness, 14, matrices.mass, sigma=-shift, which="LM")
    rigid = modes[:, np.argsort(np.abs(values))[:12]]  # six of each body
    together = np.linalg.svd(matrices.contact_map @ rigid)
    assert np.sum(together[1] > 1e-7 * together[1][0]) == 6
    return rigid @ together[2][6:].T


@pytest.mark.parametrize(("upper", "lower", "recombine", "degree"), [
    ((5, 2), (7, 3), False, 2), ((7, 3), (4, 2), True, 2), ((5, 2), (8, 3), True, 1)])
def test_bodies_that_move_as_one_leave_no_relative_motion(tmp_path, upper, lower, recombine, degree):
    matrices = assembled(blocks(tmp_path / "two.msh", upper, lower, recombine=recombine), degree=degree)
    whole = moved_as_one(matrices)
    assert np.abs(matrices.contact_map @ whole).max() < 1e-6 * np.abs(whole).max()
    assert matrices.areas.sum() == pytest.approx(LENGTH * WIDTH, rel=1e-9)
    assert matrices.gap is None


@pytest.mark.parametrize(("recombine", "softer"), [(False, 1.0), (True, 1.0), (False, 2.0)])
def test_a_uniform_pressure_passes_from_one_to_the_other(tmp_path, recombine, softer):
    """The patch test of contact: each body shortens by p h / E everywhere, wherever facets and elements end."""
    from fretflow.structure.bodies import Material

    other = Material(**(STEEL | {"youngs_modulus": STEEL["youngs_modulus"] / softer}))
    matrices = assembled(blocks(tmp_path / "two.msh", (7, 3), (5, 2), recombine=recombine), clamped=["bottom", "top"],
                         degree=1, materials={"pad": other})
    pressure = 1e6  # Pa
    force = np.zeros((matrices.contacts, 3))
    force[:, 2] = pressure * matrices.areas
    moved = spsolve(matrices.stiffness.tocsc(), matrices.contact_map.T @ force.ravel())
    opened = (matrices.contact_map @ moved).reshape(-1, 3)
    assert opened[:, 2] == pytest.approx((1.0 + softer) * pressure * HEIGHT / STEEL["youngs_modulus"], rel=1e-9)
    assert np.abs(opened[:, :2]).max() < 1e-9 * opened[0, 2]


def test_a_tied_pair_sounds_like_one_meshed_alike(tmp_path):
    from fretflow.structure.reduction.contact_modes import reduce_structure

    tied = [np.sqrt(reduce_structure(assembled(blocks(tmp_path / f"{k}.msh", *cells)), 2).eigenvalues)
            for k, cells in enumerate((((8, 3), (8, 3)), ((8, 3), (11, 4)), ((8, 3), (7, 2))))]
    assert tied[1] == pytest.approx(tied[0], rel=0.01)
    assert tied[2] == pytest.approx(tied[0], rel=0.02)


def test_faces_apart_have_a_gap(tmp_path):
    matrices = assembled(blocks(tmp_path / "two.msh", (5, 2), (7, 3), lift=20e-6))
    assert matrices.gap == pytest.approx(20e-6, rel=1e-6)


def test_the_smaller_face_stands_first(tmp_path):
    path = blocks(tmp_path / "two.msh", (5, 2), (7, 3), longer=20e-3)
    assert assembled(path).areas.sum() == pytest.approx(LENGTH * WIDTH, rel=1e-9)
    with pytest.raises(MeshError, match=r"two\.msh: 'lower' does not lie on 'upper': \d+ of its 42 facets"):
        assembled(path, interface=("lower", "upper"))


@pytest.mark.parametrize("sizes", [{"lift": 5e-3}, {"shift": 30e-3}])
def test_faces_that_do_not_touch_are_refused(tmp_path, sizes):
    with pytest.raises(MeshError, match=r"'upper' does not lie on 'lower'.* mm; name the smaller face first"):
        assembled(blocks(tmp_path / "two.msh", (5, 2), (7, 3), **sizes))


NAMES = ("upper", "lower", "pad")


def sets_of_nodes(mesh):
    """Return a mesh without surface elements, whose surfaces are sets of nodes, as in Abaqus' files."""
    numbers = list(zip(mesh.cells, mesh.cell_data["gmsh:physical"], strict=True))
    sets = {name: np.unique(np.concatenate([block.data[own == tag].ravel() for block, own in numbers
                                            if block.dim == dim])) for name, (tag, dim) in mesh.field_data.items()}
    solids = [block for block in mesh.cells if block.dim == 3]
    bodies = {name: [np.arange(len(block.data)) if k == place else np.zeros(0, dtype=int)
                     for k, block in enumerate(solids)] for place, name in enumerate(("pad", "rail"))}
    bodies["everything"] = [np.arange(len(block.data)) for block in solids]
    return meshio.Mesh(mesh.points, solids, cell_sets=bodies, point_sets={
        name: nodes for name, nodes in sets.items() if name not in bodies})


def sets_of_elements(mesh):
    """Return a mesh whose surfaces are sets of elements, as in Abaqus' files."""
    sets = {name: [np.flatnonzero(own == tag) if block.dim == dim else np.zeros(0, dtype=int)
                   for block, own in zip(mesh.cells, mesh.cell_data["gmsh:physical"], strict=True)]
            for name, (tag, dim) in mesh.field_data.items()}
    return meshio.Mesh(mesh.points, mesh.cells, cell_sets=sets)


def families(mesh):
    """Return a mesh as Salome writes it: cells of one kind in one block, sets by name for their families."""
    merged = {}
    for block, own in zip(mesh.cells, mesh.cell_data["gmsh:physical"], strict=True):
        merged.setdefault(block.type, []).append((block.data, -np.asarray(own)))
    made = meshio.Mesh(mesh.points, [(kind, np.vstack([cells for cells, _ in own])) for kind, own in merged.items()],
                       cell_data={"cell_tags": [np.concatenate([tags for _, tags in own]) for own in merged.values()]})
    made.cell_tags = {-int(tag): [name] for name, (tag, _) in mesh.field_data.items()}
    return made


def numbered(mesh):
    """Return a mesh whose groups have numbers alone."""
    return meshio.Mesh(mesh.points, mesh.cells, cell_data={"gmsh:physical": mesh.cell_data["gmsh:physical"]})


@pytest.mark.parametrize(("ending", "change", "groups", "recombine"), [
    ("inp", sets_of_nodes, NAMES, False), ("inp", sets_of_nodes, NAMES, True), ("inp", sets_of_elements, NAMES, False),
    ("med", families, NAMES, True), ("vtu", numbered, ("1", "3", "5"), False)])
def test_any_format_holds_the_same_bodies(tmp_path, ending, change, groups, recombine):
    from fretflow.structure.bodies import Material

    path = blocks(tmp_path / "two.msh", (7, 3), (5, 2), recombine=recombine)
    other = tmp_path / f"two.{ending}"
    with contextlib.redirect_stdout(None):
        meshio.write(other, change(meshio.read(path)))
    rubber = Material(youngs_modulus=1e8, poissons_ratio=0.4, density=1e3)
    own = assembled(path, materials={"pad": rubber})
    matrices = assembled(other, interface=groups[:2], materials={groups[2]: rubber})
    assert matrices.size == own.size
    assert np.sort(matrices.stiffness.diagonal()) == pytest.approx(np.sort(own.stiffness.diagonal()), rel=1e-9)
    assert np.sort(matrices.areas) == pytest.approx(np.sort(own.areas), rel=1e-9)
    place = [np.lexsort(np.round(one.points, 9).T) for one in (own, matrices)]
    assert matrices.points[place[1]] == pytest.approx(own.points[place[0]], abs=1e-12)


@pytest.mark.parametrize(("name", "text", "told"), [
    ("two.foo", "", "is of no known format"), ("two.inp", "*NODE\n1, 2, x\n", "meshio cannot read it"),
    ("two.vtu", "<VTKFile", "meshio cannot read it"), ("two.med", "no HDF5", "meshio cannot read it")])
def test_a_file_that_is_no_mesh_is_one_line(tmp_path, name, text, told, capfd):
    (tmp_path / name).write_text(text)
    with pytest.raises(MeshError, match=rf"{name}: {told}.*; (save|write) the mesh"):
        assembled(tmp_path / name)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("name", "text"), [
    ("two.inp", "*Include, input={}\n"), ("two.inp", " * IN*CLUDE,INPUT={}\n"),
    ("two.xdmf", '<Xdmf><DataItem Format="HDF" Dimensions="3 3">{}:/x</DataItem></Xdmf>'),
    ("two.xdmf", "<Xdmf><DataItem Format = 'Binary'>{}</DataItem></Xdmf>"), ("two.node", "# {}\n")])
def test_a_mesh_that_lies_in_several_files_is_refused(tmp_path, name, text):
    """Another file would be read unasked, and what is kept of the mesh not be made anew when that changes."""
    with contextlib.redirect_stdout(None):
        meshio.write(tmp_path / "other.inp", sets_of_nodes(meshio.read(blocks(tmp_path / "two.msh", (5, 2), (4, 2)))))
    (tmp_path / name).write_text(text.format(tmp_path / "other.inp"))
    with pytest.raises(MeshError, match=rf"{name}: a part of it lies in another file; save the mesh as one file"):
        assembled(tmp_path / name)


def test_a_mesh_in_hdf5_that_links_to_another_file_is_refused(tmp_path):
    with contextlib.redirect_stdout(None):
        meshio.write(tmp_path / "two.med", families(meshio.read(blocks(tmp_path / "two.msh", (5, 2), (4, 2)))))
    with h5py.File(tmp_path / "linked.med", "w") as file:
        for name in ("ENS_MAA", "INFOS_GENERALES", "FAS"):
            file[name] = h5py.ExternalLink("two.med", name)
    with pytest.raises(MeshError, match=r"linked.med: .* is a link or lies in another file"):
        assembled(tmp_path / "linked.med")


def in_millimetres(path, other):
    """Write a mesh again with coordinates in mm."""
    mesh = meshio.read(path)
    mesh.points = 1e3 * mesh.points
    meshio.write(other, sets_of_nodes(mesh))
    return other


def test_a_mesh_may_count_in_millimetres(tmp_path):
    path = blocks(tmp_path / "two.msh", (5, 2), (4, 2), lift=20e-6)
    other = in_millimetres(path, tmp_path / "two.inp")
    own, matrices = assembled(path), assembled(other, unit=1e-3)
    assert np.sort(matrices.stiffness.diagonal()) == pytest.approx(np.sort(own.stiffness.diagonal()), rel=1e-9)
    assert matrices.gap == pytest.approx(20e-6, rel=1e-6)
    with pytest.raises(MeshError, match=r'are 34.67 m large; where .* give unit = 1e-3, in files mesh_unit = "1 mm"'):
        assembled(other)
    with pytest.raises(InputError, match=r"unit: 0 m is no length"):
        assembled(other, unit=0)


def test_a_file_tells_unit_and_materials(tmp_path):
    from fretflow.case.bolted import Elasticity, JoinedBodies
    from fretflow.structure.bodies import Material
    from fretflow.structure.meshed import assembled_bodies

    path = blocks(tmp_path / "two.msh", (5, 2), (4, 2))
    own = JoinedBodies.model_validate({
        "interfaces": [{"upper": "upper", "lower": "lower"}], "mesh_unit": "1 mm",
        "materials": {"pad": {"youngs_modulus": "114 GPa", "poissons_ratio": 0.34, "density": "4430 kg/m^3"}}})
    steel = Elasticity.model_validate({"youngs_modulus": "210 GPa", "poissons_ratio": 0.0, "density": "7800 kg/m^3"})
    matrices = assembled_bodies(in_millimetres(path, tmp_path / "two.inp"), own, steel, [])
    expected = assembled(path, materials={"pad": Material(youngs_modulus=114e9, poissons_ratio=0.34, density=4430.0)})
    assert np.sort(matrices.stiffness.diagonal()) == pytest.approx(np.sort(expected.stiffness.diagonal()), rel=1e-9)
    assert np.sort(matrices.mass.diagonal()) == pytest.approx(np.sort(expected.mass.diagonal()), rel=1e-9)


def test_a_facet_is_in_one_set(tmp_path):
    mesh = sets_of_nodes(meshio.read(blocks(tmp_path / "two.msh", (5, 2), (4, 2))))
    mesh.point_sets["again"] = mesh.point_sets["upper"]
    meshio.write(tmp_path / "two.inp", mesh)
    with pytest.raises(MeshError, match=r"two\.inp: a facet is in 'upper' and in 'again'"):
        assembled(tmp_path / "two.inp")


def test_facets_that_no_element_has_are_refused(tmp_path):
    """Dolfinx does not survive them."""
    mesh = meshio.read(blocks(tmp_path / "two.msh", (5, 2), (4, 2)))
    solids = [block for block in mesh.cells if block.dim == 3]
    loose = meshio.Mesh(mesh.points, [*solids, ("triangle", np.array([[0, 5, 9], [1, 4, 12]]))], cell_data={
        "gmsh:physical": [*(np.full(len(one.data), 2) for one in solids), np.array([1, 1])]},
        field_data={"upper": np.array([1, 2])})
    meshio.write(tmp_path / "loose.vtu", loose)
    with pytest.raises(MeshError, match=r"2 of 2 facets of '1' are faces of no element"):
        assembled(tmp_path / "loose.vtu", interface=("1", "1"))
