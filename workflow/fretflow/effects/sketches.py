"""Small pictures of effects: a typical loop without and with them."""

from __future__ import annotations

import numpy as np

from fretflow.effects.driven import DrivenJoint, SliderBaseline
from fretflow.effects.effect import Array, Effect, Sketch
from fretflow.structure.motion import Motion

AMPLITUDE, FREQUENCY, SAMPLES, PERIODS = 7e-6, 100.0, 400, 4
TYPICAL = SliderBaseline()


def loop_sketch(effect: Effect, amplitude: float = AMPLITUDE) -> Sketch:
    """Return the loop of the slider that a motion of `amplitude` (m) drives at 100 Hz, without and with `effect`."""
    phase = 2.0 * np.pi * np.arange(PERIODS * SAMPLES + 1) / SAMPLES
    turning = 2.0 * np.pi * FREQUENCY
    x = amplitude * np.cos(phase)
    motion = Motion(step=1.0 / (FREQUENCY * SAMPLES), displacement=x, velocity=-turning * amplitude * np.sin(phase),
                    acceleration=-turning**2 * x, lean=1.0)
    joints = {"baseline": DrivenJoint(TYPICAL), "effect": DrivenJoint(TYPICAL, (effect,))}
    return Sketch("displacement in µm", "friction force in N",
                  {name: _loop(joint, motion) for name, joint in joints.items()})


def _loop(joint: DrivenJoint, motion: Motion) -> tuple[Array, Array]:
    """Return the last period, so that what was at the start is over."""
    found = joint.predict(motion)
    return 1e6 * found.displacement[-SAMPLES - 1:], found.measured[-SAMPLES - 1:]
