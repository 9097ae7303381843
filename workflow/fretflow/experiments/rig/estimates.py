"""Parameters of a fitted rig with their intervals, and the case that has them."""

from __future__ import annotations

import numpy as np

from fretflow.case.casefile import dump_case, entries
from fretflow.case.config import Case
from fretflow.effects.catalogue import catalogue, tables
from fretflow.experiments.rig.experiment import hypothesis
from fretflow.experiments.rig.model import RigModel
from fretflow.inference.experiment import Point
from fretflow.inference.parameters import Array, Coordinate, Parameters
from fretflow.inference.search import HALF
from fretflow.inference.verdict import Estimate
from fretflow.structure.two_mass_rig.joint import rig_of

BASELINE = {"friction": ("contact.friction_coefficient", "1", "friction coefficient"),
            "wear": ("wear.coefficient", "m^2/N", "Archard wear coefficient"),
            "mass": ("rig.moving_mass", "kg", "mass of the driven block")}


def estimates(rig: RigModel, space: Parameters, mean: Array, spread: Array) -> tuple[Estimate, ...]:
    """Return the baseline's parameters and those of effects, of coordinates with a mean and a spread (size,)."""
    made = [_estimate(rig, coordinate, float(z), HALF * float(sd))
            for coordinate, z, sd in zip(space.coordinates, mean, spread, strict=True)]
    return tuple(one for one in made if one is not None)


def _estimate(rig: RigModel, coordinate: Coordinate, z: float, half: float) -> Estimate | None:
    ends = sorted(coordinate.value(z + way * half) for way in (-1.0, 1.0))
    value = coordinate.value(z)
    if coordinate.effect:
        kind = catalogue()[coordinate.effect]
        prior = kind.priors()[coordinate.field]
        turn = 2.0 * np.pi  # width of the range of an angle
        if prior.high - prior.low == turn:
            turns = turn * np.round(value / turn)
            value, ends = value - turns, [end - turns for end in ends]
        unit = next(entry.unit for entry in entries(kind()) if entry.key == coordinate.field)
        return Estimate(name=coordinate.name, value=value, low=ends[0], high=ends[1], unit=unit or "1",
                        meaning=kind.model_fields[coordinate.field].description or "")
    if coordinate.field not in BASELINE:
        return None
    name, unit, meaning = BASELINE[coordinate.field]
    size = {"friction": float(np.mean(rig.problem.friction_coefficient)), "wear": rig.wear_coefficient,
            "mass": float(rig_of(rig.problem.structure).rig.moving_mass)}[coordinate.field]
    return Estimate(name=name, value=size * value, low=size * ends[0], high=size * ends[1], unit=unit, meaning=meaning)


def case_text(case: Case, rig: RigModel, point: Point) -> str:
    """Return `case` with the fitted parameters and effects, as a file that `fretflow run` takes."""
    found = hypothesis(point)
    soft = found.compliance
    sides = {side: own.model_copy(update={"youngs_modulus": own.youngs_modulus / soft})
             for side in ("upper", "lower") for own in (getattr(case.specimen, side),)}
    changed = case.model_copy(update={
        "contact": case.contact.model_copy(update={
            "friction_coefficient": found.friction * float(np.mean(rig.problem.friction_coefficient))}),
        "wear": case.wear.model_copy(update={"coefficient": found.wear * rig.wear_coefficient}),
        "rig": case.rig.model_copy(update={"moving_mass": case.rig.moving_mass * found.mass}),
        "specimen": case.specimen.model_copy(update=sides),
        "effects": tables(found.effects)})
    return dump_case(changed)
