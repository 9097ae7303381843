"""The worlds that cases live in: a rig that stays the same, or one drawn anew for every case, with either kind of laws.

======  ========================================================  =========================================
world   specimens, mesh, integrator, rig, plan, channels, noise   laws of what is hidden
======  ========================================================  =========================================
1       those of one rig, of which a few numbers are drawn        the catalogue's
2       those of one rig                                          other forms, where the literature has any
3       drawn anew                                                the catalogue's
4       drawn anew                                                other forms, drawn anew
======  ========================================================  =========================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from fretflow_trial.campaign import Plan
from fretflow_trial.hidden import decades, even
from fretflow_trial.joint import RIGID_SPRINGS, Joint, Specimen, half_spaces, meshed, specimens
from fretflow_trial.physics import Condition, Physics
from fretflow_trial.rig import Rig, Scheme
from fretflow_trial.signal import Noise

BASIC = ("displacement", "friction_force")
MORE = ("normal_force", "approach")
DRIVE_RECORDED = 0.85  # of the cases; in the others nothing tells the phase against the drive
# Radians a step of the fastest mode up to which central differences shift its frequency by 1 % (a 24th of the square).
FINEST = 0.5
YIELDING = 0.02  # of the bodies' compliance: asperities that yield less are within what a modulus is known to
SLIDING = 2e-6  # m, of the faces from end to end: less is no gross slip


@dataclass(frozen=True)
class World:
    """Whether rig and laws are drawn anew."""

    anew: bool
    other_laws: bool


WORLDS: Mapping[int, World] = {1: World(False, False), 2: World(False, True), 3: World(True, False),
                               4: World(True, True)}


@dataclass(frozen=True)
class Setting:
    """All that is set before anything is hidden."""

    joint: Joint
    physics: Physics  # the baseline's, with its true parameters
    stated: Specimen  # as the recording has it
    stated_mass: float  # kg, likewise
    plan: Plan
    noise: Noise
    channels: tuple[str, ...]
    repeats: int
    drive_recorded: bool
    map_points: int  # of the wear map, a side
    least_slip: float  # m, of the faces from end to end in every loop


def standing(rng: Generator) -> Setting:
    """Return the rig that stays the same but for its load, drive, mass, friction, wear, cycles and noise."""
    cycles = int(round(decades(rng, 1.5e5, 6e5), -4))
    main = Condition(float(np.round(even(rng, 56.0, 70.0), 1)), float(np.round(even(rng, 54.0, 66.0), 1)), 100.0)
    stated = float(np.round(even(rng, 10.0, 11.0), 1))
    rig = Rig(block_mass=stated * even(rng, 0.97, 1.03))
    physics = Physics(rig=rig, friction=even(rng, 0.72, 0.92), wear=decades(rng, 0.6e-14, 2.2e-14))
    shares = np.array([0.005, 0.03, 0.1, 0.2, 0.33, 0.5, 0.73, 1.0])
    more = rng.choice([0.015, 0.06, 0.15, 0.62, 0.87], size=int(rng.integers(0, 3)), replace=False)
    counts = [0] + [int(round(share * cycles, -2)) for share in sorted([*shares, *more])]
    sweep = (replace(main, amplitude=round(main.amplitude * 0.9, 1)),
             replace(main, amplitude=round(main.amplitude * 1.13, 1)),
             replace(main, amplitude=round(main.amplitude * 1.25, 1)),
             replace(main, load=round(main.load * 0.75, 1)), replace(main, frequency=80.0))
    level = even(rng, 0.01, 0.02)
    noise = Noise({"displacement": level * 12e-6, "friction_force": level * 0.85 * main.load,
                   "normal_force": 0.5 * level * main.load, "approach": 0.05e-6, "excitation": 0.003 * main.amplitude},
                  0.004, {"displacement": 0.3e-6, "friction_force": 0.3, "normal_force": 0.1, "approach": 0.03e-6,
                          "excitation": 0.001}, even(rng, 0.002, 0.004), even(rng, 0.001, 0.003), 0.05e-6, 0.01)
    channels = BASIC + (MORE if rng.random() < 0.75 else ())
    return Setting(specimens(), physics, Specimen(), stated, Plan(main, tuple(counts), sweep), noise, channels, 3,
                   bool(rng.random() < DRIVE_RECORDED), 9, 0.0)


def drawn(rng: Generator) -> Setting:
    """Return a rig, its specimens and their mesh, an integrator, a plan, channels and noise, all drawn anew."""
    joint, stated = _joint(rng)
    frequency = float(np.round(even(rng, 85.0, 130.0)))
    stated_mass = float(np.round(even(rng, 8.0, 16.0), 1))
    rig = Rig(stated_mass * even(rng, 0.97, 1.03), float(np.round(even(rng, 0.3, 0.8), 2)),
              float(np.round(frequency * even(rng, 0.3, 0.5))), float(np.round(even(rng, 1500.0, 3500.0), -1)),
              float(np.round(decades(rng, 0.005, 0.02), 4)))
    elastic = float(np.linalg.inv(joint.sliding).sum())
    softest = elastic / (YIELDING * joint.areas.sum())
    physics = Physics(rig=rig, friction=even(rng, 0.5, 0.95), wear=decades(rng, 0.4e-14, 3e-14),
                      rigid=decades(rng, min(softest, RIGID_SPRINGS), RIGID_SPRINGS))
    load = float(np.round(even(rng, 40.0, 90.0), 1))
    # Friction's first harmonic in quadrature with what accelerates the masses through a stroke (J. P. Den Hartog,
    # Trans. ASME 53 (1931) 107-115): above 4 / pi of the limit the joint does not come to rest.
    omega, stroke = 2.0 * np.pi * frequency, even(rng, 1e-6, 8e-6)
    inertia = ((rig.block_mass + rig.arm_mass) * omega**2 - rig.ground) * stroke
    main = Condition(float(np.round(np.hypot(inertia, 4.0 / np.pi * physics.friction * load), 1)), load, frequency)
    return Setting(joint, physics, stated, stated_mass, _plan(rng, main, rig, joint.size), _noise(rng, main),
                   BASIC + tuple(name for name in MORE if rng.random() < 0.6), int(rng.integers(2, 6)),
                   bool(rng.random() < DRIVE_RECORDED), int(rng.integers(6, 14)), SLIDING)


def _joint(rng: Generator) -> tuple[Joint, Specimen]:
    """Return specimens on a mesh, and what their drawing says: their modulus is known to two per cent."""
    modulus, poisson = [(193e9, 0.29), (205e9, 0.3), (115e9, 0.32)][int(rng.choice(3, p=(0.5, 0.3, 0.2)))]
    stated = Specimen(modulus, poisson, *(1e-3 * np.round(even(rng, low, high), 2) for low, high in (
        (0.8, 1.25), (0.8, 1.25), (5.0, 7.0), (4.0, 6.0))))
    true = replace(stated, youngs_modulus=modulus * even(rng, 0.98, 1.02))
    elements = int(rng.choice([2, 3], p=(0.75, 0.25)))
    inside = np.linspace(-1.0, 1.0, elements + 1)[1:-1] + rng.uniform(-0.15, 0.15, elements - 1)
    outside, upwards = [0.2 * even(rng, 0.7, 1.3)], sorted(even(rng, low, high) for low, high in (
        (0.08, 0.16), (0.3, 0.5)))
    if rng.random() < 0.5:
        coarse = meshed(true, [0.0], outside, upwards)
        return half_spaces(coarse, int(rng.integers(5, 10))), stated
    return meshed(true, list(inside), outside, upwards), stated


def _plan(rng: Generator, main: Condition, rig: Rig, nodes: int) -> Plan:
    cycles, count = int(round(decades(rng, 8e4, 8e5), -4)), int(rng.integers(4, 13))
    places = (np.arange(1, count) + rng.uniform(-0.3, 0.3, count - 1)) / count
    shares = np.append(places**even(rng, 1.0, 4.0), 1.0)  # even in cycles, or most of them early
    counts = sorted({0, *(int(round(share * cycles, -2)) for share in shares)})
    others = [replace(main, amplitude=round(main.amplitude * even(rng, 0.95, 0.98), 1)),
              replace(main, amplitude=round(main.amplitude * even(rng, 1.05, 1.12), 1)),
              replace(main, amplitude=round(main.amplitude * even(rng, 1.12, 1.25), 1)),
              replace(main, load=round(main.load * even(rng, 0.65, 0.9), 1)),
              replace(main, frequency=float(round(main.frequency * even(rng, 0.8, 0.9))))]
    chosen = sorted(rng.choice(len(others), int(rng.integers(1, len(others) + 1)), replace=False))
    samples = int(rng.choice([64, 100, 128, 200, 256, 400, 512]))
    most = 1000 if nodes <= 64 else 512  # steps, or a case of many nodes takes minutes
    steps = samples * int(rng.integers(np.ceil(200 / samples), most // samples + 1))
    turn = 1.2 * 2.0 * np.pi * rig.out_of_phase / (0.8 * main.frequency * steps)  # faster with the contact's spring
    schemes = [Scheme(), Scheme("implicit"), Scheme("implicit", even(rng, 0.5, 0.6))]
    schemes += [Scheme("explicit")] if turn < FINEST else []
    scheme = schemes[int(rng.integers(len(schemes)))]
    return Plan(main, tuple(counts), tuple(others[k] for k in chosen), samples, steps, scheme)


def _noise(rng: Generator, main: Condition) -> Noise:
    level = {name: decades(rng, 0.004, 0.02) for name in (*BASIC, *MORE)}
    sample = {"displacement": level["displacement"] * 12e-6, "friction_force": level["friction_force"] * main.load,
              "normal_force": 0.5 * level["normal_force"] * main.load, "approach": level["approach"] * 10e-6,
              "excitation": decades(rng, 0.001, 0.006) * main.amplitude}
    offset = {"displacement": decades(rng, 0.05e-6, 0.5e-6), "friction_force": decades(rng, 0.1, 0.6),
              "normal_force": 0.1, "approach": 0.03e-6, "excitation": 0.001}
    colour = even(rng, 0.3, 0.9) if rng.random() < 0.5 else 0.0
    return Noise(sample, float(np.round(decades(rng, 0.002, 0.01), 4)), offset, decades(rng, 5e-4, 5e-3),
                 decades(rng, 5e-4, 4e-3), decades(rng, 0.02e-6, 0.2e-6), decades(rng, 0.005, 0.03), colour)
