"""Bodies of a mesh, joined as a case or a recording says, as the matrices of a structure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from fretflow.case.bolted import BoltTable, Elasticity, JoinedBodies
from fretflow.core.errors import MeshError, PlatformError
from fretflow.core.isolated import call_isolated
from fretflow.structure.bodies import Bolt, Material
from fretflow.structure.matrices import StructureMatrices


def round_bolts(tables: Iterable[BoltTable]) -> list[Bolt]:
    """Return bolts with round shanks."""
    return [Bolt.round(one.head, one.nut, diameter=one.diameter, grip=one.grip, mass=one.mass or 0.0)
            for one in tables]


def assembled_bodies(mesh: Path, own: JoinedBodies, material: Elasticity, bolts: Sequence[Bolt]) -> StructureMatrices:
    """Assemble the bodies of a mesh in a process of its own, as a damaged file may take gmsh's with it.

    Raises
    ------
    MeshError
        If the file is missing or damaged, or a face is not there.
    InputError
        If a bolt or a sensor cannot be.
    """
    from fretflow.structure.fem.bodies import structure_from_mesh  # PETSc is started where it is needed

    try:
        return call_isolated(
            structure_from_mesh, mesh, Material(**material.model_dump()),
            [(one.upper, one.lower) for one in own.interfaces], bolts, own.clamped,
            {name: (one.at, one.along) for name, one in own.sensors.items()},
            unit=own.mesh_unit, materials={name: Material(**one.model_dump()) for name, one in own.materials.items()})
    except PlatformError as error:
        raise MeshError(f"{mesh}: is damaged, so that its reader breaks off in it ({error}); write the mesh anew"
                        ) from error
