"""Parameters as they are reported."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.experiments.rig.words import _estimate
from fretflow.inference.parameters import Parameters

NOTHING: Any = SimpleNamespace()


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_angles_are_given_within_one_turn(turns):
    """A phase that the fit found a turn further on is the same phase, with the same interval."""
    space = Parameters.of((), ("excitation-distortion",))
    phase = next(one for one in space.coordinates if one.field == "third_phase")
    z = (1.0 + 2.0 * np.pi * turns) / phase.size
    found = _estimate(NOTHING, phase, z, 0.1 / phase.size)
    assert (found.value, found.low, found.high) == pytest.approx((1.0, 0.9, 1.1))


def test_what_is_no_angle_keeps_its_value():
    space = Parameters.of((), ("force-offset",))
    force = next(one for one in space.coordinates if one.field == "force_offset")
    found = _estimate(NOTHING, force, 1.0, 0.5)
    assert found.value == pytest.approx(force.value(1.0))
    assert found.low < found.value < found.high
