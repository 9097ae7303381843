"""What solvers need of a structure: its massless boundary, its dynamic stiffness, named inputs and outputs.

The contact is massless (C. D. Monjaraz Tec, J. Gross, M. Krack, Comput. Struct. 260 (2022), massless-boundary component
mode synthesis): with internal coordinates q, loads i at named inputs and static coordinates s that are free of mass and
spring, the relative displacement u of the contact points under the contact force f on the upper ones is

    u = B q + B_s s + W i + G f,    B_s^T f = L i + E q + F q^2,    M q'' + C q' + S q = A i + N(q, q') + T f

G is the flexibility of what the internal coordinates leave out. T is B^T unless something else drives q. The free
coordinates are condensed statically: with K = G^-1, l = K B_s and k = B_s^T l,

    f = K' u - R q - R_2 q^2 - P i,    K' = K - l k^-1 l^T
    R = K' B - l k^-1 E,    R_2 = -l k^-1 F,    P = K' W - l k^-1 L
    s = k^-1 (l^T (u - B q - W i) - L i - E q - F q^2)

so that to the contact there is only one kind of surroundings: a stiffness and a pull ``R q + R_2 q^2 + P i``. A normal
load that follows the motion is another E, and F where a guide is curved. Outputs are linear in q, s, f and i.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import Array as Array
from fretflow.core.records import quantity, record
from fretflow.structure.internal_forces import InternalForce

Complex = NDArray[np.complex128]
NORMAL_LOAD = "normal load"  # the input by which the faces are pressed together


class Internal(Protocol):
    """Mass, damping and stiffness of the internal coordinates; `two_mass_rig.lumped.LumpedRig` is one."""

    @property
    def mass(self) -> Array:
        """Return M (d, d)."""
        ...

    @property
    def damping(self) -> Array:
        """Return C (d, d)."""
        ...

    @property
    def stiffness(self) -> Array:
        """Return S (d, d)."""
        ...

    def impedance(self, omega: NDArray[np.floating[Any]]) -> Complex:
        """Return ``S - omega^2 M + i omega C`` (len(omega), d, d) at angular frequencies in rad/s."""
        ...


@record
class LinearInternal:
    """Internal coordinates of given matrices (an `Internal`)."""

    mass: Array = quantity("kg", "(d, d)")
    damping: Array = quantity("N s/m", "(d, d)")
    stiffness: Array = quantity("N/m", "(d, d)")

    def impedance(self, omega: NDArray[np.floating[Any]]) -> Complex:
        """Return ``S - omega^2 M + i omega C`` (len(omega), d, d) at angular frequencies in rad/s."""
        w = np.asarray(omega, dtype=float)[:, None, None]
        return np.asarray(self.stiffness - w**2 * self.mass + 1j * w * self.damping)


@dataclass(frozen=True)
class ObservedMotion:
    """An observed motion ``y = motion q + free s + force f + load i`` of k components; None is nothing."""

    motion: Array  # (k, d)
    free: Array | None = None  # (k, s)
    force: Array | None = None  # (k, 3 n), m/N
    load: Array | None = None  # (k, i), m/N

    def of(self, q: NDArray[Any], s: NDArray[Any], f: NDArray[Any], i: NDArray[Any]) -> NDArray[Any]:
        """Return y (N, k) in m of N samples or harmonics (N, d), (N, s), (N, 3 n), (N, i)."""
        y = q @ self.motion.T
        for part, values in ((self.free, s), (self.force, f), (self.load, i)):
            if part is not None:
                y = y + values @ part.T
        return np.asarray(y)


@record
class MasslessBoundary:
    """A structure whose contact is massless; letters as in the module's text."""

    flexibility: Array = quantity("m/N", "(3 n, 3 n), G")
    bare_stiffness: Array = quantity("N/m", "(3 n, 3 n), K")
    motion: Array = quantity("1", "(3 n, d), B")
    free: Array = quantity("1", "(3 n, s), B_s")
    transfer: Array = quantity("1", "(d, 3 n), T")
    internal: Internal
    inputs: tuple[str, ...]
    input_force: Array = quantity("1", "(d, i), A")
    input_motion: Array = quantity("m/N", "(3 n, i), W")
    input_free: Array = quantity("1", "(s, i), L")
    free_coupling: Array = quantity("N/m", "(s, d), E")
    outputs: Mapping[str, ObservedMotion]
    sliding: Array = quantity("1", "(d,), motion of the moving faces along x")
    forces: tuple[InternalForce, ...] = ()
    contact_mass: Array | None = quantity("kg", "(3 n, 3 n), inertia left out, by u alone; None: unknown", default=None)
    whole_damping: Array | None = quantity(
        "N s/m", "(d + 3 n + i, the same), of q, contact forces and inputs; None: all is of q alone", default=None)
    free_curvature: Array | None = quantity("N/m2", "(s, d), F; None where it is zero", default=None)

    @property
    def nodes(self) -> int:
        """Return the number of contact nodes n."""
        return len(self.flexibility) // 3

    @property
    def size(self) -> int:
        """Return the number of internal coordinates d."""
        return len(self.transfer)

    @cached_property
    def stiffness(self) -> Array:
        """Return K' (3 n, 3 n) in N/m, semi-definite where there are free coordinates."""
        lever, series = self._free_series
        if not lever.shape[1]:
            return self.bare_stiffness
        stiffness: Array = self.bare_stiffness - lever @ np.linalg.solve(series, lever.T)
        return 0.5 * (stiffness + stiffness.T)

    @cached_property
    def coupling(self) -> Array:
        """Return R (3 n, d) in N/m."""
        return self._pull(self.motion, self.free_coupling)

    @cached_property
    def curvature(self) -> Array | None:
        """Return R_2 (3 n, d) in N/m^2; None where it is zero."""
        return None if self.free_curvature is None else self._pull(np.zeros_like(self.motion), self.free_curvature)

    @cached_property
    def input_pull(self) -> Array:
        """Return P (3 n, i)."""
        return self._pull(self.input_motion, self.input_free)

    def free_motion(self, q: Array, u: Array, i: Array) -> Array:
        """Return s (N, s) for q (N, d), u (N, 3 n) and loads (N, i)."""
        lever, series = self._free_series
        felt = (u - q @ self.motion.T - i @ self.input_motion.T) @ lever
        load = i @ self.input_free.T + q @ self.free_coupling.T
        if self.free_curvature is not None:
            load = load + q**2 @ self.free_curvature.T
        return np.asarray(np.linalg.solve(series, (felt - load).T).T)

    def observe(self, q: Array, u: Array, f: Array, i: Array) -> dict[str, Array]:
        """Return all outputs, (N,) or (N, k), of N samples of q, u, f and the loads."""
        s = self.free_motion(q, u, i)
        return {name: squeezed(output.of(q, s, f, i)) for name, output in self.outputs.items()}

    def loads(self, named: Mapping[str, NDArray[Any]], rows: int) -> NDArray[Any]:
        """Return loads (rows, i) of those given by name, (rows,) each.

        Raises
        ------
        InputError
            If there is no such input.
        """
        return stack_loads(self.inputs, named, rows)

    def pressed_by(self, areas: Array) -> MasslessBoundary:
        """Return the structure with an input `NORMAL_LOAD`; a new one is a uniform pressure that closes the faces."""
        if NORMAL_LOAD in self.inputs:
            return self
        if 3 * len(areas) != len(self.flexibility):
            raise InputError(f"interface: has {len(areas)} nodes, but the structure has {self.nodes} contact nodes")
        push = np.zeros((len(self.flexibility), 1))
        push[2::3, 0] = -areas / areas.sum()
        outputs = {name: replace(one, load=np.hstack([
            np.zeros((len(one.motion), len(self.inputs))) if one.load is None else one.load,
            np.zeros((len(one.motion), 1)) if one.force is None else one.force @ push])) for name, one
            in self.outputs.items()}
        return replace(self, inputs=(*self.inputs, NORMAL_LOAD), outputs=outputs,
                       input_force=np.hstack([self.input_force, self.transfer @ push]),
                       input_motion=np.hstack([self.input_motion, self.flexibility @ push]),
                       input_free=np.hstack([self.input_free, self.free.T @ push]))

    def part(self, nodes: NDArray[np.bool_]) -> MasslessBoundary:
        """Return the structure with the contact `nodes` (n,) alone, the others being free of force."""
        dofs = np.repeat(nodes, 3)
        flexibility = self.flexibility[np.ix_(dofs, dofs)]
        outputs = {name: one if one.force is None else replace(one, force=one.force[:, dofs])
                   for name, one in self.outputs.items()}
        return replace(self, flexibility=flexibility, bare_stiffness=np.linalg.inv(flexibility),
                       motion=self.motion[dofs], free=self.free[dofs], transfer=self.transfer[:, dofs],
                       contact_mass=None, whole_damping=None,  # of nodes free of force only with these ones' motion
                       input_motion=self.input_motion[dofs], outputs=outputs)

    def _pull(self, motion: Array, free_load: Array) -> Array:
        lever, series = self._free_series
        pull: Array = self.stiffness @ motion
        return pull - lever @ np.linalg.solve(series, free_load) if lever.shape[1] else pull

    @cached_property
    def _free_series(self) -> tuple[Array, Array]:
        lever = self.bare_stiffness @ self.free
        return lever, self.free.T @ lever


