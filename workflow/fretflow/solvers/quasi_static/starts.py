"""Where Newton starts: from one element, a backbone, a contact that sticks, or where the joint settles in time.

A period of any structure is a fixed point of the map from one period to the next, which friction and dashpots contract.
A few periods of time integration therefore lead to where Newton converges, from however far, and tell where there is no
period to find (T. J. Aprille and T. N. Trick, Proc. IEEE 60 (1972) 108-114; A. H. Nayfeh and B. Balachandran, Applied
Nonlinear Dynamics (1995), chapter 6).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fretflow.core.errors import NonConvergenceError
from fretflow.solvers.fourier import analysis_matrix, time_derivative
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.backbone import Backbone, find_arm
from fretflow.solvers.quasi_static.internal import InternalEquations
from fretflow.solvers.quasi_static.jenkins_start import jenkins_arm_motion, jenkins_rig_motion
from fretflow.solvers.quasi_static.march import ContactMarch
from fretflow.solvers.quasi_static.newton import InitialGuess, InternalNewton, Iterate
from fretflow.solvers.quasi_static.patches import Patches
from fretflow.solvers.quasi_static.sample import Array, SampleState
from fretflow.solvers.time_integration import AtInstant, begin, march_periods
from fretflow.structure.two_mass_rig.lumped import LumpedRig

STEP_ANGLE = 0.15  # of the fastest oscillation, in a first guess marched with further forces
SETTLED_ANGLE = 0.3  # of it, in steps of the joint's own motion after that, which stretch it by a twelfth of the square
SETTLING = (4, 8, 16, 32, 64)  # periods marched in time before Newton is tried,
UNSETTLED = 16  # and until so many only where the last one differs little from that before
REPEATING = 0.01  # change from period to period of a motion that settles
STEPS = 128  # of such a period: a start needs no more
PATCHED = 1e-4  # residual of a start on patches, a tenth of what those leave of the joint itself
MOST_STEPS = 60  # of Newton there


class Settled(NamedTuple):
    """A start, the contact before it, the periods marched so far and how much the last one differs from that before.

    The change is that of the internal coordinates at most, relative to their largest peak-to-peak.
    """

    start: InitialGuess
    contact: SampleState
    periods: int
    change: float


def settled_starts(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch,
                   near: AtInstant | None, ringing: bool = True) -> Iterator[Settled]:
    """March the joint in time from phase zero `near` by, else from its motion on a contact that sticks; yield at times.

    A motion that settles soon, or that leaves beyond a fold for another one, grows or shrinks from period to period.
    Unless it is asked for, one of `ringing` that does neither ends soon, and is yielded only where it repeats itself.

    Raises
    ------
    NonConvergenceError
        If the contact of a time step is not found.
    """
    now = _stuck_motion(problem, equations, march) if near is None else near
    last, analysis = None, analysis_matrix(min(len(equations.analysis) // 2, (STEPS - 1) // 2), STEPS)
    ranges: list[float] = []
    for count, (internal, contact) in enumerate(march_periods(problem, now, STEPS), start=1):
        change = np.inf if last is None else float(np.abs(internal - last).max() / np.ptp(internal, axis=0).max())
        if count in SETTLING and (change < REPEATING or (ringing and count >= UNSETTLED)):
            coefficients = np.zeros((len(equations.analysis), internal.shape[1]))
            coefficients[:len(analysis)] = analysis @ internal
            yield Settled(_guess(equations, coefficients), contact, count, change)
        ranges.append(float(np.ptp(internal, axis=0).max()))
        if count >= SETTLING[-1] or (count == SETTLING[0] and not ringing and len(set(np.sign(np.diff(ranges)))) > 1):
            return
        last = internal


def _stuck_motion(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch) -> AtInstant:
    """Return the structure at phase zero of its motion on a contact that sticks."""
    seen = stuck_start(equations, march).seen
    return instant_of(problem, equations.whole_motion(seen, equations.free_other(seen)),
                      march.preloaded(problem.preload.frictional))


def instant_of(problem: PeriodicProblem, motion: Array, contact: SampleState) -> AtInstant:
    """Return phase zero of the `motion` (N, d) of all coordinates, m, with the contact there or shortly before."""
    return begin(problem, np.array([motion[0], time_derivative(motion, problem.omega)[0]]), contact)


def marched_starts(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch
                   ) -> Iterator[tuple[InitialGuess, SampleState]]:
    """Make the starts of a rig under further forces, and the contact before each.

    They are its motion in time on one Jenkins element, and that of the joint itself some periods after it.
    """
    rig = problem.boundary.internal
    if not (problem.boundary.forces and isinstance(rig, LumpedRig)):
        return
    motion, contact = _marched(problem, rig, march, len(equations.synthesis)), march.preloaded(
        problem.preload.frictional)
    now, harmonics = instant_of(problem, motion, contact), len(equations.analysis) // 2
    yield _guess(equations, equations.analysis @ motion), contact
    steps = max(STEPS, int(fastest_frequency(rig, march) / (problem.frequency * SETTLED_ANGLE)))
    analysis = analysis_matrix(harmonics, max(steps, 2 * harmonics + 1))
    with suppress(NonConvergenceError):  # of the contact in a time step
        for count, (internal, before) in enumerate(march_periods(problem, now, analysis.shape[1]), start=1):
            if count in SETTLING:
                yield _guess(equations, analysis @ internal), before
            if count >= SETTLING[1]:
                return


def _guess(equations: InternalEquations, coefficients: Array) -> InitialGuess:
    """Return the coefficients (2 H + 1, d) of all coordinates as a start."""
    return InitialGuess(coefficients[:, equations.seen].ravel(), coefficients[:, equations.other].ravel())


def cold_starts(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch
                 ) -> Iterator[InitialGuess]:
    """Make the starts that need no neighbouring period."""
    rig, one = problem.boundary.internal, len(equations.seen) == 1
    if one and isinstance(rig, LumpedRig):
        yield _first_start(problem, equations, march, rig)
    else:
        yield stuck_start(equations, march)
        yield InitialGuess(np.zeros_like(equations.load))


def stuck_start(equations: InternalEquations, march: ContactMarch) -> InitialGuess:
    """Return the linear motion on a contact that sticks, with its tangent."""
    stuck = -np.kron(np.eye(len(equations.analysis)), march.system.felt_stiffness)
    return InitialGuess(np.linalg.solve(equations.impedance - stuck, equations.load), tangent=stuck)


def _first_start(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch, rig: LumpedRig
                 ) -> InitialGuess:
    """Return the motion of a joint of patches where nodes are many, else that on the contact's backbone."""
    with suppress(NonConvergenceError):
        if (on_patches := _patches_newton(problem, equations, march)) is not None:
            newton, pressed = on_patches
            root, _ = newton.solve(iter([_backbone_start(problem, equations, newton.march, rig)]), pressed, MOST_STEPS)
            return InitialGuess(root.seen, tangent=newton.tangent(root))
    return _backbone_start(problem, equations, march, rig)


