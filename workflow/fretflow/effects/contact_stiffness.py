"""Asperities: springs in series with the bodies, stiffer where the pressure is higher."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fretflow.core import units as u
from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import record
from fretflow.effects.effect import OTHER_LOAD, Array, Block, Effect, Prior, RecordedSize, Sketch, parameter
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.periodic import PeriodicProblem
from fretflow.solvers.quasi_static.march import press_frictionless
from fretflow.structure.two_mass_rig.compliant import with_springs
from fretflow.wear.slow import SlowState

SMALLEST_PRESSURE = 0.01  # of the reference; below it asperities are linear
MAX_ITERATIONS = 100
TOLERANCE = 1e-13  # of the load, change of a nodal force
# Tangential stiffness over area of flat metal faces, N/m^3: from milled flanges, a tenth of the least of Fantetti's
# specimens, up to the stiffest of these.
FLAT_FACES = (1e12, 1.5e14)
MINDLIN = (1.0, 2.0)  # normal over tangential stiffness of rough faces, R. D. Mindlin (1949)
RIGID = 1e-12  # compliance of a node over the bodies' own, below which asperities are left out


@record
class Asperities:
    """Asperity springs per area: ``dp/de = k_n (p / p_0)^m``, and tangentially ``k_n / ratio`` at the same pressure.

    `stiffness` is k_n in N/m^3, `ratio` that of normal to tangential stiffness.
    """

    stiffness: float
    exponent: float
    ratio: float
    reference_pressure: float

    def compression(self, pressure: Array) -> Array:
        """Return e in m at pressures in Pa, zero at zero."""
        share = np.maximum(pressure / self.reference_pressure, 0.0)
        beyond = np.maximum(share, SMALLEST_PRESSURE)
        m = self.exponent
        if m == 1.0:
            rise = np.log(beyond / SMALLEST_PRESSURE)
        else:
            rise = (beyond**(1.0 - m) - SMALLEST_PRESSURE**(1.0 - m)) / (1.0 - m)
        linear = np.minimum(share, SMALLEST_PRESSURE) * SMALLEST_PRESSURE**-m
        return np.asarray(self.reference_pressure / self.stiffness * (linear + rise))

    def compliance(self, pressure: Array) -> Array:
        """Return de/dp in m/Pa."""
        share = np.maximum(pressure / self.reference_pressure, SMALLEST_PRESSURE)
        return np.asarray(share**-self.exponent / self.stiffness)


def with_asperities(problem: PeriodicProblem, asperities: Asperities) -> PeriodicProblem:
    """Return `problem` with asperities between its faces, linear about each node's static pressure.

    The static pressure is that of the frictionless joint with the asperities' full law; about it the normal springs
    keep value and slope, so that the load at rest is exact, and the tangential ones have the stiffness of that
    pressure. The pressure of a node varies little over a period.

    Raises
    ------
    NonConvergenceError
        If the static pressure is not found.
    """
    areas, gap = problem.interface.areas, problem.interface.gap
    normal = problem.boundary.flexibility[2::3, 2::3]
    stiffest = float(asperities.compliance(np.asarray(problem.normal_load / areas.sum())))
    if stiffest / float(areas.mean()) < RIGID * float(normal.diagonal().mean()):
        return problem
    force = _static_force(problem, normal, asperities)
    soft = asperities.compliance(force / areas) / areas
    offset = asperities.compression(force / areas) - soft * force
    springs = np.stack([asperities.ratio * soft, asperities.ratio * soft, soft], axis=1).ravel()
    return replace(problem, structure=with_springs(problem.structure, springs),
                   interface=replace(problem.interface, gap=gap + offset))


def _static_force(problem: PeriodicProblem, normal: NDArray[np.float64], asperities: Asperities) -> Array:
    """Return the nodal forces (n,) of ``F f + q + gap + e(f / a) = 0`` where closed, ``sum f = N``, by Newton."""
    areas, gap = problem.interface.areas, problem.interface.gap
    force = np.full(len(areas), problem.normal_load) * areas / areas.sum()
    for _ in range(MAX_ITERATIONS):
        soft = asperities.compliance(force / areas) / areas
        offset = asperities.compression(force / areas) - soft * force
        after, _, _ = press_frictionless(gap + offset, normal + np.diag(soft), np.ones((len(areas), 1)),
                                         np.array([problem.normal_load]))
        change = float(np.abs(after - force).max())
        force = after
        if change < TOLERANCE * problem.normal_load:
            return force
    raise NonConvergenceError(f"effects.contact-stiffness: the static pressure still changes by {change:.1e} N after "
                              f"{MAX_ITERATIONS} steps; use a smaller exponent")


class ContactStiffness(Effect):
    """Asperity springs in series with the bodies.

    Their stiffness is that of the whole contact at the reference pressure; at each node it grows with a power of that
    node's static pressure. Normal stiffness is Mindlin's multiple of the tangential one, or more where faces are hard.
    """

    id = "contact-stiffness"
    title = "asperity springs in series with the bodies"
    block = Block.CONTACT
    equation = "k_t (p / p_0)^m tangential, ratio times as much normal"
    formula = r"k_{c,t} = k_t \left(\frac{p}{p_0}\right)^m, \qquad k_{c,n} = r\,k_{c,t}"
    source = ("R. D. Mindlin, J. Appl. Mech. 16 (1949), ratio; R. Pohrt, V. L. Popov, Phys. Rev. Lett. "
              "108 (2012), power law; A. Fantetti et al., Tribol. Int. 138 (2019), measured slopes")
    acts_at = 1
    told_from: ClassVar[Mapping[str, str]] = {
        "sensor-path-compliance": OTHER_LOAD + ", with which the contact stiffens and the sensor's path does not,",
        "contact-stiffness-evolution": "more loops in the first tenth of the test",
        "initial-gap": "the approach of the specimens and maps of both faces before the test"}
    observables: ClassVar[tuple[str, ...]] = ("slope of the stick portion of a loop", "approach", "first resonance")

    stiffness: u.Stiffness = parameter(60e6, "k_t: tangential stiffness of the whole contact at p_0", 15e6, 150e6,
                                       source="stick slopes measured on such rigs, Fantetti et al. (2019)",
                                       neutral=1e30)
    exponent: float = parameter(0.5, "m: how the stiffness grows with pressure", 0.0, 1.0, ge=0.0, le=1.0,
                                source="from springs alike everywhere, W. D. Iwan, J. Appl. Mech. 33 (1966), "
                                       "to m of 0.5-1, Pohrt and Popov (2012)")
    ratio: float = parameter(1.2, "normal over tangential stiffness", 1.0, 20.0, logarithmic=True, gt=0.0,
                             source="from Mindlin's (1949) (2 - nu) / (2 - 2 nu), 1.2 for steel, to faces taken as "
                                    "hard in the normal direction, E. P. Petrov, D. J. Ewins, J. Turbomach. 125 (2003)")
    reference_pressure: u.Pressure = parameter(60e6, "p_0: pressure at which the stiffness is k_t", 10e6, 200e6)

    def period(self, problem: PeriodicProblem, slow: SlowState) -> PeriodicProblem:
        """Put the springs in."""
        return with_asperities(problem, self.asperities(problem.interface.areas))

    def bolted(self, joint: BoltedJoint) -> BoltedJoint:
        """Put the springs in, each as stiff as under the static pressure of rigid faces."""
        areas = joint.structure.areas
        own = self.asperities(areas)
        pressure = np.maximum(joint.preloaded.force[0, 2::3], 0.0) / areas
        soft = own.compliance(pressure) / areas
        springs = np.stack([self.ratio * soft, self.ratio * soft, soft], axis=1).ravel()
        return replace(joint, springs=springs if joint.springs is None else joint.springs + springs)

    @classmethod
    def bolted_range(cls, field: str, prior: Prior, joint: BoltedJoint, recorded: RecordedSize) -> Prior:
        """Return the stiffness of all the faces' area, a reference pressure about the mean one, rough faces' ratio.

        The exponent keeps its range: from springs alike at all pressures, as of Jenkins elements, to rough faces'.
        """
        if field == "stiffness":
            area = float(joint.structure.areas.sum())
            return replace(prior, low=FLAT_FACES[0] * area, high=FLAT_FACES[1] * area, logarithmic=True)
        if field == "reference_pressure":
            return replace(prior, low=joint.bolted_pressure / 1.5, high=joint.bolted_pressure * 1.5)
        if field == "ratio":
            return replace(prior, low=MINDLIN[0], high=MINDLIN[1], logarithmic=False)
        return prior

    def asperities(self, areas: Array) -> Asperities:
        """Return the springs per area of a contact of `areas` (nodes,)."""
        return Asperities(stiffness=self.ratio * self.stiffness / float(areas.sum()), exponent=self.exponent,
                          ratio=self.ratio, reference_pressure=self.reference_pressure)

    def sketch(self) -> Sketch:
        """Return the stiffness against pressure."""
        share = np.linspace(0.02, 3.0, 200)
        return Sketch("pressure over p_0", "tangential stiffness in N/µm",
                      {"": (share, 1e-6 * self.stiffness * share**self.exponent)})
