"""What a periodic solver is given and what it returns.

Sign conventions: relative displacement u = upper minus lower, (x, y, z) per node; contact force f acts on the upper
node, so its z component is positive in compression, and the friction force opposes the sliding of the upper node.
The gap of a node is ``gap + u_z``; it is positive when open.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from numbers import Integral, Number, Real
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.coulomb import Coulomb
from fretflow.contact.interface import Interface, work_of_friction
from fretflow.contact.law import ContactState
from fretflow.core.errors import InputError
from fretflow.core.records import Labelled, quantity, record
from fretflow.structure.mirror import MirrorPlane, alike
from fretflow.structure.sensors import HysteresisLoop
from fretflow.structure.structure import NORMAL_LOAD, MasslessBoundary, Structure, stack_loads

Amplitudes = Mapping[str, complex]


@record
class Harmonic:
    """A force ``Re F exp(i omega t)`` at named inputs: ``Harmonic(100, {"tip": 53})``.

    `overtones` are further harmonics, ``(k, {"tip": F_k})`` with ``Re F_k exp(i k omega t)``; those of one k add up.

    Examples
    --------
    >>> import fretflow as ff
    >>> force = ff.Harmonic(100, {"tip": 53})  # Hz, N
    >>> force.amplitude, force.of_amplitude(60).amplitudes
    (53.0, {'tip': 60})
    """

    frequency: float = quantity("Hz", kw_only=False)
    amplitudes: Amplitudes = quantity("N", "by input", kw_only=False)
    overtones: tuple[tuple[int, Amplitudes], ...] = ()

    def check(self) -> None:
        """Check frequency and amplitudes.

        Raises
        ------
        InputError
            If the frequency is not positive and finite, or an amplitude is no finite number.
        """
        for order, _ in self.overtones:
            if not (isinstance(order, Integral) and order >= 0):
                raise InputError(f"excitation: overtone {order!r} must be a whole number from 0 on")
        for name, force in (pair for one in (self.amplitudes, *(own for _, own in self.overtones))
                            for pair in one.items()):
            if not (isinstance(force, Number) and np.isfinite(force)):
                raise InputError(f"excitation: {name} = {force!r} is no finite number; give it in N, without quotes")
        if not (isinstance(self.frequency, Real) and 0.0 < self.frequency < np.inf):
            raise InputError(f"excitation: frequency {self.frequency!r} must be positive and finite, Hz as a number "
                             "without quotes")

    @property
    def highest(self) -> int:
        """Return the highest harmonic that it has."""
        return max([1, *(order for order, _ in self.overtones)])

    @property
    def amplitude(self) -> float:
        """Return the norm of the amplitudes at the fundamental frequency, N: that of a single input by itself."""
        return float(np.linalg.norm([*self.amplitudes.values()]))

    def of_amplitude(self, amplitude: float) -> Harmonic:
        """Return the force with another `amplitude` in N, its overtones in proportion."""
        if len(self.amplitudes) == 1 and not self.overtones:
            return replace(self, amplitudes=dict.fromkeys(self.amplitudes, amplitude))
        if not self.amplitude > 0.0:
            raise InputError("excitation: is zero, and has no shape that another amplitude could have")
        return self.scaled(amplitude / self.amplitude)

    def scaled(self, share: float) -> Harmonic:
        """Return `share` of the force."""
        return replace(self, amplitudes=_scaled(self.amplitudes, share),
                       overtones=tuple((k, _scaled(one, share)) for k, one in self.overtones))

    def with_overtone(self, order: int, share: complex) -> Harmonic:
        """Return the force with `share` of its amplitudes added at harmonic `order`."""
        return replace(self, overtones=(*self.overtones, (order, _scaled(self.amplitudes, share))))

    def by_harmonic(self, harmonics: int) -> dict[str, NDArray[np.complex128]]:
        """Return complex amplitudes (H + 1,) in N by input; higher overtones are left out."""
        amplitudes: dict[str, NDArray[np.complex128]] = {}
        for order, one in ((1, self.amplitudes), *self.overtones):
            for name, force in one.items() if order <= harmonics else ():
                amplitudes.setdefault(name, np.zeros(harmonics + 1, dtype=complex))[order] += force
        return amplitudes

    def at_phases(self, phase: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Return the forces (N,) in N by input at phases ``omega t`` (N,)."""
        forces: dict[str, NDArray[np.float64]] = {}
        for order, one in ((1, self.amplitudes), *self.overtones):
            for name, force in one.items():
                forces[name] = forces.get(name, 0.0) + (force * np.exp(1j * order * phase)).real
        return forces


