"""What no joint has, by name: a case beyond it is run and told so, as a forgotten prefix of a unit looks like it."""

from __future__ import annotations

from collections.abc import Iterator

from fretflow.case.bolted import BoltedCase
from fretflow.case.casefile import entries
from fretflow.case.config import Case, PeriodicMethod
from fretflow.core.units import pretty_quantity

# Ranges in SI, wide: from micromachines to bridges, polymers to diamond, creep to ultrasonic fretting.
PLAUSIBLE = {
    "test.excitation_frequency": (1e-4, 1e5), "test.excitation_amplitude": (1e-4, 1e6), "test.normal_load": (1e-4, 1e6),
    "rig.moving_mass": (1e-5, 1e5), "rig.arm_mass": (1e-5, 1e5),
    "rig.in_phase_frequency": (1e-2, 1e5), "rig.out_of_phase_frequency": (1.0, 1e6),
    "specimen.youngs_modulus": (1e8, 1.3e12), "specimen.density": (100.0, 2.5e4),
    "specimen.body_width": (1e-5, 1.0), "specimen.body_height": (1e-5, 1.0), "specimen.contact_width": (1e-6, 0.5),
    "specimen.ridge_height": (1e-6, 0.5), "specimen.face_radius": (1e-6, 1e3),
    # below, fluid films; above, seizure: F. P. Bowden, D. Tabor, The Friction and Lubrication of Solids (1950)
    "contact.friction_coefficient": (0.02, 3.0),
    # J. F. Archard and W. Hirst, Proc. R. Soc. A 236 (1956) 397: 1e-18 to 1e-12 m^2/N for metals and polymers
    "wear.coefficient": (1e-19, 1e-12),
    "solver.penalty": (1e3, 1e13),
    "structure.material.youngs_modulus": (1e8, 1.3e12), "structure.material.density": (100.0, 2.5e4),
    "joint.friction_coefficient": (0.02, 3.0), "joint.bolt_load": (1e-2, 1e7),
}


def warnings(case: Case) -> tuple[str, ...]:
    """Return what is remarkable about the values of `case`: those beyond what joints have, and those without effect."""
    return (*(tuple(dict.fromkeys(implausible(case))) or _crushed(case)), *_without_effect(case))


def implausible(case: Case | BoltedCase) -> Iterator[str]:
    """Yield what is said of each value of `case` that is beyond what joints have."""
    for entry in entries(case):
        name = ".".join((*(part for part in entry.table if part not in ("upper", "lower")), entry.key))
        if entry.value and name in PLAUSIBLE:
            yield from beyond(name, entry.value, entry.unit, name)
    for body, material in case.structure.materials.items() if isinstance(case, BoltedCase) else ():
        for entry in entries(material):
            if (key := f"structure.material.{entry.key}") in PLAUSIBLE:
                yield from beyond(f"structure.materials.{body}.{entry.key}", entry.value, entry.unit, key)


def beyond(name: str, value: float, unit: str, key: str) -> Iterator[str]:
    """Yield what is said of a `value` that `name` has, if it is beyond what joints have of `key`."""
    low, high = PLAUSIBLE[key]
    if not low <= value <= high:
        shown, *ends = (pretty_quantity(number, unit, 4) for number in (value, low, high))
        yield f"{name} = {shown} is beyond what joints have ({ends[0]} to {ends[1]}); check the number and its unit"


def _crushed(case: Case) -> Iterator[str]:
    """Yield what is said of a mean pressure beyond a tenth of Young's modulus, the strength of a perfect crystal."""
    own = case.specimen
    pressure = case.test.normal_load / (own.upper.contact_width * own.lower.contact_width)
    if case.mesh.upper is None and pressure > 0.1 * min(own.upper.youngs_modulus, own.lower.youngs_modulus):
        yield (f"test.normal_load on the square of specimen.contact_width is {pretty_quantity(pressure, 'Pa', 4)}, "
               "beyond what any solid bears; check both and their units")


def _without_effect(case: Case) -> Iterator[str]:
    if case.mesh.unit != 1.0 and case.mesh.upper is None and case.mesh.lower is None:
        yield "mesh.unit changes nothing without a mesh of your own"
    for entry in entries(case.reduction):
        if entry.key.startswith("rayleigh") and not entry.is_default and case.solver.method is not PeriodicMethod.DLFT:
            yield (f'reduction.{entry.key} changes nothing with solver.method = "{case.solver.method}", whose '
                   'specimens have no mass; set rig.damping_ratio, or method = "dlft"')
