"""A structure on a coarser mesh of its faces: of given matrices no finer one is at hand.

Contact acts at about half of the points, in a row, or a quarter, in a plane. The others follow at rest, as all inertia
of the contact is dropped (`structure.reduction.contact_modes`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from fretflow.core.records import Array
from fretflow.experiments.structure.points import errors_like
from fretflow.structure.reduction.contact_modes import ReducedStructure, assembled

Indices = NDArray[np.int64]


def coarser(structure: ReducedStructure) -> ReducedStructure | None:
    """Return a structure whose contact points are twice as far apart; None if they are no mesh of faces.

    All may be at one place, or sliders side by side: in faces the other points take up what those left out held of the
    bolts' load.
    """
    kept = sparser(structure.points)
    if len(kept) == structure.contacts:
        return None
    fewer = thinned(structure, kept)
    if structure.preload is not None and fewer.preload is not None:
        held, before, after = (np.abs(own.sum()) for own in (
            structure.preload[0][2::3][kept], structure.preload[0][2::3], fewer.preload[0][2::3]))
        if after - held < before - after:
            return None
    return fewer


def sparser(points: Array) -> Indices:
    """Return which of `points` (m, 3) are left if they are twice as far apart: both ends, and from one of them on.

    Points at one place are one.
    """
    places, own = np.unique(points, axis=0, return_inverse=True)
    if len(places) < 2:
        return np.arange(len(points))
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    kept = [int(one) for one in np.unravel_index(int(np.argmax(apart)), apart.shape)]
    near = np.partition(apart, 1, axis=1)[:, 1]
    for place in np.argsort(apart[kept[0]], kind="stable"):
        if np.all(apart[place, kept] > 1.5 * near[place]):  # between one distance and two
            kept.append(int(place))
    return np.flatnonzero(np.isin(own.ravel(), kept))


def thinned(structure: ReducedStructure, kept: Indices) -> ReducedStructure:
    """Return a structure whose contact acts at some of its points alone, which take the areas of those about them."""
    rest, modes = np.setdiff1d(np.arange(structure.contacts), kept), len(structure.eigenvalues)
    free, held = ((3 * own[:, None] + np.arange(3)).ravel() for own in (rest, kept))
    count, held = len(held), np.r_[held, 3 * structure.contacts + np.arange(modes)]
    k, _ = assembled(structure, massless=True)
    follows = np.linalg.solve(k[np.ix_(free, free)], k[np.ix_(free, held)])
    stiffness = k[np.ix_(held, held)] - k[np.ix_(held, free)] @ follows
    # modes that strain little, as of a soft suspension, stay: the same ones are counted on both meshes
    eigenvalues, phi = np.linalg.eigh(stiffness[count:, count:])
    psi = -phi @ ((phi.T @ stiffness[count:, :count]) / eigenvalues[:, None])

    def condensed(rows: tuple[Array, Array]) -> tuple[Array, Array]:
        on_contact, on_modes = rows
        every = np.r_[on_contact - on_modes @ structure.coupling, on_modes]  # eta is y - m u
        own = every[held] - every[free] @ follows
        return own[:count] + own[count:] @ psi, own[count:] @ phi

    apart = np.linalg.norm(structure.points[:, None] - structure.points[kept], axis=2)
    near = np.isclose(apart, apart.min(axis=1, keepdims=True))
    own = stiffness[:count, :count] + stiffness[:count, count:] @ psi
    return replace(
        structure, stiffness=0.5 * (own + own.T), boundary_mass=psi.T @ psi, eigenvalues=eigenvalues,
        coupling=phi.T @ psi, areas=structure.areas @ (near / near.sum(axis=1, keepdims=True)),
        points=structure.points[kept], gap=structure.gap[kept],
        preload=None if structure.preload is None else condensed(structure.preload),
        inputs={name: condensed(rows) for name, rows in structure.inputs.items()},
        outputs={name: condensed(rows) for name, rows in structure.outputs.items()})


def mesh_errors(place: Array, doubled: Array, spacing: float) -> Array:
    """Return modes (M, M) of what a mesh of another `spacing` of its points changes, over this one's.

    Points' areas weigh pressures like the trapezoidal rule, of second order: with r times the distance between points
    the difference is ``(r^2 - 1) / 3`` of that with twice the distance, `doubled` (M,) (L. F. Richardson, Phil. Trans.
    R. Soc. A 210 (1911) 307-357). At which of the places (P,), of each channel in turn, it lies goes with where points
    happen to be; they begin to slide one after the other, as closely as they lie on the coarser of both meshes. What
    it changes at the smallest amplitude, of the joint as the bolts close it, all others have too.
    """
    share, shorter = abs(spacing**2 - 1.0) / (2.0**2 - 1.0), max(spacing, 1.0) / 2.0
    parts = doubled.reshape(-1, len(place))
    return np.asarray(share * block_diag(*(np.column_stack([
        np.full(len(place), one[0]), errors_like(place, one - one[0], shorter)]) for one in parts)))