@record
class DynamicStiffness:
    """Relative dynamic stiffness at the harmonics of one frequency: ``Z_k u_k = load_k + f_k``, k = 0..H.

    f_k is the contact force on the upper nodes; complex amplitudes as in `solvers.fourier.to_complex`.
    """

    omega: float = quantity("rad/s")
    stiffness: Complex = quantity("N/m", "(H + 1, 3 n, 3 n)")
    load: Complex = quantity("N", "(H + 1, 3 n)")


class StructureMotion(Protocol):
    """Motion away from the contact; complex amplitudes per harmonic."""

    @property
    def internal(self) -> Complex:
        """Return that of the internal coordinates, (H + 1, d)."""
        ...

    @property
    def outputs(self) -> Mapping[str, Complex]:
        """Return the outputs by name, (H + 1,) or (H + 1, k) in m."""
        ...


class Structure(Protocol):
    """A structure with a contact of n nodes; x, y, z per node, node after node, z normal to the faces.

    Several interfaces, each with its own normal, are node sets of one contact.
    """

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the loads."""
        ...

    @property
    def linear(self) -> bool:
        """Return whether `dynamic_stiffness` tells all: no further forces, and a normal load that follows no motion."""
        ...

    def massless_boundary(self) -> MasslessBoundary:
        """Return the structure with a massless contact."""
        ...

    def dynamic_stiffness(self, frequency: float, loads: Complex) -> DynamicStiffness:
        """Return the relative dynamic stiffness at the harmonics of `frequency` (Hz) under loads (H + 1, i) in N."""
        ...

    def motion_amplitudes(self, frequency: float, displacement: Complex, loads: Complex) -> StructureMotion:
        """Return internal coordinates and outputs for relative displacements (H + 1, 3 n) in m."""
        ...


def stack_loads(inputs: tuple[str, ...], named: Mapping[str, NDArray[Any]], rows: int) -> NDArray[Any]:
    """Return loads (rows, i) in the order of `inputs` from those given by name, (rows,) each.

    Raises
    ------
    InputError
        If there is no such input.
    """
    loads = np.zeros((rows, len(inputs)), dtype=np.result_type(float, *(np.asarray(v).dtype for v in named.values())))
    for name, values in named.items():
        if name not in inputs:
            raise InputError(f"input {name!r}: unknown; choose one of {', '.join(inputs)}")
        loads[:, inputs.index(name)] = values
    return loads


def squeezed(values: NDArray[Any]) -> NDArray[Any]:
    """Return an output (N, k) as (N,) if it has one component."""
    return values[:, 0] if values.shape[1] == 1 else values