def _scaled(amplitudes: Amplitudes, share: complex) -> Amplitudes:
    return {name: share * force for name, force in amplitudes.items()}


@record
class NormalLoad:
    """A constant load that presses the faces together: ``NormalLoad(60)``.

    On a structure with an input of that name it acts there, as on the rig's arm; otherwise as a uniform pressure.

    Examples
    --------
    >>> import fretflow as ff
    >>> ff.NormalLoad(60).force  # N
    60
    """

    force: float = quantity("N", kw_only=False)
    frictional: bool = False  # whether the faces rub while it is applied, before anything moves

    def check(self) -> None:
        """Check the load.

        Raises
        ------
        InputError
            If it is negative or no finite number.
        """
        if not (isinstance(self.force, Real) and 0.0 <= self.force < np.inf):
            raise InputError(f"preload: {self.force!r} is no load that presses; give a number of newtons from 0 on")


@record
class PeriodicProblem:
    """A structure with a contact under a periodic force: everything that the period depends on, in SI.

    Examples
    --------
    >>> import fretflow as ff
    >>> problem = ff.PeriodicProblem(joint, ff.Interface(nodes, areas, gap), ff.Coulomb(0.6),  # doctest: +SKIP
    ...                              ff.Harmonic(100, {"tip": 53}), preload=ff.NormalLoad(60))
    >>> problem.vary(frequency=80.0, amplitude=75.0)  # the same under another force  # doctest: +SKIP
    """

    structure: Structure = field(kw_only=False)
    interface: Interface = field(kw_only=False)
    law: Coulomb = field(kw_only=False)
    excitation: Harmonic = field(kw_only=False)
    preload: NormalLoad = field(default=NormalLoad(0.0), kw_only=False)

    def check(self) -> None:
        """Check that the law is of this interface.

        Raises
        ------
        InputError
            If it has a friction coefficient for each of another number of nodes, or falls with a pressure whose
            reference nothing tells.
        """
        if self.law.exponent and self.law.reference_pressure is None and not self.preload.force:
            raise InputError("friction: reference_pressure is required, as there is no normal load whose mean pressure "
                             "it could be")
        if np.size(self.law.friction_coefficient) not in (1, self.interface.size):
            raise InputError(f"friction coefficient: {np.size(self.law.friction_coefficient)} values for "
                             f"{self.interface.size} contact nodes; give one, or one for each")

    def half(self, plane: MirrorPlane, structure: Structure) -> PeriodicProblem:
        """Return the problem of the nodes on one side of a plane, each with the area of those that it stands for.

        That of `structure` is a half of this one's, which all else is as symmetric as.
        """
        face, mu = self.interface, np.asarray(self.friction_coefficient)
        law = replace(self.law, friction_coefficient=mu[plane.kept]) if mu.ndim else self.law
        return replace(self, structure=structure, law=law, interface=Interface(
            face.nodes[plane.kept], plane.times * face.areas[plane.kept], face.gap[plane.kept]))

    def is_symmetric(self, plane: MirrorPlane) -> bool:
        """Tell whether areas, gaps and friction are symmetric about a plane, whatever the structure is."""
        face = self.interface
        of_nodes = face.areas, face.gap, np.broadcast_to(self.friction_coefficient, face.size)
        return all(alike(one[plane.kept], one[plane.images]) for one in of_nodes)

    @property
    def frequency(self) -> float:
        """Return the frequency of the excitation in Hz."""
        return self.excitation.frequency

    @property
    def omega(self) -> float:
        """Return the angular frequency in rad/s."""
        return 2.0 * float(np.pi) * self.frequency

    @property
    def normal_load(self) -> float:
        """Return the normal load in N."""
        return self.preload.force

    @property
    def friction_coefficient(self) -> NDArray[np.float64] | float:
        """Return the law's friction coefficient, () or (nodes,)."""
        return self.law.friction_coefficient

    @cached_property
    def nodal_law(self) -> Coulomb:
        """Return the law with every node's reference force."""
        return self.law.on(self.interface.areas, self.normal_load)

    @cached_property
    def boundary(self) -> MasslessBoundary:
        """Return the structure with a massless contact, and an input for the normal load."""
        return self.structure.massless_boundary().pressed_by(self.interface.areas)

    def loads(self, harmonics: int) -> NDArray[np.complex128]:
        """Return complex amplitudes (H + 1, i) in N by the boundary's inputs, the normal load among them."""
        named = self.excitation.by_harmonic(harmonics)
        named[NORMAL_LOAD] = named.get(NORMAL_LOAD, 0.0) + self.normal_load * np.eye(1, harmonics + 1)[0]
        return np.asarray(self.boundary.loads(named, harmonics + 1), dtype=complex)

    def loads_at(self, phase: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the loads (N, i) in N by the boundary's inputs at phases ``omega t`` (N,)."""
        named = self.excitation.at_phases(phase)
        named[NORMAL_LOAD] = named.get(NORMAL_LOAD, 0.0) + np.full(len(phase), self.normal_load)
        return np.asarray(self.boundary.loads(named, len(phase)))

    def vary(self, *, frequency: float | None = None, amplitude: float | None = None, normal_load: float | None = None,
             friction_coefficient: NDArray[np.float64] | float | None = None) -> PeriodicProblem:
        """Return the problem with other values of what is given: Hz, N of the excitation, N, 1."""
        problem = self
        if frequency is not None:
            problem = replace(problem, excitation=replace(problem.excitation, frequency=frequency))
        if amplitude is not None:
            problem = replace(problem, excitation=problem.excitation.of_amplitude(amplitude))
        if normal_load is not None:
            problem = replace(problem, preload=replace(problem.preload, force=normal_load))
        if friction_coefficient is not None:
            problem = replace(problem, law=replace(problem.law, friction_coefficient=friction_coefficient))
        return problem


def check_problem(problem: PeriodicProblem, harmonics: int) -> None:
    """Check that a problem's parts fit each other, and that so many harmonics hold its excitation.

    Raises
    ------
    InputError
        Naming the part.
    """
    nodes = problem.structure.massless_boundary().nodes
    if problem.interface.size != nodes:
        raise InputError(f"interface: has {problem.interface.size} nodes, but the structure has {nodes} contact nodes")
    if problem.excitation.highest > harmonics:
        raise InputError(f"excitation: its overtone of order {problem.excitation.highest} is above harmonics = "
                         f"{harmonics}; give as many or more")


def refuse_unknown(problem: PeriodicProblem, method: str) -> None:
    """Refuse a problem with what a `method` would leave out that knows linear structures and plain friction alone.

    Raises
    ------
    InputError
        Naming what it is.
    """
    law, linear = problem.law, problem.structure.linear
    for what, known in (
            ("friction that depends on the direction", law.asymmetry == 0.0),
            ("friction that depends on the motion", not law.motion_factors),
            ("a normal load that depends on the motion", linear or not (np.any(
                problem.boundary.free_coupling) or problem.boundary.curvature is not None)),
            ("further forces on the structure", linear)):
        if not known:
            raise InputError(f'{method} does not know {what}; use solver.method = "quasi-static"')


def structure_loads(problem: PeriodicProblem, harmonics: int) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return amplitudes (H + 1, i) by the structure's own inputs, and what else presses the faces, (H + 1, 3 n) N."""
    named, inputs = problem.excitation.by_harmonic(harmonics), problem.structure.inputs
    push = np.zeros((harmonics + 1, 3 * problem.interface.size), dtype=complex)
    if NORMAL_LOAD in inputs:
        named[NORMAL_LOAD] = named.get(NORMAL_LOAD, 0.0) + problem.normal_load * np.eye(1, harmonics + 1)[0]
    else:
        push[0, 2::3] = -problem.normal_load * problem.interface.areas / problem.interface.areas.sum()
    return np.asarray(stack_loads(inputs, named, harmonics + 1), dtype=complex), push


@record
class PeriodicSolution:
    """One steady period on N equidistant samples, ``t_j = j T / N``.

    `error_estimate` is the relative error of the sliding distance, from a finer solution; nan when none was made.
    `tangent` is None where the solver keeps none.

    Examples
    --------
    >>> import fretflow as ff
    >>> period = ff.RunResults.of("runs/test1").periods[0]  # doctest: +SKIP
    >>> period.dissipated_energy, period.output("block").shape  # J, (N,) in m  # doctest: +SKIP
    """

    method: str
    frequency: float = quantity("Hz")
    displacement: NDArray[np.float64] = quantity("m", "(N, nodes, 3)")
    force: NDArray[np.float64] = quantity("N", "(N, nodes, 3)")
    state: NDArray[np.int8] = quantity("1", "(N, nodes)", codes=ContactState)
    internal: NDArray[np.float64] = quantity("m", "(N, d), internal coordinates of the structure")
    outputs: Mapping[str, NDArray[np.float64]] = quantity("m", "by name, (N,) or (N, k)")
    friction_force: NDArray[np.float64] = quantity("N", "(N,), x force of the upper specimen on the lower")
    residual_history: tuple[float, ...] = quantity("1", "(iterations,), relative to the excitation")
    error_estimate: float = quantity("1")
    tangent: NDArray[np.float64] | None = quantity(
        "N/m", "(n_a, n_a), of the contact's force by the harmonics of what it sees, to begin from", default=None,
        repr=False)

    @property
    def time(self) -> NDArray[np.float64]:
        """Return the time of each sample from the start of the period in s, (N,)."""
        samples = len(self.friction_force)
        return np.arange(samples) / (samples * self.frequency)

    @property
    def coordinates(self) -> dict[str, Labelled]:
        """Return what files tell the samples apart by."""
        return {"time": (("sample",), self.time, "s")}

    def half(self, plane: MirrorPlane) -> PeriodicSolution:
        """Return what it says of the nodes on one side of a plane, each with the forces of those that it stands for."""
        return replace(self, displacement=self.displacement[:, plane.kept], state=self.state[:, plane.kept],
                       force=plane.times[:, None] * self.force[:, plane.kept])

    def whole(self, plane: MirrorPlane) -> PeriodicSolution:
        """Return the solution of both sides from that of one."""
        state = np.empty((len(self.state), plane.nodes), dtype=self.state.dtype)
        state[:, plane.images] = state[:, plane.kept] = self.state
        displacement, force = (plane.whole(one.reshape(len(one), -1)).reshape(len(one), -1, 3) for one in (
            self.displacement, self.force / plane.times[:, None]))
        return replace(self, displacement=displacement, state=state, force=force)

    @property
    def slip_increments(self) -> NDArray[np.float64]:
        """Return |u_t(t_j) - u_t(t_j-1)| in m, (N, nodes), zero where a node is open at t_j."""
        tangential = self.displacement[:, :, :2]
        step = np.linalg.norm(tangential - np.roll(tangential, 1, axis=0), axis=2)
        return np.where(self.state == ContactState.SEPARATION, 0.0, step)

    @property
    def dissipated_energy(self) -> float:
        """Return the work of friction in the period, J."""
        return work_of_friction(self.displacement, self.force)

    @property
    def rig_displacement(self) -> NDArray[np.float64]:
        """Return the motion of the rig's block and arm along x, (N, 2) m."""
        return np.column_stack([self.output("block"), self.output("arm")])

    @property
    def upper_observation(self) -> NDArray[np.float64]:
        """Return the motion of the rig's upper observation node, (N, 3) m."""
        return self.output("upper")

    @property
    def lower_observation(self) -> NDArray[np.float64]:
        """Return the motion of the rig's lower observation node, (N, 3) m."""
        return self.output("lower")

    def hysteresis(self, name: str | None = None) -> HysteresisLoop:
        """Return the loop of the friction force over an output (N,), by default over the faces' mean sliding, m.

        Raises
        ------
        InputError
            If there is no such output, or nothing moves.
        """
        moved = self.displacement[:, :, 0].mean(axis=1) if name is None else self.output(name)
        return HysteresisLoop(displacement=moved if moved.ndim == 1 else moved[:, 0], force=self.friction_force)

    def output(self, name: str) -> NDArray[np.float64]:
        """Return an output, (N,) or (N, k) in m.

        Raises
        ------
        InputError
            If there is none of that name.
        """
        if name not in self.outputs:
            raise InputError(f"output {name!r}: unknown; choose one of {', '.join(self.outputs)}")
        return self.outputs[name]


class PeriodicSolver(Protocol):
    """Finds the steady period of a problem, from zero or from a neighbouring solution."""

    def solve(self, problem: PeriodicProblem, start: PeriodicSolution | None = None) -> PeriodicSolution:
        """Return the converged period.

        Raises
        ------
        NonConvergenceError
            With the residual history.
        """
        ...
