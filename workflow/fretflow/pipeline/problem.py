"""From the reduced specimens and the case to the periodic problem."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Case, PeriodicMethod, PreloadContact
from fretflow.contact.coulomb import Coulomb
from fretflow.contact.interface import Interface
from fretflow.core.errors import ConfigError
from fretflow.effects.catalogue import parse_effects
from fretflow.effects.effect import Effect
from fretflow.effects.model import EffectModel
from fretflow.pipeline.run_records import RunRecords
from fretflow.solvers.periodic import Harmonic, NormalLoad, PeriodicProblem, refuse_unknown
from fretflow.structure.two_mass_rig.joint import JointModel, QuasiStaticJoint, RigJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

ACTS_IN_RIG = ("period", "evolve", "wear_factor", "opening_share", "sense")


def make_problem(case: Case, reduced: Path) -> PeriodicProblem:
    """Return the unworn problem of the baseline of `case` with the specimens in the folder `reduced`."""
    run = RunRecords({"reduce": reduced})
    upper, lower = run.reduced
    joint = RigJoint(upper=upper, lower=lower, rig=LumpedRig.of(case.rig))
    # The quasi-static joint is condensed here once, and not again at every solution.
    quasi_static = case.solver.method is PeriodicMethod.QUASI_STATIC
    return rig_problem(
        joint.quasi_static() if quasi_static else joint, run.interface,
        case.contact.friction_coefficient, case.test.excitation_frequency, case.test.excitation_amplitude,
        case.test.normal_load, frictional=case.contact.preload is PreloadContact.FRICTIONAL)


def rig_problem(joint: JointModel, interface: Interface, friction_coefficient: NDArray[np.float64] | float,
                frequency: float, excitation: float, normal_load: float, *, frictional: bool = False
                ) -> PeriodicProblem:
    """Return the problem of a joint on the rig: a force on its block (Hz, N), a load on its arm (N)."""
    return PeriodicProblem(joint, interface, Coulomb(friction_coefficient), Harmonic(frequency, {"block": excitation}),
                           preload=NormalLoad(normal_load, frictional=frictional))


def make_model(case: Case, reduced: Path) -> EffectModel:
    """Return the model of `case`, its effects included, with the specimens in the folder `reduced`.

    Raises
    ------
    ConfigError
        If an effect of the case is not known, or two do not work together.
    """
    return EffectModel.build(make_problem(case, reduced), parse_effects(case.effects, case.name))


def check_effects(case: Case) -> None:
    """Check, on four nodes and before anything is meshed, that the solver of `case` knows all that its effects do.

    Raises
    ------
    InputError
        Naming what it does not.
    ConfigError
        If an effect is not known, does nothing in the rig, or two do not work together.
    """
    for effect in parse_effects(case.effects, case.name):
        if all(getattr(type(effect), act) is getattr(Effect, act) for act in ACTS_IN_RIG):
            raise ConfigError(f"effects.{effect.id}: does nothing in a run of the rig, as it overrides none of "
                              f"{', '.join(ACTS_IN_RIG)}; leave it out, or override one")
    if case.solver.method is not PeriodicMethod.DLFT or not case.effects:
        return
    side = 0.5 * case.specimen.upper.contact_width
    face = Interface(nodes=side * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]]),
                     areas=np.full(4, side**2), gap=np.zeros(4))
    stiffness = case.specimen.upper.youngs_modulus * side * np.eye(12)
    test = case.test
    problem = rig_problem(QuasiStaticJoint.from_stiffness(stiffness, LumpedRig.of(case.rig)), face,
                          case.contact.friction_coefficient, test.excitation_frequency, test.excitation_amplitude,
                          test.normal_load)
    model = EffectModel.build(problem, parse_effects(case.effects, case.name))
    refuse_unknown(model.problem(model.initial()), 'solver.method = "dlft"')