def corrected_on_patches(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch, near: Iterate
                         ) -> InitialGuess | None:
    """Return where a joint of patches goes from an iterate that is marched, with its tangent; None with few nodes.

    What the patches miss of the contact's force there is added to theirs (full approximation scheme: A. Brandt, Math.
    Comp. 31 (1977) 333-390): they are a model of what the force changes by.
    """
    with suppress(NonConvergenceError):
        if (on_patches := _patches_newton(problem, equations, march)) is not None:
            newton, pressed = on_patches
            own = newton.best(iter([InitialGuess(near.seen)]), pressed)
            missed = replace(equations, load=equations.load + near.felt - own.felt)
            newton = InternalNewton(missed, newton.march, PATCHED * near.norm)
            root, _ = newton.solve(iter([InitialGuess(near.seen, tangent=newton.tangent(own))]), pressed, MOST_STEPS)
            return InitialGuess(root.seen, near.balance.other, near.history, newton.tangent(root))
    return None


def _patches_newton(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch
                    ) -> tuple[InternalNewton, SampleState] | None:
    """Return Newton for the joint of patches of the faces, and these pressed; None where nodes are too few."""
    patches = Patches.of(problem.interface)
    if patches is None:
        return None
    joint = patches.joint(march)
    return InternalNewton(equations, joint, PATCHED), joint.preloaded(problem.preload.frictional)


def _backbone_start(problem: PeriodicProblem, equations: InternalEquations, march: ContactMarch, rig: LumpedRig
                    ) -> InitialGuess:
    """Return the motion on the contact's backbone, with its tangent, or where that fails on a Jenkins element."""
    try:
        backbone = Backbone.of(march, march.preloaded(problem.preload.frictional))
        arm = find_arm(problem, equations, backbone)
    except NonConvergenceError:
        return InitialGuess(equations.analysis @ jenkins_arm_motion(
            rig, *_one_element(march), problem.excitation.amplitude, problem.frequency,
            len(equations.synthesis)))
    _, tangent = backbone.friction(equations.synthesis @ arm, equations.synthesis)
    return InitialGuess(arm, tangent=equations.analysis @ tangent)


def _marched(problem: PeriodicProblem, rig: LumpedRig, march: ContactMarch, samples: int) -> Array:
    """Return the motion (samples, 2) in m of block and arm on one Jenkins element, with all forces on the rig."""
    stuck, limit = _one_element(march)
    per_sample = -(-int(fastest_frequency(rig, march) / (problem.frequency * STEP_ANGLE)) // samples) or 1
    phase = 2.0 * np.pi * np.arange(samples * per_sample) / (samples * per_sample)
    drive = (problem.loads_at(phase) @ problem.boundary.input_force.T)[:, 0]
    return jenkins_rig_motion(rig, problem.boundary.forces, stuck, limit, drive.tolist(),
                              problem.frequency)[::per_sample]


def fastest_frequency(rig: LumpedRig, march: ContactMarch) -> float:
    """Return the largest natural frequency of the rig on a contact that sticks, rad/s."""
    stiffest = rig.stiffness + np.diag([0.0, _one_element(march)[0]])
    return float(np.sqrt(np.max(np.abs(np.linalg.eigvals(np.linalg.solve(rig.mass, stiffest))))))


def _one_element(march: ContactMarch) -> tuple[float, float]:
    """Return the stiffness (N/m) of the stuck contact and the limit (N) of the whole."""
    system = march.system
    return float(system.felt_stiffness[0, 0]), float(system.friction.mean()) * system.load
