"""Frequency and damping of a mode over its amplitude, from static loads in the shape of the mode.

A load ``a M phi`` is applied to the preloaded structure and taken through a cycle of the response's modal amplitude
``x = phi^T M q`` (R. M. Lacayo, M. S. Allen, Mech. Syst. Signal Process. 118 (2019) 133-157; E. Jewell, M. S. Allen,
I. Zare, M. Wall, J. Sound Vib. 479 (2020) 115376). Where x goes as ``X cos tau``, the first harmonic of a over X is
omega^2, and the cycle's work D gives the damping ratio ``D / (2 pi omega^2 X^2)``: averaging (N. M. Krylov,
N. N. Bogoliubov, Introduction to Non-Linear Mechanics (1943)). The chord between the ends of a cycle, which is usual
for omega^2, is another mean: it differs from a periodic motion by some 0.3 % of the frequency where points open or
slide one by one. Cycles follow each other as amplitudes rise from the preload on, as periodic motions do and tests at
one level after the other: what the faces hold from being tightened goes where they slide, and stays where not yet.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.kernels.static import SEPARATION, SLIP, States
from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint, LinearMode, StaticHistory

STEPS = 12  # of load in half a cycle; chords lose 1 / STEPS^2 of a branch that is a parabola, which is given back
APPROACH = 4  # of load from one amplitude to the next, and from end to end of a first cycle


@record
class ModalBackbone:
    """Frequency and damping of one nonlinear mode at A amplitudes, falling or rising as they were asked for."""

    amplitude: Array = quantity("m*kg^0.5", "(A,), mass-normalised modal amplitude")
    frequency: Array = quantity("Hz", "(A,)")
    damping: Array = quantity("1", "(A,), ratio; the structure's own included")
    friction_damping: Array = quantity("1", "(A,), that of the joint")
    outputs: Array = quantity("m", "(A, outputs), amplitude of each named output, with its sign")
    output_names: tuple[str, ...] = ()
    dissipated: Array = quantity("J", "(A,), by friction in a cycle")
    sliding: NDArray[np.int64] = quantity("1", "(A,), contact points that slide")
    open: NDArray[np.int64] = quantity("1", "(A,), contact points that open")
    states: States | None = quantity("1", "(S, m), of the contact under all loads in turn", default=None)

    def of(self, joint: BoltedJoint) -> ModalBackbone:
        """Return the backbone of a joint that moves alike, with that one's damping of the structure."""
        return replace(self, damping=self.friction_damping + joint.modal_damping + joint.damping_slope * self.amplitude)


@record
class _Shape:
    """The load in the shape of a mode: on u (3 m,) and on eta (N,), and what it gives without the joint's motion."""

    contact: Array
    modes: Array
    compliance: float
    outputs: Array  # (outputs, 3 m) on u
    output_modes: Array  # (outputs,)

    @classmethod
    def of(cls, joint: BoltedJoint, mode: LinearMode) -> _Shape:
        own = joint.structure
        contact = shaped_load(joint, mode)
        modes = own.coupling @ mode.contact + mode.modes
        still = modes / own.eigenvalues
        rows = list(own.outputs.values())
        return cls(contact=contact, modes=modes, compliance=float(modes @ still),
                   outputs=np.array([row[0] for row in rows]).reshape(len(rows), -1),
                   output_modes=np.array([row[1] @ still for row in rows]))


def shaped_load(joint: BoltedJoint, mode: LinearMode) -> Array:
    """Return the load ``M phi`` (3 m,) of a mode on the relative displacement of the contact, kg^0.5."""
    own = joint.structure
    return np.asarray(own.boundary_mass @ mode.contact + own.coupling.T @ mode.modes)


