"""Asperity springs inside DLFT: exact Jacobian, and the same joint as the quasi-static solver has.

What carries the weight: differences of the residual in a period that slips, sticks and separates; springs given to a
joint are those that its flexibility would have, at every harmonic.
"""

from pathlib import Path

import numpy as np
import pytest
from fretflow.contact.interface import Interface
from fretflow.core.errors import InputError
from fretflow.effects.contact_stiffness import ContactStiffness
from fretflow.effects.load_dependent_friction import LoadDependentFriction
from fretflow.effects.model import EffectModel
from fretflow.effects.normal_load_coupling import NormalLoadCoupling
from fretflow.effects.velocity_dependent_friction import VelocityDependentFriction
from fretflow.pipeline.problem import rig_problem
from fretflow.solvers.dlft.solver import Variant, build_equations, solve_equations
from fretflow.structure.two_mass_rig.compliant import CompliantJoint
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
FEW = np.flatnonzero((np.arange(49) // 7 % 3 == 0) & (np.arange(49) % 7 % 3 == 0))
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)


def problem():
    dofs = (3 * FEW[:, None] + np.arange(3)).ravel()
    stiffness = np.linalg.inv(np.linalg.inv(1e3 * DATA["K"])[np.ix_(dofs, dofs)])
    face = Interface(nodes=1e-3 * DATA["x"][FEW, :2], areas=np.full(9, 1e-6 / 9), gap=8e-8 * np.arange(9.0))
    return rig_problem(joint=QuasiStaticJoint.from_stiffness(0.5 * (stiffness + stiffness.T), RIG), interface=face,
                           friction_coefficient=0.8, frequency=100.0, excitation=70.0, normal_load=60.0)


def with_effects(*effects):
    model = EffectModel.build(problem(), effects)
    return model.problem(model.initial())


def test_the_jacobian_is_exact_with_asperities_and_friction_by_pressure():
    given = with_effects(ContactStiffness(exponent=0.5), LoadDependentFriction(exponent=0.2))
    equations = build_equations(given, Variant(3, 64, None))
    root = solve_equations(equations, None, 1e-10, 60)
    rng = np.random.default_rng(1)
    at = root.unknowns + 1e-8 * rng.normal(size=root.unknowns.shape)
    apply, _ = equations.linearise(equations.evaluate(at))
    for _ in range(4):
        way = rng.normal(size=at.shape)
        step = 1e-13
        difference = (equations.evaluate(at + step * way).residual - equations.evaluate(at - step * way).residual) / (
            2.0 * step)
        own = apply(way.ravel()).reshape(at.shape)
        assert np.abs(own - difference).max() < 1e-6 * np.abs(difference).max()


def test_springs_are_in_series_at_every_harmonic():
    bare, springs = problem().structure, 1e-9 * np.arange(1.0, 28.0)
    one = CompliantJoint(joint=bare, springs=springs)
    given = (100.0, np.zeros((4, 3), dtype=complex))  # by harmonic: forces on block and arm, normal load
    given[1][1, 0], given[1][0, 2] = 70.0, 60.0
    own, condensed = one.dynamic_stiffness(*given), one.quasi_static().dynamic_stiffness(*given)
    assert own.stiffness == pytest.approx(condensed.stiffness, rel=1e-9, abs=1e-9 * np.abs(own.stiffness).max())
    assert own.load == pytest.approx(condensed.load, rel=1e-9, abs=1e-9 * np.abs(own.load).max())
    moved = 1e-6 * np.random.default_rng(2).normal(size=own.load.shape).astype(complex)
    series, same = (joint.motion_amplitudes(100.0, moved, given[1]) for joint in (one, one.quasi_static()))
    assert series.rig == pytest.approx(same.rig, rel=1e-8, abs=1e-15)


@pytest.mark.parametrize(("effect", "what"), [
    (VelocityDependentFriction(), "friction"), (NormalLoadCoupling(), "a normal load"),
    (NormalLoadCoupling().changed(curvature=2e4), "a normal load")])
def test_what_dlft_does_not_know_is_refused(effect, what):
    with pytest.raises(InputError, match=f"dlft.* does not know {what} that depends on the motion"):
        build_equations(with_effects(effect), Variant(3, 64, None))
