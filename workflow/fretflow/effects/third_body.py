"""The third body: debris that stays in the contact, carries load, takes up sliding and is worn out of its edges.

Source flow (wear), internal flow (the layer) and outer flow (ejection) after M. Godet, Wear 100 (1984) 437-452, and
N. Fillot, I. Iordanoff, Y. Berthier, Wear 262 (2007) 949-957; a layer per place whose share of the worn depth depends
on where it is, and which concentrates the pressure by its shape, after P. Arnaud, S. Fouvry, Wear 412-413 (2018)
92-108. Per node, with the worn depth h of both faces and the layer h_d, in volume of metal::

    dh_d = phi dh - h_d dn / n_e,     gap = g_0 + h - h_d

Of the metal worn off, the share 1 - phi leaves at once. What stays wanders with the strokes until it meets an end of
the contact along the sliding direction: a random walk from the position xi, -1..1 between the ends, takes
``1 - xi^2`` of the time from the middle (S. Redner, A Guide to First-Passage Processes (2001), mean exit time), which
a remainder epsilon keeps above zero at the ends::

    n_e(xi) = n_e (epsilon + (1 - epsilon) (1 - xi^2))

In the steady state ``h_d = phi (dh/dn) n_e(xi)`` is thickest in the middle. Evenly worn faces then need ``h - h_d``
level but for the elastic shape, so that the worn profile follows the layer: deepest in the middle (U), where bare
faces are deepest at the edges of the contact (W).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fretflow.contact.interface import Interface
from fretflow.core import units as u
from fretflow.core.errors import AuditError
from fretflow.effects.effect import OTHER_LENGTHS, Array, Block, Effect, Prior, Sketch, parameter
from fretflow.effects.volume_law import LawParameter, VolumeLaw, WornTests
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.structure.two_mass_rig.compliant import with_springs
from fretflow.wear.cycle import CycleResponse
from fretflow.wear.slow import SlowState

LAYER = "third-body.layer_m"
RESIDENCE = "third-body.residence_cycles"
MADE, RETAINED, EJECTED = "third-body.made_m3", "third-body.retained_m3", "third-body.ejected_m3"
AREAS, PLACE = "third-body.areas_m2", "third-body.place_m"
NORMAL_TO_SHEAR = 2.6  # modulus over shear modulus at a Poisson ratio of 0.3
BALANCED = 1e-12
SAME_LINE = 0.5  # of the mean node pitch, distance across the sliding


@dataclass(frozen=True)
class Balance:
    """What a jump did to the debris, volumes in m^3."""

    made: float
    retained: float  # growth of the layer
    ejected: float
    present: float  # in the layer, before and after together

    def check(self) -> None:
        """Check that what was made is in the layer or out.

        Raises
        ------
        AuditError
            If it is not to round-off of the volumes that take part.
        """
        missing = self.made - self.retained - self.ejected
        if not abs(missing) <= BALANCED * (abs(self.made) + self.present):
            raise AuditError(f"effects.third-body: of {self.made:.6g} m³ of debris {self.retained:.6g} m³ stayed and "
                             f"{self.ejected:.6g} m³ left; {missing:.3g} m³ are lost")


class ThirdBody(Effect):
    """Debris between the faces.

    It closes the gap, yields as springs of h_d / E_d per area (normal) and 2.6 times that (tangential), and slows wear
    by exp(-h_d / h_0) where it keeps the metals apart. Friction keeps its coefficient, hence its work per sliding.
    """

    id = "third-body"
    title = "debris that stays, carries load and is ejected at the edges"
    block = Block.WEAR
    equation = ("dh_d = phi dh - h_d dn / n_e(xi); n_e(xi) = n_e (eps + (1 - eps) (1 - xi^2)); "
                "g = g_0 + h - h_d; wear rate times exp(-h_d / h_0); compliance h_d / E_d per area")
    formula = (r"\begin{gathered} "
               r"\mathrm{d}h_d = \varphi\,\mathrm{d}h - \frac{h_d}{n_e(\xi)}\,\mathrm{d}n, \qquad "
               r"n_e(\xi) = n_e \left[\varepsilon + (1 - \varepsilon)(1 - \xi^2)\right] \\ "
               r"g = g_0 + h - h_d, \qquad \dot h \to \dot h\,e^{-h_d / h_0}, \qquad "
               r"\text{compliance } h_d / E_d \text{ per area} \end{gathered}")
    source = ("M. Godet, Wear 100 (1984) 437-452; N. Fillot, I. Iordanoff, Y. Berthier, Wear 262 (2007) "
              "949-957, mass balance; P. Arnaud, S. Fouvry, Wear 412-413 (2018) 92-108, debris layer")
    over_cycles = True
    told_by = OTHER_LENGTHS
    told_from: ClassVar[Mapping[str, str]] = {
        "wear-power-law": "the same condition stopped after a tenth and after a third of the cycles, which changes the "
                          "wear per energy only if debris slows it,",
        "wear-coefficient-evolution": "tests of one number of cycles at several amplitudes, which change the worn "
                                      "volume but not the cycles,"}
    observables = ("wear map: U instead of W", "approach against worn volume", "approach over cycles")

    retained_fraction: float = parameter(0.6, "phi: share of the worn metal that enters the layer", 0.3, 0.95,
                                         ge=0.0, le=1.0, neutral=0.0)
    separating_thickness: u.Length = parameter(2e-6, "h_0: layer at which wear falls to 1/e", 0.5e-6, 5e-6)
    residence: float = parameter(1e5, "n_e: cycles that debris stays from the middle of the contact", 1e3, 1e6, gt=0.0)
    edge_residence: float = parameter(0.1, "eps: residence at the edge over that in the middle", 0.02, 0.5,
                                      gt=0.0, le=1.0)
    # No range: Arnaud and Fouvry (2018) find that it does not matter, so that no recording tells it.
    modulus: u.Pressure = Field(30e9, description="E_d: modulus of the layer, between loose and solid oxide")

    def initial_memory(self, interface: Interface) -> dict[str, Array]:
        """Return clean faces, all of them taken for contact."""
        n, nothing = interface.size, np.zeros(())
        everywhere = np.ones(n, dtype=bool)
        return {LAYER: np.zeros(n), MADE: nothing, RETAINED: nothing, EJECTED: nothing, AREAS: interface.areas,
                PLACE: interface.nodes, RESIDENCE: self.stay(interface.nodes, interface.areas, everywhere)}

    def stay(self, place: Array, areas: Array, closed: NDArray[np.bool_]) -> Array:
        """Return n_e (nodes,), cycles, where the nodes `closed` are the contact; debris elsewhere stays least."""
        inside = np.where(closed, 1.0 - edge_position(place, areas, closed)**2, 0.0)
        return np.asarray(self.residence * (self.edge_residence + (1.0 - self.edge_residence) * inside))

    def evolve(self, before: SlowState, cycles: float, worn: Array, energy: float, response: CycleResponse
               ) -> dict[str, Array]:
        """Return the layer after a jump of even wear, exactly, and the volumes made, retained and ejected.

        Raises
        ------
        AuditError
            If the volumes are not balanced.
        """
        memory = before.memory
        stay = self.stay(memory[PLACE], memory[AREAS], response.contact_share > 0.0)
        old, entered = memory[LAYER], self.retained_fraction * worn
        gone, kept = _decay(cycles / stay)
        layer = old * (1.0 - gone) + entered * kept
        ejected = (1.0 - self.retained_fraction) * worn + old * gone + entered * (1.0 - kept)
        areas = memory[AREAS]
        balance = Balance(made=float(areas @ worn), retained=float(areas @ (layer - old)),
                          ejected=float(areas @ ejected), present=float(areas @ (layer + old)))
        balance.check()
        return {LAYER: layer, RESIDENCE: stay, RETAINED: np.asarray(areas @ layer),
                MADE: memory[MADE] + balance.made, EJECTED: memory[EJECTED] + balance.ejected}

    def opening_share(self, slow: SlowState, cycles: float) -> Array:
        """Return the share of a jump's wear that its own debris does not fill."""
        return 1.0 - self.retained_fraction * _decay(cycles / slow.memory[RESIDENCE])[1]

    def wear_factor(self, response: CycleResponse, slow: SlowState, problem: PeriodicProblem) -> Array:
        """Return how far the layer lets the metals wear each other."""
        return np.asarray(np.exp(-slow.memory[LAYER] / self.separating_thickness))

    def layer(self, slow: SlowState) -> Array:
        """Return the thickness of the layer."""
        return np.asarray(slow.memory[LAYER])

    @classmethod
    def worn_range(cls, field: str, prior: Prior, depth: float, cycles: float) -> Prior:
        """Return layers that separate from a tenth to ten times the worn depth, and stay 0.01 to 100 times the test."""
        size, factor = {"separating_thickness": (depth, 10.0), "residence": (cycles, 100.0)}.get(field, (0.0, 1.0))
        return replace(prior, low=size / factor, high=size * factor, logarithmic=True) if size else prior

    @classmethod
    def volume_laws(cls, tests: WornTests) -> tuple[VolumeLaw, ...]:
        """Return the law while all debris stays: ``dV/dE = alpha exp(-V / V_0)``, V_0 = A h_0 / phi, A the area.

        Hence ``V = V_0 ln(1 + alpha E / V_0)``.
        """
        def worn(plain: Array, states: Mapping[str, Array], values: Array) -> Array:
            return np.asarray(values[0] * np.log1p(plain / values[0]))

        own = LawParameter("separating_volume", "m^3", "V_0 = A h_0 / phi: worn volume at which wear has fallen to 1/e",
                           0.1 * float(np.average(tests.volume, weights=tests.weight)), float(tests.volume.max()))
        return (VolumeLaw(cls.id, (own,), worn, of_volume=True),)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Put the layer between the faces."""
        layer, face = slow.memory[LAYER], problem.interface
        soft = layer / (self.modulus * face.areas)
        springs = np.stack([NORMAL_TO_SHEAR * soft, NORMAL_TO_SHEAR * soft, soft], axis=1).ravel()
        return replace(problem, structure=with_springs(problem.structure, springs),
                       interface=replace(face, gap=face.gap - layer))

    def sketch(self) -> Sketch:
        """Return the steady layer across the contact at 0.02 nm of wear a cycle, by the residence."""
        place = np.linspace(-1.0, 1.0, 101)
        stay = self.edge_residence + (1.0 - self.edge_residence) * (1.0 - place**2)
        curves: Mapping[str, tuple[Array, Array]] = {
            f"n_e = {share * self.residence:,g}": (place, 1e6 * self.retained_fraction * 2e-11 * share
                                                  * self.residence * stay) for share in (0.3, 1.0)}
        return Sketch("position between the edges along the sliding", "steady layer in µm", curves)


def edge_position(place: Array, areas: Array, closed: NDArray[np.bool_]) -> Array:
    """Return where nodes lie between the edges of the contact along x, (nodes,): 0 in the middle, 1 and -1 at edges.

    The edges are those of the `closed` nodes on the same line along x; a line of one node is all edge.
    """
    x, y = place.T
    same = closed & (np.abs(y[:, None] - y) < SAME_LINE * np.sqrt(areas.mean()))
    low, high = np.where(same, x, np.inf).min(axis=1), np.where(same, x, -np.inf).max(axis=1)
    wide = high > low
    low, high = np.where(wide, low, -1.0), np.where(wide, high, 1.0)  # a line on which nothing is closed has no edges
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return np.where(wide, np.clip((x - middle) / half, -1.0, 1.0), 1.0)


def _decay(passed: Array) -> tuple[Array, Array]:
    """Return ``1 - e^-x`` and ``(1 - e^-x) / x``: what leaves of an old layer, and what stays of an even supply."""
    gone = -np.expm1(-passed)
    return gone, np.divide(gone, passed, out=np.ones_like(passed), where=passed > 0.0)
