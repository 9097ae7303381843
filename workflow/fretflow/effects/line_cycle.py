"""A cylinder that slides on a flat in gross slip, plane strain: how its profile wears.

Both bodies are half-spaces of contact modulus E*; on strips of width dx at x_i they give way by (K. L. Johnson, Contact
Mechanics (1985), section 2.4, up to a constant) ::

    u_i = -2 / (pi E*) sum_j p_j integral ln |x_i - s| ds,    g_i = x_i^2 / (2 R) + h_i - h_d,i + u_i - delta >= 0

and p_i >= 0, p_i g_i = 0, sum p_i dx = P. Within a jump of n cycles each strip wears ``K_w n s p`` by the pressure at
its end (backward Euler): on a strip, wear is then one more flexibility, and no jump is unstable. Where stroke is
far shorter than the contact is wide, so that pressure follows the middle of the stroke.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import Interface
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import Array
from fretflow.effects.effect import Effect
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState

SET_CHANGES = 100
JUMPS = 30  # of the march of a test


@dataclass(frozen=True)
class LineContact:
    """A cylinder of `radius` (m) pressed on a flat by `load` (N/m), sliding by +-`amplitude` (m) in each cycle."""

    radius: float
    modulus: float  # E*, Pa: 1 / E* = sum (1 - nu^2) / E
    load: float
    amplitude: float
    frequency: float
    friction: float
    half_width: float  # of the strips' range, m
    strips: int = 101

    @cached_property
    def interface(self) -> Interface:
        """Return the strips, of 1 m of length, and the gap of the unworn cylinder."""
        edges = np.linspace(-self.half_width, self.half_width, self.strips + 1)
        x = 0.5 * (edges[1:] + edges[:-1])
        return Interface(np.stack([x, np.zeros_like(x)], axis=1), np.diff(edges), x**2 / (2.0 * self.radius))

    @cached_property
    def flexibility(self) -> Array:
        """Return the displacement (strips,) per pressure (strips,), m/Pa, about one far away."""
        x, wide = self.interface.nodes[:, 0], self.interface.areas
        far = 10.0 * self.half_width  # so that all of it is positive definite

        def integral(t: Array) -> Array:
            return np.asarray(t * (np.log(np.abs(t) / far) - 1.0))

        apart = x[:, None] - x
        return np.asarray(-2.0 / (np.pi * self.modulus) * (integral(apart + 0.5 * wide) - integral(apart - 0.5 * wide)))

    def press(self, gap: Array, yielding: Array, closed: NDArray[np.bool_]) -> Array:
        """Return the pressure (strips,), Pa, on faces `gap` (strips,) apart that also yield by `yielding` times it.

        Raises
        ------
        InputError
            If nothing presses the faces together.
        NonConvergenceError
            If no set of closed strips holds.
        """
        if not self.load > 0.0:
            raise InputError(f"line_contact.load: must be positive, got {self.load}")
        wide = self.interface.areas
        matrix = self.flexibility + np.diag(yielding)
        for _ in range(SET_CHANGES):
            c = np.flatnonzero(closed)
            held = np.block([[matrix[np.ix_(c, c)], -np.ones((c.size, 1))], [wide[c][None], np.zeros((1, 1))]])
            *inside, approach = np.linalg.solve(held, np.r_[-gap[c], self.load])
            pressure = np.zeros(len(gap))
            pressure[c] = inside
            after = np.where(closed, pressure > 0.0, gap + matrix @ pressure - approach < 0.0)
            if np.array_equal(after, closed):
                return pressure
            closed = after
        raise NonConvergenceError(f"line contact: no set of closed strips holds after {SET_CHANGES} changes")

    def response(self, pressure: Array) -> CycleResponse:
        """Return what a cycle of gross slip does under a pressure (strips,)."""
        path, wide = 4.0 * self.amplitude, self.interface.areas
        closed = pressure > 0.0
        return CycleResponse(
            pressure_sliding=path * pressure, mean_pressure=pressure, mean_opening=np.zeros_like(pressure),
            slip_path=np.where(closed, path, 0.0), contact_share=closed.astype(float),
            dissipated_energy=float(self.friction * path * (wide @ pressure)), sliding_distance=2.0 * self.amplitude)


@dataclass(frozen=True)
class LineWear:
    """A worn line contact: state, and the pressure (strips,), Pa, at its end."""

    slow: SlowState
    pressure: Array


@dataclass(frozen=True)
class LineCycle:
    """A line contact with effects, worn by Archard's law in jumps.

    Examples
    --------
    >>> import fretflow as ff  # doctest: +SKIP
    >>> LineCycle(contact).wear(2e-13, 5000).slow.depth  # m, (strips,)  # doctest: +SKIP
    """

    contact: LineContact
    effects: Sequence[Effect] = field(default_factory=tuple)

    def wear(self, coefficient: float, cycles: float, jumps: int = JUMPS) -> LineWear:
        """Return the contact after `cycles` with K_w `coefficient` in m^2/N, in `jumps` that grow.

        Raises
        ------
        NonConvergenceError
            If a pressure is not found.
        """
        own, problem = self.contact, self.contact
        face = own.interface
        memory: dict[str, Array] = {}
        for effect in self.effects:
            memory.update(effect.initial_memory(face))
        now = replace(SlowState.unworn(face.size), memory=memory)
        closed = face.gap < np.partition(face.gap, 3)[3]
        pressure = own.press(face.gap, np.zeros(face.size), closed)
        for jump in np.diff(cycles * np.linspace(0.0, 1.0, jumps + 1)**2):
            response = own.response(pressure)
            factor = np.full(face.size, coefficient * 4.0 * own.amplitude * jump)
            share = np.ones(face.size)
            for effect in self.effects:
                factor = factor * effect.wear_factor(response, now, _as_problem(problem))
                share = share * effect.opening_share(now, jump)
            idle = self._after(now, jump, np.zeros(face.size), response)
            gap = face.gap + now.depth - sum(effect.layer(idle) for effect in self.effects)
            pressure = own.press(gap, factor * share, pressure > 0.0)
            now = self._after(now, jump, factor * pressure, own.response(pressure))
        return LineWear(now, pressure)

    def _after(self, before: SlowState, jump: float, worn: Array, response: CycleResponse) -> SlowState:
        energy = jump * response.dissipated_energy
        memory = dict(before.memory)
        for effect in self.effects:
            memory.update(effect.evolve(before, jump, worn, energy, response))
        return before.after(jump, worn, energy, memory)


def _as_problem(contact: LineContact) -> Any:
    """Return a contact as laws of wear take it: they look at its interface and frequency alone."""
    return contact
