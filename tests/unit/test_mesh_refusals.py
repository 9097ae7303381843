"""What cannot be used is refused with one line that names the file or field and the way out.

A sound mesh of the user's passes, so that each refusal is due to the one thing that was spoilt.
"""

import signal
import subprocess
import sys
from dataclasses import replace

import gmsh
import numpy as np
import pytest
from fretflow.case import config
from fretflow.core.errors import MeshError
from fretflow.core.files import CASE
from fretflow_meshes import run_mesh
from fretflow_meshes.gmsh_files import gmsh_session, read_mesh, write_mesh
from fretflow_meshes.hexmesh import specimen_mesh, turned_over
from fretflow_meshes.specimen import Side, build_specimen, check_matching, read_specimen, sorted_nodes

SPECIMEN = config.Specimen()
MESH = config.Mesh(contact_elements=3)


def write_block(path, version=4.1, unit=1e-3, order=1, groups=("contact", "clamped", "body"), recombine=True,
                z=0.0):
    """Write a 1 x 1 x 2 mm block made in gmsh's own kernel, as a user would, with tags of his own."""
    with gmsh_session(path):
        gmsh.model.geo.addPoint(-0.5 * unit, -0.5 * unit, z, tag=1)
        line = gmsh.model.geo.extrude([(0, 1)], unit, 0.0, 0.0, [4], recombine=recombine)[1]
        face = gmsh.model.geo.extrude([line], 0.0, unit, 0.0, [3], recombine=recombine)[1]
        top, body, *_ = gmsh.model.geo.extrude([face], 0.0, 0.0, 2.0 * unit, [5], recombine=recombine)
        gmsh.model.geo.synchronize()
        for tag, name, (dim, entity) in zip((11, 12, 13), groups, (face, top, body), strict=True):
            gmsh.model.setPhysicalName(dim, gmsh.model.addPhysicalGroup(dim, [entity], tag), name)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(order)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", 0)
        gmsh.write(str(path))
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0)


def read_block(path, side=Side.UPPER, mesh=MESH, specimen=SPECIMEN):
    return read_specimen(path, specimen, mesh, side, path.with_name("used.msh"))


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("degree", [1, 2])
def test_a_users_mesh_is_used_as_it_is(tmp_path, version, degree):
    write_block(tmp_path / "own.msh", version, order=degree)
    summary = read_block(tmp_path / "own.msh", mesh=config.Mesh(degree=degree))
    assert (summary.file, summary.degree, summary.cells) == ("used.msh", degree, 60)
    assert summary.nodes == (4 * degree + 1) * (3 * degree + 1) * (5 * degree + 1)
    x, y = np.linspace(-0.5e-3, 0.5e-3, 4 * degree + 1), np.linspace(-0.5e-3, 0.5e-3, 3 * degree + 1)
    np.testing.assert_allclose(summary.contact_nodes, [(a, b, 0.0) for a in x for b in y], atol=1e-12)
    assert summary.min_jacobian == pytest.approx(2e-9 / 60, rel=1e-6)
    # Levels lie 0.4 mm / degree apart; of two equally near, the one closer to the interface.
    height = {1: 0.8e-3, 2: 1e-3}[degree]
    np.testing.assert_allclose(summary.observation_point, [0.0, 0.5e-3, height], atol=1e-12)
    again = read_mesh(tmp_path / "used.msh")
    assert len(again.contact) == len(again.clamped) == 12
    with gmsh_session(tmp_path / "used.msh"):
        gmsh.merge(str(tmp_path / "used.msh"))
        assert gmsh.model.getPhysicalGroups() == [(2, 1), (2, 2), (3, 3)]


def test_a_mesh_that_counts_in_millimetres_is_used_in_metres(tmp_path):
    write_block(tmp_path / "metres.msh")
    own = read_block(tmp_path / "metres.msh")
    write_block(tmp_path / "own.msh", unit=1.0)
    block = read_block(tmp_path / "own.msh", mesh=MESH.model_copy(update={"unit": 1e-3}))
    np.testing.assert_allclose(block.contact_nodes, own.contact_nodes, atol=1e-15)
    assert block.min_jacobian == pytest.approx(own.min_jacobian, rel=1e-9)
    np.testing.assert_allclose(read_mesh(tmp_path / "used.msh").points.max(axis=0), [5e-4, 5e-4, 2e-3], rtol=1e-12)


def test_our_own_mesh_passes_as_a_users_mesh(tmp_path):
    for side in Side:
        built = build_specimen(SPECIMEN, MESH, side, tmp_path / "own.msh")
        read = read_block(tmp_path / "own.msh", side)
        np.testing.assert_array_equal(read.contact_nodes, built.contact_nodes)
        np.testing.assert_array_equal(read.observation_point, built.observation_point)
        assert (read.nodes, read.cells, read.min_jacobian) == (built.nodes, built.cells, built.min_jacobian)


