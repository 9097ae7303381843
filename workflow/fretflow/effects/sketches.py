"""Small pictures of effects: a typical loop without and with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fretflow.core.records import Array
from fretflow.structure.driven import ActsOnMotion, Sliders, driven_force
from fretflow.structure.motion import Motion

# The rig of test 1, which the ranges of the catalogue are of: N/m, N, m, and s in which the phase goes on by one.
STIFFNESS, LIMIT, AMPLITUDE, TIME = 28e6, 50.0, 7e-6, 1.0 / (2.0 * np.pi * 100.0)
SAMPLES, PERIODS = 400, 4


@dataclass(frozen=True)
class Sketch:
    """A small picture of an effect: labelled curves (x, y) in the units that the axes name."""

    x_label: str
    y_label: str
    curves: Mapping[str, tuple[Array, Array]]


def loop_sketch(effect: ActsOnMotion) -> Sketch:
    """Return the loop of the slider that a motion drives at 100 Hz, without and with `effect`."""
    phase = 2.0 * np.pi * np.arange(PERIODS * SAMPLES + 1) / SAMPLES
    x = AMPLITUDE * np.cos(phase)
    motion = Motion(step=TIME * float(phase[1]), displacement=x, velocity=-AMPLITUDE / TIME * np.sin(phase),
                    acceleration=-x / TIME**2, lean=1.0)
    return Sketch("displacement in µm", "friction force in N",
                  {name: _loop(effects, motion) for name, effects in (("baseline", ()), ("effect", (effect,)))})


def _loop(effects: tuple[ActsOnMotion, ...], motion: Motion) -> tuple[Array, Array]:
    """Return the last period, so that what was at the start is over."""
    response = driven_force(motion, Sliders.one(STIFFNESS, LIMIT), 0.0, effects)
    return 1e6 * response.displacement[-SAMPLES - 1:], response.measured[-SAMPLES - 1:]
