"""What is said of a diagnosis of the rig alone: doubts, what to measure next, parameters, and the case with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fretflow.case.casefile import dump_case
from fretflow.case.config import Case
from fretflow.case.sections import SIDES
from fretflow.effects.catalogue import catalogue, described, tables
from fretflow.experiments.rig.model import RigModel
from fretflow.experiments.rig.setup import first_friction
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.decision import estimate
from fretflow.inference.diagnosis import estimated
from fretflow.inference.parameters import Array, Coordinate, Parameters
from fretflow.inference.verdict import Estimate, ResidualLaw
from fretflow.recordings.recording import Recording

BASELINE = {"friction": ("contact.friction_coefficient", "1", "friction coefficient"),
            "wear": ("wear.coefficient", "m^2/N", "Archard wear coefficient"),
            "mass": ("rig.moving_mass", "kg", "mass of the driven block"),
            "compliance": ("specimen.lower.youngs_modulus", "Pa",
                           "modulus of the lower specimen; that of the upper goes with it, as loops tell their sum"),
            "damping": ("rig.hinge_damping_ratio", "1", "damping ratio of the hinge")}


def assumed(recording: Recording) -> tuple[str, ...]:
    """Return what of the rig is taken from the defaults of case files, as the recording does not tell it."""
    told = [f"{table}: is not in the file, so that the defaults of case files are taken; give yours as [{table}]"
            for table in ("rig", "specimen") if getattr(recording, table) is None]
    if recording.loops is None:
        told.append(f"loops: are not in the file, so that the friction coefficient is taken as "
                    f"{first_friction(recording):g}, known to 30 %, and how the joint moves is predicted alone")
    return tuple(told)


def of_instruments(wrong: Sequence[str]) -> str:
    """Return what is said where the instruments are at fault."""
    return f"No physics is looked for: {'; '.join(wrong)}."


def in_doubt(doubted: Sequence[str]) -> str:
    """Return what a verdict ends with where a channel and a value that the file states may be wrong."""
    return f" But {'; '.join(doubted)}." if doubted else ""


def not_repeated() -> str:
    """Return the warning of loops that differ smoothly from repeat to repeat."""
    return ("the repeats of a cycle count differ by smooth changes of the whole loop, not by noise: the motion does "
            "not repeat itself with the drive (a subharmonic, an intermittent contact, a drive or load that wanders), "
            "as it does in every model here; record some consecutive periods to see what it follows")


def not_judged() -> str:
    """Return the warning of loops that are held out beside jumps of the motion, all of them."""
    return ("nothing judges what was held out: the motion of those loops jumps between fits with and without them, "
            "so that which of the motions that coexist there they show cannot be predicted; record conditions farther "
            "from the jump")


def next_measurement(law: ResidualLaw) -> str:
    """Return what to measure where nothing of the catalogue fits."""
    return (f"Loops at other amplitudes, normal loads and frequencies, to see whether what is left still follows the "
            f"{law.state}, and a record of the normal force, the approach and the excitation, where they were not "
            "recorded.")


def estimates(case: Case, rig: RigModel, space: Parameters, mean: Array, covariance: Array, load_sd: float
              ) -> tuple[Estimate, ...]:
    """Return the baseline's parameters and those of effects, of coordinates with a mean (size,) and covariance.

    Loops tell the product of friction and normal load, of which the latter is known to a relative `load_sd`.
    """
    widened = [load_sd / one.size if (one.effect, one.field) == ("", "friction") else 0.0 for one in space.coordinates]
    return estimated(space, mean, covariance + np.diag(np.square(widened)), partial(_estimate, case, rig))


def _estimate(case: Case, rig: RigModel, coordinate: Coordinate, z: float, half: float, draws: Array) -> Estimate:
    if coordinate.effect:
        of_effect = estimate(coordinate, z, half, draws, described(coordinate.effect, coordinate.field))
        prior = catalogue()[coordinate.effect].priors()[coordinate.field]
        if not prior.periodic:
            return of_effect
        turn = prior.high - prior.low
        turns = turn * np.round(of_effect.value / turn)
        return replace(of_effect, value=of_effect.value - turns, low=of_effect.low - turns, high=of_effect.high - turns,
                       draws=of_effect.draws - turns)
    ends = sorted(coordinate.value(z + way * half) for way in (-1.0, 1.0))
    value, draws = coordinate.value(z), coordinate.values(draws)
    name, unit, meaning = BASELINE[coordinate.field]
    size = {"friction": float(np.mean(rig.problem.friction_coefficient)), "wear": rig.wear_coefficient,
            "mass": case.rig.moving_mass, "compliance": case.specimen.lower.youngs_modulus,
            "damping": hinge_ratio(case)}[coordinate.field]
    if coordinate.field == "compliance":
        value, draws, ends = 1.0 / value, 1.0 / draws, [1.0 / end for end in reversed(ends)]
    return Estimate(name=name, value=size * value, low=size * ends[0], high=size * ends[1], unit=unit, meaning=meaning,
                    draws=size * draws)


def hinge_ratio(case: Case) -> float:
    """Return the damping ratio of the hinge of a case."""
    own = case.rig.hinge_damping_ratio
    return case.rig.damping_ratio if own is None else own


def case_text(case: Case, fitted: Hypothesis, friction: float, wear: float) -> str:
    """Return `case` with fitted parameters and effects, as a file that `fretflow run` takes.

    The hypothesis is one by factors on a coefficient of `friction` and of `wear` (m^2/N), and on values of the case.
    What is fitted is rounded to six figures, far within its interval.
    """
    sides = {side: own.model_copy(update={"youngs_modulus": _rounded(own.youngs_modulus / fitted.compliance)})
             for side in SIDES for own in (getattr(case.specimen, side),)}
    effects = [one.changed(**{name: _rounded(getattr(one, name)) for name in type(one).priors()})
               for one in fitted.effects]
    return dump_case(case.model_copy(update={
        "contact": case.contact.model_copy(update={"friction_coefficient": _rounded(fitted.friction * friction)}),
        "wear": case.wear.model_copy(update={"coefficient": _rounded(fitted.wear * wear)}),
        "rig": case.rig.model_copy(update={"moving_mass": _rounded(case.rig.moving_mass * fitted.mass),
                                           "hinge_damping_ratio": _rounded(hinge_ratio(case) * fitted.damping)}),
        "specimen": case.specimen.model_copy(update=sides), "effects": tables(effects)}))


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.6g}")