@pytest.mark.parametrize(("spoil", "message"), [
    ({"groups": ("contact", "base", "body")},
     r"lacks the physical surface 'clamped' \(it has: base, body, contact\)"),
    ({"groups": ("contact", "clamped", "contact")}, r"lacks the physical volume 'body'"),
    ({"recombine": False}, r"body holds Tetrahedron 4; it must hold .*Hexahedron 27 only; .*SubdivisionAlgorithm"),
    ({"order": 2}, r"degree 2; set mesh.degree = 2"),
    ({"order": 3}, r"group body holds Hexahedron 64"),
    ({"unit": 1.0}, r"is 2 m large; where it counts in millimetres give mesh.unit"),
    ({"unit": 1e-6}, r"is 2e-06 m large"),
    ({"z": 3e-6}, r"nodes of group contact lie up to 3 µm from the plane z = 0"),
    ({"groups": ("clamped", "contact", "body")}, r"lie up to 2000 µm from the plane z = 0"),
])
def test_spoilt_blocks(tmp_path, spoil, message):
    write_block(tmp_path / "own.msh", **spoil)
    with pytest.raises(MeshError, match=rf"own\.msh: .*{message}") as caught:
        read_block(tmp_path / "own.msh")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "used.msh").exists()


def test_a_specimen_on_the_wrong_side(tmp_path):
    write_block(tmp_path / "own.msh")
    with pytest.raises(MeshError, match="on the other side of z = 0; the lower specimen lies in z < 0"):
        read_block(tmp_path / "own.msh", Side.LOWER)


def spoilt(change):
    """Return the sound mesh with a changed copy of its arrays."""
    mesh = specimen_mesh(SPECIMEN, MESH)
    arrays = {name: np.array(getattr(mesh, name)) for name in ("points", "cells", "contact", "clamped")}
    return replace(mesh, **change(**arrays))


def moved_node(points, **_):
    node = np.argmin(np.linalg.norm(points - [1e-3, 1e-3, 4e-3], axis=1))
    points[node, 2] += 3e-3
    return {"points": points}


def left_handed(cells, **_):
    return {"cells": cells[:, [4, 5, 6, 7, 0, 1, 2, 3]]}


def inner_face(cells, contact, points, **_):
    contact[0] = cells[np.argmax(points[cells][:, :, 2].mean(axis=1) > 3e-3)][:4]
    points[contact[0], 2] = 0.0
    return {"contact": contact, "points": points}


def torn_body(points, cells, clamped, **_):
    top = points[cells][:, :, 2].mean(axis=1) > 3e-3
    copy = np.concatenate((points, points))
    cells[top] += len(points)
    return {"points": copy, "cells": cells, "clamped": clamped + len(points)}


@pytest.mark.parametrize(("change", "message"), [
    (moved_node, r"[48] of \d+ cells are inverted or flat, the worst at \([\d.]+, [\d.]+, [\d.]+\) mm"),
    (left_handed, r"(\d+) of \1 cells are inverted"),
    (inner_face, r"1 of 9 elements of group contact are no outer faces of the body"),
    (torn_body, r"the body falls into 2 parts that share no nodes"),
])
def test_spoilt_specimens(tmp_path, change, message):
    write_mesh(spoilt(change), tmp_path / "own.msh")
    with pytest.raises(MeshError, match=message):
        read_block(tmp_path / "own.msh")


def test_the_position_of_an_inverted_element_is_named(tmp_path):
    write_mesh(turned_over(spoilt(moved_node)), tmp_path / "own.msh")
    with pytest.raises(MeshError, match="inverted") as caught:
        read_block(tmp_path / "own.msh", Side.LOWER)
    x, y, z = (float(c) for c in str(caught.value).split("(")[1].split(")")[0].split(","))
    assert np.linalg.norm([x - 1.0, y - 1.0, z + 4.0]) < 2.5


