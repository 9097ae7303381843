"""The way from a meshed specimen to its reduced matrices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.case import config
from fretflow.core.errors import InputError, MeshError
from fretflow.core.specimen_mesh import MeshSummary
from fretflow.structure.fem.elasticity import ElasticBody, assemble
from fretflow.structure.fem.mesh_file import on_root, read_mesh
from fretflow.structure.reduction.craig_bampton import ComponentModes, audit, clamped_frequencies
from fretflow.structure.reduction.modes import component_modes, natural_modes
from fretflow.structure.reduction.reduced_specimen import MATCH, ModeShapes, ReducedSpecimen


def reduce_specimen(mesh_path: Path, summary: MeshSummary, specimen: config.Specimen,
                    reduction: config.Reduction, degree: int, comm: Any
                    ) -> tuple[ReducedSpecimen, ModeShapes] | None:
    """Assemble the specimen meshed in `mesh_path`, reduce it and compare it with the full model.

    Collective over the MPI communicator `comm`.

    Parameters
    ----------
    mesh_path : Path
        The mesh, in metres, with the groups ``contact``, ``clamped`` and ``body``.
    summary : MeshSummary
        What the mesh stage said of that file; its contact nodes must be found again.
    specimen : config.Specimen
        Material.
    reduction : config.Reduction
        Numbers of modes and of checked frequencies, Rayleigh damping.
    degree : int
        Degree of the displacement, 1 or 2.
    comm : mpi4py communicator
        The ranks that share the work.

    Returns
    -------
    (ReducedSpecimen, ModeShapes) or None
        And the natural modes that it was compared with; on rank 0, None on the other ranks.

    Raises
    ------
    InputError
        If the degree is not 1 or 2.
    MeshError
        If the mesh cannot be used or does not fit `summary`.
    NonConvergenceError
        If an eigensolver fails.
    AuditError
        If the reduced body violates a law that it must satisfy.
    """
    if degree not in (1, 2):
        raise InputError(f"mesh.degree: {degree} is not an element degree; give 1 or 2")
    body = assemble(read_mesh(mesh_path, comm), specimen, degree)
    try:
        _check_contact(body, summary, mesh_path)
        observation, point = body.nearest_inner_node(summary.observation_point)
        modes = component_modes(body, observation, reduction.fixed_interface_modes)
        shapes = natural_modes(body, reduction.checked_frequencies)
    finally:
        body.destroy()

    def build() -> tuple[ReducedSpecimen, ModeShapes] | None:
        if modes is None or shapes is None:
            return None
        reduced = _specimen(body, modes, summary, reduction, point, shapes.frequency)
        audit(reduced, body.clamped.centroid, body.total_mass)
        return reduced, shapes

    return on_root(comm, build)


def _check_contact(body: ElasticBody, summary: MeshSummary, mesh_path: Path) -> None:
    """Check that the contact nodes of the mesh are those that the mesh stage reported."""
    points, reported = body.contact.points, summary.contact_nodes
    if points.shape != reported.shape:
        raise MeshError(f"{mesh_path}: {len(points)} contact nodes at this degree, but its summary tells "
                        f"{len(reported)}; make the mesh again with this degree")
    width = float(np.ptp(points, axis=0).max())
    if np.abs(points - reported).max() > MATCH * width:
        raise MeshError(f"{mesh_path}: its contact nodes are not those of its summary; make the mesh again")


def _specimen(body: ElasticBody, modes: ComponentModes, summary: MeshSummary, reduction: config.Reduction,
              point: NDArray[np.float64], checked: NDArray[np.float64]) -> ReducedSpecimen:
    return ReducedSpecimen(
        stiffness=modes.stiffness, mass=modes.mass, contact_nodes=body.contact.points,
        contact_areas=body.contact.areas, profile=summary.profile, observation_point=point,
        fixed_interface_frequencies=modes.modal_frequencies, full_frequencies=checked,
        reduced_frequencies=clamped_frequencies(modes, 3 * len(body.contact.nodes), len(checked)),
        rayleigh_mass=reduction.rayleigh_mass, rayleigh_stiffness=reduction.rayleigh_stiffness,
        full_dofs=body.full_dofs)
