"""Effects that the catalogue does not have; the right answer to them is that the cause is unknown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from fretflow_trial.hidden import Draw, Facts, Hidden, decades, either, even
from fretflow_trial.physics import Channels, Physics, Slow

TYPICAL_STROKE = 12e-6


def thermal_swing(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw friction that follows the room's temperature, several swings over the test, through a thermal lag."""
    size, turns, lag = even(rng, 0.05, 0.2), even(rng, 1.3, 3.5), even(rng, 0.0, 2.0 * np.pi)

    def factor(slow: Slow) -> float:
        return 1.0 + size * float(np.sin(2.0 * np.pi * turns * slow.elapsed - lag))

    return Hidden("thermal-swing", False, "mu (1 + b sin(2 pi n / n_d - lag))", ("contact",),
                  {"size": size, "swings": turns}, _over(factor))


def friction_jump(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw friction that changes at once at some cycle, as when a coating breaks through."""
    size, when = either(rng, even(rng, 0.08, 0.25)), even(rng, 0.1, 0.7) * facts.cycles

    def factor(slow: Slow) -> float:
        return 1.0 + size if slow.cycles >= when else 1.0

    return Hidden("friction-jump", False, "mu (1 + b) from cycle n_j on", ("contact",), {"size": size, "cycle": when},
                  _over(factor), cycles=(when, float(facts.cycles)))


def friction_ageing(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw contacts that strengthen at rest and lose that over a memory length of slip.

    J. H. Dieterich, J. Geophys. Res. 84 (1979) 2161-2168, as an age z between 0 and 1:
    ``dz = (1 - z) dt / tau - z ds / D``.
    """
    size, length, rest = even(rng, 0.15, 0.6), decades(rng, 0.5e-6, 4e-6), decades(rng, 1.5e-3, 8e-3)

    def ageing(age: float, slip: float, time: float) -> float:
        return (age + time / rest) / (1.0 + time / rest + slip / length)

    def apply(physics: Physics) -> Physics:
        return replace(physics, ageing=ageing, friction_at_instant=(
            *physics.friction_at_instant, lambda instant: 1.0 + size * instant.age))

    return Hidden("friction-ageing", False, "mu (1 + b z), z the age of the contacts", ("contact",),
                  {"size": size, "length": length, "time": rest}, apply)


def subharmonic_load(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw a normal load that swings at half the frequency of the drive; repeats are of either kind."""
    size, lag = even(rng, 0.05, 0.25), even(rng, 0.0, np.pi)

    def beside(load: float, turns: float, arm: float) -> float:
        return size * load * float(np.cos(np.pi * turns - lag))

    def apply(physics: Physics) -> Physics:
        return replace(physics, load_at_instant=(*physics.load_at_instant, beside), periods=2)

    return Hidden("subharmonic-load", False, "N (1 + a cos(w t / 2))", ("contact", "rig", "excitation"),
                  {"size": size}, apply)


def quadratic_displacement(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw a displacement sensor whose gain depends on the place, as an eddy-current probe near magnetic steel."""
    size = either(rng, even(rng, 0.03, 0.2))

    def sense(channels: Channels, slow: Slow) -> Channels:
        x = channels.displacement
        return replace(channels, displacement=x + size * x * x / TYPICAL_STROKE)

    return _sensor("quadratic-displacement", "x (1 + q x / 12 um)", {"size": size}, sense)


def gain_drift(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw a displacement sensor whose gain drifts over the test."""
    size = either(rng, even(rng, 0.02, 0.12))

    def sense(channels: Channels, slow: Slow) -> Channels:
        return replace(channels, displacement=channels.displacement * (1.0 + size * slow.elapsed))

    return _sensor("gain-drift", "x (1 + b s)", {"size": size}, sense)


def drive_crosstalk(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw crosstalk: the shaker's current in the cable of the displacement sensor, a quarter of a period apart."""
    size, turn = even(rng, 0.02, 0.12), even(rng, 0.25, 0.75) * np.pi

    def sense(channels: Channels, slow: Slow) -> Channels:
        swing = np.cos(2.0 * np.pi * channels.frequency * channels.periods * channels.time - turn)
        return replace(channels, displacement=channels.displacement + size * TYPICAL_STROKE * swing)

    return _sensor("drive-crosstalk", "x + e cos(w t - b)", {"size": size, "phase": turn}, sense)


def loosening_holder(rng: Generator, other: bool, facts: Facts) -> Hidden:
    """Draw a sensor's holder that comes loose at some cycle: from then on the force bends it."""
    compliance, when = decades(rng, 1e-8, 6e-8), even(rng, 0.15, 0.75) * facts.cycles

    def sense(channels: Channels, slow: Slow) -> Channels:
        loose = compliance if slow.cycles >= when else 0.0
        return replace(channels, displacement=channels.displacement + loose * channels.friction_force)

    return replace(_sensor("loosening-holder", "x + c T from cycle n_j on",
                           {"compliance": compliance, "cycle": when}, sense), cycles=(when, float(facts.cycles)))


def _over(factor: Callable[[Slow], float]) -> Callable[[Physics], Physics]:
    return lambda physics: replace(physics, friction_over_test=(*physics.friction_over_test, factor))


def _sensor(name: str, law: str, parameters: dict[str, float],
            sense: Callable[[Channels, Slow], Channels]) -> Hidden:
    return Hidden(name, False, law, ("sensor",), parameters,
                  lambda physics: replace(physics, sensors=(*physics.sensors, sense)))


DRAWS: dict[str, Draw] = {
    "thermal-swing": thermal_swing,
    "friction-jump": friction_jump,
    "friction-ageing": friction_ageing,
    "subharmonic-load": subharmonic_load,
    "quadratic-displacement": quadratic_displacement,
    "gain-drift": gain_drift,
    "drive-crosstalk": drive_crosstalk,
    "loosening-holder": loosening_holder,
}
