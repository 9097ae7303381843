"""The free decay of a structure with a friction joint in time, and what a decay tells of frequency and damping.

The dynamic modes are integrated by central differences (Verlet), which keep the energy of what is elastic; the contact
follows them at every step. A recorded decay is read by its analytic signal (D. Gabor, J. IEE 93 (1946) 429) in a band
about one mode, by demodulation, which is local: a Hilbert transform would carry the large start into the small end.

A cycle takes its loss from what the joint stores at its turns, ``U(A)``. Sliders that slip store no more as A grows
(Masing), so that ``dU/dA = k_t A`` with the tangent stiffness there, ``k_t = omega^2 (1 + 2 d ln omega / d ln A)``, and
an envelope falls faster than a linear oscillator's of the same loss: its decrement is ``1 - 2 d ln omega / d ln A``
times the damping ratio ``D / (2 pi omega^2 A^2)``, to first order.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint, LinearMode
from fretflow.solvers.nonlinear_modes.periodic_mode import MasslessJoint

BAND = 0.25  # half width about the frequency, relative: the next mode of a beam is farther away
EDGE = 6.0  # periods at each end of a decay that the filter bends
SMOOTHED = 4.0  # periods over which frequency and decay are taken
MASING = 2.0  # share of d ln omega / d ln A by which a decrement is more than the damping ratio, see above
STEPS_A_PERIOD = 200  # of the highest dynamic mode at least a tenth of its own


@record
class FreeDecay:
    """A decay in time, N samples."""

    time: Array = quantity("s", "(N,)")
    modes: Array = quantity("m*kg^0.5", "(N, modes), motion of the modes of the closed joint")
    outputs: Array = quantity("m", "(N, outputs)")
    output_names: tuple[str, ...] = ()


@record
class InstantaneousMode:
    """What a decay tells at P instants: amplitude of the channel, frequency and damping ratio."""

    amplitude: Array = quantity("SI", "(P,), falling")
    frequency: Array = quantity("Hz", "(P,)")
    damping: Array = quantity("1", "(P,)")


def ring_down(joint: BoltedJoint, mode: LinearMode, amplitude: float, periods: int, modes: int = 6) -> FreeDecay:
    """Return the decay of a structure that is let go in the shape of `mode` at a modal amplitude (m kg^0.5).

    Raises
    ------
    InputError
        If the amplitude is not positive.
    NonConvergenceError
        If the joint slides as a whole.
    """
    if not amplitude > 0.0:
        raise InputError(f"amplitude: must be positive, got {amplitude}")
    massless = MasslessJoint.of(joint, modes)
    highest = float(np.sqrt(massless.eigenvalues[-1]))
    step = min(1.0 / (STEPS_A_PERIOD * mode.frequency), 0.2 / highest)
    count = int(np.ceil(periods / (mode.frequency * step)))
    loss = 2.0 * joint.modal_damping * np.sqrt(massless.eigenvalues)
    rest = joint.preloaded
    shape = (joint.structure.coupling @ mode.contact + mode.modes)[:modes]
    still = massless.pulled(rest)[0]
    y, contact = np.zeros((count, modes)), massless.at_rest(rest)
    displacement = np.zeros((count, rest.slid.shape[1]))
    y[0] = still + amplitude * shape / np.linalg.norm(shape)
    before, now = y[0], y[0]
    starting = True
    for k in range(count):
        contact = massless.follow(now[None], contact)
        y[k], displacement[k] = now, contact.displacement[0]
        pull = massless.eigenvalues * (massless.pulled(contact)[0] - now)
        if starting:  # from rest: half a step's acceleration
            before, now, starting = now, now + 0.5 * step**2 * pull, False
            continue
        # damping by central differences: (y+ - y-) / (2 dt)
        before, now = now, (2.0 * now - before * (1.0 - 0.5 * step * loss) + step**2 * pull) / (1.0 + 0.5 * step * loss)
    own = massless.joint.structure
    eta = y - displacement @ massless.coupling.T
    moved = displacement - rest.displacement
    rested = still - rest.displacement @ massless.coupling.T
    outputs = [moved @ on_contact + (eta - rested) @ on_modes for on_contact, on_modes in own.outputs.values()]
    return FreeDecay(time=step * np.arange(count), modes=y - still, outputs=np.array(outputs).reshape(-1, count).T,
                     output_names=tuple(own.outputs))


def instantaneous_mode(time: Array, signal: Array, frequency: float) -> InstantaneousMode:
    """Return frequency and damping over the amplitude of a decaying `signal` (N,) in a band about `frequency` (Hz).

    Both are slopes, of the analytic signal's phase and of its logarithm, over some periods.

    Raises
    ------
    InputError
        If the decay is too short or its samples too far apart.
    """
    step = float(np.median(np.diff(time)))
    if not 4.0 * (1.0 + BAND) * frequency * step < 1.0:
        raise InputError(f"ring_down: samples every {step:.2e} s do not follow {frequency:.4g} Hz")
    even = np.interp(np.arange(time[0], time[-1], step), time, signal)
    width, edge = round(SMOOTHED / (frequency * step)), round(EDGE / (frequency * step))
    if len(even) < 4 * (width + edge):
        raise InputError(f"ring_down: {len(even) * step * frequency:.0f} periods are too few to tell frequency and "
                         "damping over amplitude")
    low_pass = butter(2, BAND * frequency, fs=1.0 / step, output="sos")
    turned = (even - even.mean()) * np.exp(-2j * np.pi * frequency * step * np.arange(len(even)))
    analytic = 2.0 * (sosfiltfilt(low_pass, turned.real) + 1j * sosfiltfilt(low_pass, turned.imag))[edge:-edge]
    logarithm = np.log(np.maximum(np.abs(analytic), np.finfo(float).tiny))
    phase = np.unwrap(np.angle(analytic))
    # straight lines through windows that do not overlap, so that the points are independent
    at = np.arange(0, len(analytic) - width, width)
    line = np.arange(width) - 0.5 * (width - 1)
    scale = float(line @ line) * step
    turning, falling = (np.array([line @ values[k:k + width] for k in at]) / scale for values in (phase, logarithm))
    turning = turning + 2.0 * np.pi * frequency
    if len(at) > 2:
        falling = falling + MASING * np.gradient(np.log(turning), width * step)
    natural = np.hypot(turning, falling)
    return InstantaneousMode(amplitude=np.exp([float(logarithm[k:k + width].mean()) for k in at]),
                             frequency=natural / (2.0 * np.pi), damping=-falling / natural)
