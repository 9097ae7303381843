"""A nonlinear mode as a periodic motion: the extended periodic motion concept.

Damping proportional to the mass and negative, ``-2 zeta Omega M q'``, gives back what friction takes, so that the
motion of amplitude a is periodic (M. Krack, Comput. Struct. 154 (2015) 59-71). With modes y of the closed joint, of
which few are dynamic, and a massless contact that follows them at every instant (see
`structure.reduction.contact_modes`), the harmonics k of y obey ::

    (L - k^2 Omega^2 - 2 i k zeta Omega^2) Y_k = L m U_k[y]

whose row of the mode itself at k = 1 gives Omega and zeta, and whose others give the shape. They are iterated in turn,
accelerated after D. G. Anderson, J. ACM 12 (1965) 547.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.kernels.static import States
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import Array, quantity, record
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint, LinearMode, StaticHistory
from fretflow.structure.reduction.contact_modes import ReducedStructure

Complex = NDArray[np.complex128]

HARMONICS, SAMPLES = 4, 128  # of a motion
DYNAMIC = 30.0  # modes up to so many times the mode's frequency carry inertia: beyond, it changes them by 1e-3
REMEMBERED = 6  # iterates that the acceleration uses
MOST_ITERATIONS = 60


@record
class PeriodicMode:
    """A periodic motion of one amplitude, N samples of one period."""

    amplitude: float = quantity("m*kg^0.5", "of the fundamental harmonic, mass-normalised")
    frequency: float = quantity("Hz")
    damping: float = quantity("1", "of friction, and of the structure itself")
    outputs: Array = quantity("m", "(outputs,), amplitude of each output's fundamental harmonic")
    modes: Array = quantity("m*kg^0.5", "(N, modes), motion of the dynamic modes")
    history: StaticHistory
    dissipated: float = quantity("J", "by friction in a period")
    residual_history: tuple[float, ...] = quantity("1", "(iterations,), change of the motion over its amplitude")


def condensed(structure: ReducedStructure, modes: int) -> ReducedStructure:
    """Return a structure with its first `modes` dynamic and all others static."""
    def cut(rows: dict[str, tuple[Array, Array]]) -> dict[str, tuple[Array, Array]]:
        return {name: (on_contact, on_modes[:modes]) for name, (on_contact, on_modes) in rows.items()}

    preload, kept = structure.preload, slice(3 * structure.contacts + modes)
    return replace(structure, damping=None if structure.damping is None else structure.damping[kept, kept],
                   eigenvalues=structure.eigenvalues[:modes], coupling=structure.coupling[:modes],
                   preload=None if preload is None else (preload[0], preload[1][:modes]),
                   inputs=cut(dict(structure.inputs)), outputs=cut(dict(structure.outputs)))


@record
class MasslessJoint:
    """A joint whose contact follows its dynamic modes y at every instant, ``f = K u - m^T L y - bolts``."""

    joint: BoltedJoint  # with the stiffness that the contact has while y is held
    eigenvalues: Array = quantity("1/s^2", "(modes,), L")
    coupling: Array = quantity("kg^0.5", "(modes, 3 m), m")

    @classmethod
    def of(cls, joint: BoltedJoint, modes: int) -> MasslessJoint:
        """Return a joint with its first `modes` dynamic."""
        own = condensed(joint.structure, modes)
        carried = own.coupling.T @ (own.eigenvalues[:, None] * own.coupling)
        return cls(joint=replace(joint, structure=replace(own, stiffness=own.stiffness + carried)),
                   eigenvalues=own.eigenvalues, coupling=own.coupling)

    def follow(self, y: Array, start: StaticHistory, guess: States | None = None) -> StaticHistory:
        """Return the contact for motions (S, modes) of y beside what the bolts alone give, after `start`."""
        return self.joint.follow(self.joint.bolts + (y * self.eigenvalues) @ self.coupling, start, guess)

    def at_rest(self, rest: StaticHistory) -> StaticHistory:
        """Return the preloaded joint with the load that it is under while y is held."""
        return replace(rest, load=self.joint.bolts + (self.pulled(rest) * self.eigenvalues) @ self.coupling)

    def pulled(self, history: StaticHistory) -> Array:
        """Return ``m u`` (S, modes), about which y would vibrate."""
        return np.asarray(history.displacement @ self.coupling.T)


def periodic_mode(joint: BoltedJoint, mode: LinearMode, amplitude: float, harmonics: int = HARMONICS,
                  samples: int = SAMPLES, tolerance: float = 1e-6, start: PeriodicMode | None = None) -> PeriodicMode:
    """Return the periodic motion of `mode` at a modal `amplitude` (m kg^0.5); `start` is one of another amplitude.

    Raises
    ------
    InputError
        If the amplitude is not positive.
    NonConvergenceError
        If the iteration does not come to rest, with its history.
    """
    if not amplitude > 0.0:
        raise InputError(f"amplitude: must be positive, got {amplitude}; at zero the mode is linear")
    omega = 2.0 * np.pi * mode.frequency
    massless = MasslessJoint.of(joint, max(1, int(np.sum(joint.structure.eigenvalues < (DYNAMIC * omega)**2))))
    shape = (joint.structure.coupling @ mode.contact + mode.modes)[:len(massless.eigenvalues)]
    own = int(np.argmax(np.abs(shape)))
    first = np.zeros((harmonics + 1, len(shape)), dtype=complex)
    rest = joint.preloaded
    first[0] = massless.pulled(rest)[0]
    first[1] = amplitude * shape / np.linalg.norm(shape)
    before = massless.at_rest(rest)
    if start is not None:
        moved = np.fft.rfft(start.modes, axis=0)[:harmonics + 1] / len(start.modes)
        first[1:] = 2.0 * moved[1:] * amplitude / start.amplitude
        first[0] = moved[0]
    history: list[float] = []
    solve = _anderson(first)
    y = next(solve)
    for iteration in range(MOST_ITERATIONS):
        path = _synthesis(y, samples)
        if iteration == 0:  # from rest to the end of the stroke, and once round
            rise = np.linspace(0.0, 1.0, samples // 4)[1:, None]
            before = massless.follow(np.vstack([first[0].real + rise * (path[0] - first[0].real), path]), before)
        before = contact = massless.follow(path, before.last(1), before.state[-samples:])
        pull = _analysis(massless.pulled(contact), harmonics)
        ratio = massless.eigenvalues[own] * (1.0 - pull[1, own] / y[1, own])
        square, loss = float(ratio.real), float(ratio.imag)  # Omega^2, 2 zeta Omega^2
        if not square > 0.0:
            raise NonConvergenceError("nonlinear mode: its frequency falls to zero; the joint slides", history)
        after = _respond(massless.eigenvalues, pull, square, loss, own)
        after[1, own] = y[1, own]
        after *= np.where(np.arange(harmonics + 1) == 1, amplitude / np.linalg.norm(after[1]), 1.0)[:, None]
        after[1] *= np.conj(after[1, own]) / abs(after[1, own]) * np.sign(y[1, own].real)
        history.append(float(np.abs(after - y).max()) / amplitude)
        if history[-1] < tolerance and iteration > 1:
            return _as_mode(massless, amplitude, y, path, contact, (square, loss), history)
        y = solve.send(after)
    raise NonConvergenceError(f"nonlinear mode: its motion still changes by {history[-1]:.1e} of the amplitude after "
                              f"{MOST_ITERATIONS} iterations; take smaller steps of amplitude, or static loads alone "
                              "(periodic = 0)", history)


def follow_mode(joint: BoltedJoint, mode: LinearMode, amplitudes: Array, harmonics: int = HARMONICS,
                samples: int = SAMPLES, tolerance: float = 1e-6) -> tuple[PeriodicMode, ...]:
    """Return the periodic motions at amplitudes (A,), m kg^0.5, in turn, each from the one before.

    Returns
    -------
    tuple of PeriodicMode
        Frequency (Hz), damping ratio, motion and contact at `samples` instants of a period.

    Raises
    ------
    InputError
        If an amplitude is not positive.
    NonConvergenceError
        If one is not found.

    Examples
    --------
    >>> import fretflow as ff
    >>> motions = ff.follow_mode(joint, joint.linear_modes(1)[0], [1e-5, 1e-4])  # doctest: +SKIP
    >>> [motion.damping for motion in motions]  # doctest: +SKIP
    """
    modes: list[PeriodicMode] = []
    for amplitude in amplitudes:
        modes.append(periodic_mode(joint, mode, float(amplitude), harmonics, samples, tolerance,
                                   modes[-1] if modes else None))
    return tuple(modes)


def _respond(eigenvalues: Array, pull: Complex, square: float, loss: float, own: int) -> Complex:
    """Return all harmonics (H + 1, modes) but the fundamental one of the mode itself, which is given."""
    order = np.arange(len(pull))[:, None]
    impedance = eigenvalues - order**2 * square - 1j * order * loss
    impedance[1, own] = eigenvalues[own]
    load = eigenvalues * pull  # none on a mode of the same frequency, as of a round or square body, leaves it at rest
    return np.divide(load, impedance, out=np.zeros(load.shape, dtype=complex), where=load != 0.0)


def _as_mode(massless: MasslessJoint, amplitude: float, y: Complex, path: Array, history: StaticHistory,
             square_and_loss: tuple[float, float], residuals: list[float]) -> PeriodicMode:
    square, loss = square_and_loss
    own = massless.joint.structure
    rows = list(own.outputs.values())
    moved = _analysis(history.displacement, 1)[1]
    eta = y[1] - moved @ own.coupling.T
    damping = loss / (2.0 * square) + massless.joint.modal_damping + massless.joint.damping_slope * amplitude
    slipped = np.diff(np.vstack([history.slid[-1:], history.slid]), axis=0)
    middle = 0.5 * (history.force + np.roll(history.force, 1, axis=0))
    return PeriodicMode(
        amplitude=amplitude, frequency=float(np.sqrt(square)) / (2.0 * np.pi), damping=damping, modes=path,
        outputs=np.array([abs(moved @ on_contact + eta @ on_modes) for on_contact, on_modes in rows]), history=history,
        dissipated=-float(np.sum(middle * slipped)), residual_history=tuple(residuals))


def _synthesis(y: Complex, samples: int) -> Array:
    wide = np.zeros((samples // 2 + 1, y.shape[1]), dtype=complex)
    wide[:len(y)] = 0.5 * samples * y
    wide[0] *= 2.0
    return np.fft.irfft(wide, samples, axis=0)


def _analysis(values: Array, harmonics: int) -> Complex:
    coefficients = np.fft.rfft(values, axis=0)[:harmonics + 1] * (2.0 / len(values))
    coefficients[0] *= 0.5
    return np.asarray(coefficients)


def _anderson(first: Complex) -> Generator[Complex, Complex, None]:
    """Yield iterates and take what each leads to; the least-squares mix of the last ones is the next."""
    x: list[Array] = []
    steps: list[Array] = []
    now = first
    while True:
        after = yield now
        flat, went = now.view(float).ravel(), after.view(float).ravel()
        x, steps = [*x, went][-REMEMBERED:], [*steps, went - flat][-REMEMBERED:]
        mixed = x[-1]
        if len(steps) > 1:
            change = np.array([steps[-1] - one for one in steps[:-1]]).T
            weight = np.linalg.lstsq(change, steps[-1], rcond=1e-10)[0]
            mixed = mixed - np.array([x[-1] - one for one in x[:-1]]).T @ weight
        now = np.ascontiguousarray(mixed).view(complex).reshape(first.shape)