def test_files_that_are_no_meshes(tmp_path):
    sound = tmp_path / "sound.msh"
    build_specimen(SPECIMEN, MESH, Side.UPPER, sound)
    data = sound.read_bytes()
    for length in (0, 5, 200, len(data) // 3, len(data) // 2, len(data) - 50):
        (tmp_path / "cut.msh").write_bytes(data[:length])
        with pytest.raises(MeshError, match=r"cut\.msh: "):
            read_block(tmp_path / "cut.msh")
    with pytest.raises(MeshError, match=r"none\.msh: cannot be read \(No such file"):
        read_block(tmp_path / "none.msh")
    marker = tmp_path / "ran"
    (tmp_path / "script.msh").write_text(f'SystemCall "touch {marker}";\n')
    with pytest.raises(MeshError, match=r"script\.msh: is no \.msh file"):
        read_block(tmp_path / "script.msh")
    assert not marker.exists()


def test_a_folder_that_cannot_be_written(tmp_path):
    with pytest.raises(MeshError, match=r"give a readable \.msh file and a writable folder"):
        build_specimen(SPECIMEN, MESH, Side.UPPER, tmp_path / "missing" / "a.msh")


def test_faces_that_do_not_match(tmp_path):
    upper = build_specimen(SPECIMEN, MESH, Side.UPPER, tmp_path / "upper.msh")
    finer = build_specimen(SPECIMEN, config.Mesh(contact_elements=4), Side.LOWER, tmp_path / "lower.msh")
    with pytest.raises(MeshError, match=r"upper\.msh, lower\.msh: 16 and 25 contact nodes do not match"):
        check_matching(upper, finer)
    nodes = np.array(upper.contact_nodes)
    nodes[6] += (0.0, -2e-6, 0.0)
    with pytest.raises(MeshError, match=r"up to 2 µm apart, most at \(-0.1667, 0.1667\) mm; mesh both"):
        check_matching(upper, replace(upper, file="lower.msh", contact_nodes=nodes))
    moved = np.array(upper.contact_nodes)
    moved[5] += (5e-5, 0.0, 0.0)  # leaves its column, so that its neighbours are sorted to other places
    with pytest.raises(MeshError, match="up to 50 µm apart"):
        check_matching(replace(upper, contact_nodes=sorted_nodes(moved)), replace(upper, file="lower.msh"))
    check_matching(upper, replace(upper, contact_nodes=upper.contact_nodes + np.array([0.0, -1e-10, 0.0])))


def test_own_meshes_that_do_not_match_end_the_stage(tmp_path):
    for side, elements in ((Side.UPPER, 3), (Side.LOWER, 3), (Side.LOWER, 4)):
        build_specimen(SPECIMEN, config.Mesh(contact_elements=elements), side, tmp_path / f"{side}{elements}.msh")
    raw = {"format": CASE, "name": "a", "test": {"excitation_amplitude": "53 N", "cycles": 1}}
    own = {"upper": str(tmp_path / "upper3.msh"), "lower": str(tmp_path / "lower3.msh")}
    upper, lower = run_mesh(config.validate_case({**raw, "mesh": own}), tmp_path)
    np.testing.assert_allclose(upper.contact_nodes, lower.contact_nodes, atol=1e-12)
    own["lower"] = str(tmp_path / "lower4.msh")
    with pytest.raises(MeshError, match="16 and 25 contact nodes do not match"):
        run_mesh(config.validate_case({**raw, "mesh": own}), tmp_path)


@pytest.mark.parametrize(("side", "face"), [(Side.UPPER, "crowned"), (Side.LOWER, "cylindrical")])
def test_a_face_too_curved_for_its_ridge(tmp_path, side, face):
    squared = 0.5 if face == "crowned" else 0.25  # mm2, at the corner or the edge
    limit = squared / (2.0 * 0.05)  # mm: the profile there is 5 % of the ridge's 1 mm
    for radius, sound in ((1.001 * limit, True), (0.999 * limit, False)):
        shape = config.Specimen(face=face, face_radius=f"{radius} mm")
        if sound:
            build_specimen(shape, MESH, side, tmp_path / "a.msh")
        else:
            with pytest.raises(MeshError, match=rf"specimen\.{side}\.face_radius: .*at least {limit:.4g} mm"):
                build_specimen(shape, MESH, side, tmp_path / "a.msh")


def test_a_mesh_beyond_any_memory():
    with pytest.raises(MeshError, match=r"mesh\.contact_elements = 200 with growth = 1 and degree = 2"):
        specimen_mesh(SPECIMEN, config.Mesh(contact_elements=200, degree=2, growth=1.0))


def test_the_interrupt_key_stays_the_callers(tmp_path):
    def handler(number, frame):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, handler)
    try:
        build_specimen(SPECIMEN, MESH, Side.UPPER, tmp_path / "a.msh")
        assert signal.getsignal(signal.SIGINT) is handler
        with pytest.raises(MeshError):
            read_mesh(tmp_path / "none.msh")
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_interrupt_reaches_the_caller_while_gmsh_works():
    """In a process of its own, as gmsh takes the key when it is imported; the process ended, and nothing was said."""
    ran = subprocess.run([sys.executable, "-c", """if True:
        import signal
        from pathlib import Path
        from fretflow_meshes.gmsh_files import gmsh_session
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            with gmsh_session(Path("a.msh")):
                signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            print("told")
        """], capture_output=True, text=True, timeout=60)
    assert (ran.returncode, ran.stdout) == (0, "told\n")


def test_a_gmsh_in_use_is_left_as_it_was(tmp_path, capfd):
    with gmsh_session(tmp_path / "outer.msh"):
        gmsh.model.geo.addPoint(1.0, 2.0, 3.0, tag=7)
        gmsh.model.geo.synchronize()
        build_specimen(SPECIMEN, MESH, Side.UPPER, tmp_path / "a.msh")
        assert gmsh.model.getEntities() == [(0, 7)]
    assert capfd.readouterr() == ("", "")
