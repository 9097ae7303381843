"""Small pictures of effects: a typical loop without and with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fretflow.structure.driven import ActsOnMotion, Sliders, driven_force
from fretflow.structure.motion import Motion

Array = NDArray[np.float64]

AMPLITUDE, FREQUENCY, SAMPLES, PERIODS = 7e-6, 100.0, 400, 4
STIFFNESS, LIMIT = 28e6, 50.0  # N/m and N, of the rig of test 1


@dataclass(frozen=True)
class Sketch:
    """A small picture of an effect: labelled curves (x, y) in the units that the axes name."""

    x_label: str
    y_label: str
    curves: Mapping[str, tuple[Array, Array]]


def loop_sketch(effect: ActsOnMotion) -> Sketch:
    """Return the loop of the slider that a motion drives at 100 Hz, without and with `effect`."""
    phase = 2.0 * np.pi * np.arange(PERIODS * SAMPLES + 1) / SAMPLES
    turning = 2.0 * np.pi * FREQUENCY
    x = AMPLITUDE * np.cos(phase)
    motion = Motion(step=1.0 / (FREQUENCY * SAMPLES), displacement=x, velocity=-turning * AMPLITUDE * np.sin(phase),
                    acceleration=-turning**2 * x, lean=1.0)
    return Sketch("displacement in µm", "friction force in N",
                  {name: _loop(effects, motion) for name, effects in (("baseline", ()), ("effect", (effect,)))})


def _loop(effects: tuple[ActsOnMotion, ...], motion: Motion) -> tuple[Array, Array]:
    """Return the last period, so that what was at the start is over."""
    found = driven_force(motion, Sliders.one(STIFFNESS, LIMIT), 0.0, effects)
    return 1e6 * found.displacement[-SAMPLES - 1:], found.measured[-SAMPLES - 1:]