def quasi_static_backbone(joint: BoltedJoint, mode: LinearMode, amplitudes: Array, steps: int = STEPS,
                          near: ModalBackbone | None = None) -> ModalBackbone:
    """Return the backbone of `mode` about the modal `amplitudes` (A,), m kg^0.5; where it softens it reaches further.

    The contact's states are first taken to be those of a backbone `near`, of a joint alike. With N `steps` of load in
    half a cycle the work is up to 1 / N too small where the joint slides as a whole, and much closer before.

    Returns
    -------
    ModalBackbone
        Frequency (Hz), damping ratio, energy of a cycle (J) and amplitude of each output (m), in the order asked for.

    Raises
    ------
    InputError
        If an amplitude is not positive.
    NonConvergenceError
        If the joint slides as a whole under the largest.

    Examples
    --------
    >>> import fretflow as ff
    >>> mode = joint.linear_modes(1)[0]  # of a BoltedJoint  # doctest: +SKIP
    >>> curve = ff.quasi_static_backbone(joint, mode, np.geomspace(1e-6, 1e-3, 13))  # doctest: +SKIP
    >>> curve.frequency, curve.damping  # doctest: +SKIP
    """
    amplitudes = np.atleast_1d(np.asarray(amplitudes, dtype=float))
    if not (np.all(np.isfinite(amplitudes)) and np.all(amplitudes > 0.0)):
        raise InputError("amplitudes: must be positive; at zero the mode is linear, LinearMode has its frequency")
    rising = np.argsort(amplitudes, kind="stable")
    shape = _Shape.of(joint, mode)
    loads = (2.0 * np.pi * mode.frequency)**2 * amplitudes[rising]
    back = np.argsort(rising)
    cycles, busy, states = _cycles(joint, shape, loads, steps, None if near is None else near.states)
    x, square, work, outputs = (value[back] for value in cycles)
    damping = work / (2.0 * np.pi * square * x**2)
    return ModalBackbone(
        amplitude=x, frequency=np.sqrt(square) / (2.0 * np.pi), damping=damping, friction_damping=damping,
        outputs=outputs, output_names=tuple(joint.structure.outputs), dissipated=work,
        sliding=busy[0][back], open=busy[1][back], states=states).of(joint)


def _cycles(joint: BoltedJoint, shape: _Shape, loads: Array, steps: int, guess: States | None
            ) -> tuple[list[Array], list[NDArray[np.int64]], States]:
    """Return amplitude, omega^2, work and outputs, numbers of sliding and open points, of cycles at rising loads.

    The last value is the states under all loads, of which there may be a guess.
    """
    fall, rise = 1.0 - 2.0 * np.arange(1, steps + 1) / steps, np.arange(1, APPROACH + 1) / APPROACH
    tip, last = loads[:, None], np.r_[0.0, loads[:-1]][:, None]
    there, over = tip * fall, tip * (1.0 - 2.0 * rise)  # a first cycle takes off what the faces hold from before
    level = np.hstack([last + (tip - last) * rise, over, -over, there, -there]).ravel()
    x, out, history = _respond(joint, shape, level, guess)
    own = (3 * APPROACH - 1 + np.arange(2 * steps + 1)) + (2 * steps + 3 * APPROACH) * np.arange(len(loads))[:, None]
    work = np.sum(0.5 * (level[own][:, 1:] + level[own][:, :-1]) * np.diff(x[own]), axis=1) / (1.0 - 1.0 / steps**2)
    tips = [0.5 * (0.5 * (values[own[:, 0]] + values[own[:, -1]]) - values[own[:, steps]]) for values in (
        x[:, None], out)]
    square = _first_harmonic(x[own], level[own])
    busy = [np.any(history.state[own] == one, axis=1).sum(axis=1) for one in (SLIP, SEPARATION)]
    return [tips[0][:, 0], square, work, tips[1]], busy, history.state


def _first_harmonic(x: Array, load: Array) -> Array:
    """Return loads' first harmonics over the amplitude, along loops (A, 2 S + 1) that begin at their upper tips."""
    turn, top = x.shape[1] // 2, 0.5 * (x[:, :1] + x[:, -1:])
    size, middle = 0.5 * (top - x[:, turn, None]), 0.5 * (top + x[:, turn, None])
    phase = np.arccos(np.clip((x - middle) / size, -1.0, 1.0))
    phase[:, turn + 1:] = 2.0 * np.pi - phase[:, turn + 1:]
    phase[:, [0, turn, -1]] = 0.0, np.pi, 2.0 * np.pi
    cosine = np.cos(phase)
    slope = np.diff(load) / np.where(np.diff(cosine) == 0.0, 1.0, np.diff(cosine))  # the load is straight in x
    parts = (load[:, :-1] - slope * cosine[:, :-1]) * np.diff(np.sin(phase)) + slope * np.diff(
        0.5 * phase + 0.25 * np.sin(2.0 * phase))
    return np.asarray(parts.sum(axis=1) / (np.pi * size[:, 0]))


def _respond(joint: BoltedJoint, shape: _Shape, level: Array, guess: States | None
             ) -> tuple[Array, Array, StaticHistory]:
    """Return modal amplitude (S,) and outputs (S, outputs) under the loads `level` (S,), from the preload on."""
    rest = joint.preloaded
    history = joint.follow(joint.bolts + level[:, None] * shape.contact, rest, guess)
    moved = history.displacement - rest.displacement
    return (moved @ shape.contact + shape.compliance * level,
            moved @ shape.outputs.T + level[:, None] * shape.output_modes, history)
