"""Property: an effect of a bolted structure does nothing where it is neutral, and else what its equation says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fretflow.contact.coulomb import Coulomb
from fretflow.effects.bending_gap import FORM
from fretflow.effects.catalogue import catalogue
from fretflow.effects.effect import STRUCTURE, RecordedSize
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint
from fretflow.solvers.nonlinear_modes.quasi_static import quasi_static_backbone
from fretflow.structure.reduction.contact_modes import reduce_structure
from pydantic import ValidationError

ACTING = tuple(name for name, kind in catalogue().items() if "bolted" in vars(kind))
SIZE = RecordedSize(amplitude=5e-5, damping=0.02, least_damping=1e-3)
ASKED = np.geomspace(2e-6, 5e-5, 6)


@pytest.fixture(scope="module")
def joint(structures):
    return BoltedJoint(structure=reduce_structure(structures.lap_beam(25)), law=Coulomb(0.45), bolt_load=6e3,
                       modal_damping=1e-3)


def curve(joint):
    return quasi_static_backbone(joint, joint.linear_modes(1)[0], ASKED)


def test_the_effects_that_act_are_those_that_were_asked_for():
    assert set(ACTING) >= {"contact-stiffness", "distributed-micro-slip", "initial-gap", "load-dependent-friction",
                           "joint-damping", "bolt-load-spread", "bending-gap"}
    assert all(STRUCTURE in catalogue()[name].acts_in() for name in ACTING)
    assert STRUCTURE not in catalogue()["contact-stiffness-evolution"].acts_in()


@pytest.mark.parametrize("name", ACTING)
def test_a_neutral_effect_changes_nothing_and_a_plain_one_something(joint, name):
    plain = curve(joint)
    neutral = curve(catalogue()[name].neutral().bolted(joint))
    assert neutral.frequency == pytest.approx(plain.frequency, rel=1e-9)
    assert neutral.damping == pytest.approx(plain.damping, rel=1e-6)
    kind = catalogue()[name]
    ranges = {field: kind.bolted_range(field, prior, joint, SIZE) for field, prior in kind.priors().items()}
    inside = {field: float(np.sqrt(one.low * one.high)) if one.low > 0.0 else one.high
              for field, one in ranges.items() if one is not None}
    changed = curve(kind().changed(**inside).bolted(joint))
    assert max(np.abs(changed.frequency / plain.frequency - 1.0).max(),
               np.abs(changed.damping / plain.damping - 1.0).max()) > 1e-3


def test_of_scattered_friction_is_fitted_what_does_something(joint):
    kind, plain = catalogue()["distributed-micro-slip"], curve(catalogue()["distributed-micro-slip"]().bolted(joint))
    for field, prior in kind.priors().items():
        ends = [curve(kind().changed(**{field: end}).bolted(joint)) for end in (prior.low, prior.high)]
        change = max(np.abs(end.damping / plain.damping - 1.0).max() for end in ends)
        assert (change > 1e-3) == (kind.bolted_range(field, prior, joint, SIZE) is not None), field


def test_faces_gape_by_as_much_as_their_form_and_across_a_row_of_points_by_nothing(joint):
    kind, arch = catalogue()["initial-gap"], catalogue()["bending-gap"].priors()["height"]
    ranges = {field: kind.bolted_range(field, prior, joint, SIZE) for field, prior in kind.priors().items()}
    for field in ("tilt_x", "cylinder"):
        assert (ranges[field].high, ranges[field].low) == (arch.high, -arch.high * (field == "tilt_x"))
    for field in ("tilt_y", "crown"):  # that of a row is the cylinder's of half the height, or none
        gap = kind.neutral().changed(**{field: 2e-6}).bolted(joint).clearance
        same = kind.neutral().changed(cylinder=1e-6 * (field == "crown")).bolted(joint).clearance
        assert gap == pytest.approx(same, abs=1e-18)
        assert ranges[field] is None


def test_faces_gape_no_further_than_the_bolts_close(joint):
    """A crown as high as its range leaves some points in touch, one ten times as high hardly any."""
    kind, cylinder = catalogue()["initial-gap"], catalogue()["initial-gap"].priors()["cylinder"]
    loose, tighter = (replace(joint, bolt_load=share * joint.bolt_load) for share in (1e-3, 1e-2))
    high, higher = (kind.bolted_range("cylinder", cylinder, one, SIZE).high for one in (loose, tighter))
    assert higher == pytest.approx(10.0 * high, rel=1e-6)
    assert kind.bolted_range("cylinder", cylinder, joint, SIZE).high == FORM[1]
    closed = [kind.neutral().changed(cylinder=share * high).bolted(loose).closed.mean() for share in (0.01, 1.0, 10.0)]
    assert closed[0] > 0.8
    assert 0.2 < closed[1] < 0.6
    assert closed[2] < 0.1


@pytest.mark.parametrize("name", ["bolt-load-spread", "initial-gap", "bending-gap", "distributed-micro-slip"])
def test_across_a_single_point_nothing_differs(structures, name):
    one = structures.sliders(np.array([1e4]), np.array([0.5]))
    plain = BoltedJoint(structure=reduce_structure(replace(one, points=np.array([[0.3, 0.1, 0.0]]))), law=Coulomb(1.0),
                        bolt_load=1.0)
    assert plain.interface.nodes.shape == (1, 2)
    before, after = (quasi_static_backbone(own, own.linear_modes(1)[0], np.geomspace(3e-5, 1e-3, 5))
                     for own in (plain, catalogue()[name]().bolted(plain)))
    assert np.allclose(after.frequency, before.frequency, rtol=1e-9)


def test_unevenly_pulling_bolts_keep_their_sum(joint):
    uneven = catalogue()["bolt-load-spread"]().changed(ends=0.4, middle=-0.2).bolted(joint)
    force = uneven.preloaded.force[0, 2::3]
    assert force.sum() == pytest.approx(joint.preloaded.force[0, 2::3].sum(), rel=1e-9)
    place = joint.across[:, 0]
    assert force @ place / force.sum() > 0.05


def test_an_arch_touches_at_its_ends_and_bolts_close_it(joint):
    arch = catalogue()["bending-gap"](height="20 um").bolted(joint)
    hump = catalogue()["initial-gap"].neutral().changed(cylinder=2e-5).bolted(joint)
    assert arch.clearance[[0, -1]] == pytest.approx(0.0, abs=1e-20)
    assert hump.clearance[12] == pytest.approx(0.0, abs=1e-20)
    assert [arch.clearance[12], hump.clearance[0]] == pytest.approx([2e-5, 2e-5])
    with pytest.raises(ValidationError, match="greater than or equal to 0"):  # one form of the faces has one name
        catalogue()["bending-gap"](height="-20 um")
    pressed = arch.preloaded.force[0, 2::3]
    assert pressed[[0, -1]].sum() > joint.preloaded.force[0, [2, -1]].sum()
    assert pressed.sum() == pytest.approx(joint.preloaded.force[0, 2::3].sum(), rel=1e-9)


def test_damping_of_the_rest_grows_in_proportion(joint):
    damped = curve(catalogue()["joint-damping"](slope=40.0).bolted(joint))
    plain = curve(joint)
    assert damped.damping - plain.damping == pytest.approx(40.0 * plain.amplitude, rel=1e-9)


def test_damping_of_the_rest_may_be_little_beside_that_of_the_joint(joint):
    kind = catalogue()["joint-damping"]
    own = kind.bolted_range("slope", kind.priors()["slope"], joint, SIZE)
    assert own.low * SIZE.amplitude < 0.5 * SIZE.least_damping < 0.1 * SIZE.damping < own.high * SIZE.amplitude


def test_asperities_soften_the_mode_by_their_closed_form(structures):
    """One point of the contact carries all: its spring is in series with the body's own."""
    bare = BoltedJoint(structure=reduce_structure(structures.sliders(np.array([4e4]), np.array([50.0]))),
                       law=Coulomb(1.0), bolt_load=1.0)
    area = float(bare.structure.areas.sum())
    kind = catalogue()["contact-stiffness"]
    soft = kind().changed(stiffness=6e4, exponent=0.5, reference_pressure=50.0 / area).bolted(bare)
    series = 1.0 / (1.0 / 4e4 + 1.0 / 6e4)
    assert soft.linear_modes(1)[0].frequency == pytest.approx(np.sqrt((3e4 + series) / 2.0) / (2.0 * np.pi), rel=1e-9)
