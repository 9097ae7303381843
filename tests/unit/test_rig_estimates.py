"""Parameters as they are reported."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.experiments.rig.experiment import BASELINE
from fretflow.experiments.rig.words import _estimate, estimates
from fretflow.inference.parameters import Parameters

NOTHING: Any = SimpleNamespace()


def refitted(friction: float) -> tuple[Any, Any]:
    """Return a case and a rig with what the baseline refits."""
    case = SimpleNamespace(specimen=SimpleNamespace(lower=SimpleNamespace(youngs_modulus=200e9)),
                           rig=SimpleNamespace(moving_mass=10.0, damping_ratio=0.01, hinge_damping_ratio=None))
    return case, SimpleNamespace(problem=SimpleNamespace(friction_coefficient=np.array([friction])),
                                 wear_coefficient=1e-14)


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_angles_are_given_within_one_turn(turns):
    """A phase that the fit found a turn further on is the same phase, with the same interval."""
    space = Parameters.of((), ("excitation-distortion",))
    phase = next(one for one in space.coordinates if one.field == "third_phase")
    z = (1.0 + 2.0 * np.pi * turns) / phase.size
    estimate = _estimate(NOTHING, NOTHING, phase, z, 0.1 / phase.size, np.array([z]))
    assert (estimate.value, estimate.low, estimate.high) == pytest.approx((1.0, 0.9, 1.1))


def test_what_is_no_angle_keeps_its_value():
    space = Parameters.of((), ("force-offset",))
    force = next(one for one in space.coordinates if one.field == "force_offset")
    estimate = _estimate(NOTHING, NOTHING, force, 1.0, 0.5, np.ones(1))
    assert estimate.value == pytest.approx(force.value(1.0))
    assert estimate.low < estimate.value < estimate.high


def test_refitted_compliance_is_told_as_a_modulus_with_its_interval():
    """Softer by 10 % is a modulus of 200/1.1 GPa; it had stood in the case file alone."""
    soft = next(one for one in BASELINE if one.field == "compliance")
    case, rig = refitted(0.5)
    z = np.log(1.1) / soft.size
    estimate = _estimate(case, rig, soft, z, 0.5, np.array([0.0, z]))
    assert estimate.value == pytest.approx(200e9 / 1.1)
    assert estimate.low < estimate.value < estimate.high
    assert estimate.draws == pytest.approx([200e9, 200e9 / 1.1])
    assert (estimate.name, estimate.unit) == ("specimen.lower.youngs_modulus", "Pa")


@pytest.mark.parametrize(("load_sd", "half"), [(0.0, 1.645 * 0.003), (0.004, 1.645 * 0.005)])
def test_friction_is_known_no_better_than_the_load(load_sd, half):
    """A product known to 0.3 % over a load known to 0.4 % is known to 0.5 %; the mass is none of that."""
    space = Parameters.of([one for one in BASELINE if one.field in ("friction", "mass")], ())
    sd = np.array([0.003, 0.01]) / [one.size for one in space.coordinates]
    case, rig = refitted(0.8)
    friction, mass = estimates(case, rig, space, np.zeros(2), np.diag(sd**2), load_sd)
    assert (friction.low, friction.high) == pytest.approx((0.8 * np.exp(-half), 0.8 * np.exp(half)), rel=1e-5)
    assert mass.high == pytest.approx(10.0 * np.exp(1.645 * 0.01), rel=1e-4)
    assert np.std(np.log(friction.draws)) == pytest.approx(half / 1.645, rel=0.1)
