"""What happens in the rig: the baseline's numbers and the places where hidden physics comes in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fretflow_trial.joint import RIGID_SPRINGS
from fretflow_trial.rig import Rig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Condition:
    """How the rig is driven and loaded."""

    amplitude: float = 60.0  # N
    load: float = 60.0  # N
    frequency: float = 100.0  # Hz


@dataclass(frozen=True)
class Slow:
    """What changes from cycle to cycle."""

    cycles: float
    energy: float  # dissipated so far, J
    depth: Array  # worn off both faces, (n,) m
    layer: Array  # of debris, (n,) m
    scar: float  # half stroke to which the scar reaches, m
    elapsed: float  # share of the test that is over


@dataclass(frozen=True)
class Instant:
    """What friction may depend on at an instant; the speed is extrapolated from those before."""

    time: float
    block_velocity: float
    age: float  # of the contacts
    pressure: Array  # (n,) Pa
    friction: Array  # (n,) N, of the upper face on the lower


@dataclass(frozen=True)
class Worn:
    """What one period does to the faces: by node, per cycle."""

    work: Array  # sum of pressure times slip, N/m
    path: Array  # sum of slip, m
    power: Array  # frictional power per area, W/m^2
    frequency: float


@dataclass(frozen=True)
class Channels:
    """What the sensors show over a whole number of periods: (N,) each, SI."""

    frequency: float  # of the N samples as a whole, Hz
    periods: int  # of the drive in them
    time: Array
    excitation: Array
    displacement: Array
    friction_force: Array
    normal_force: Array
    approach: Array
    arm: Array
    velocity: Array
    acceleration: Array


Over = Callable[[Slow], float]
Springs = Callable[[Slow, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Layer:
    """Debris: what enters and leaves, how it slows wear, and how soft it is."""

    retained: float
    residence: Array  # (n,) cycles
    slows: Callable[[Array], Array]  # thickness to factor on wear
    modulus: float = 30e9  # Pa


@dataclass(frozen=True)
class Physics:
    """The rig and all that acts in it. The baseline is what the defaults give."""

    rig: Rig = field(default_factory=Rig)
    friction: float = 0.88
    wear: float = 1.1e-14  # m^2/N
    friction_over_test: tuple[Over, ...] = ()  # factors
    friction_at_instant: tuple[Callable[[Instant], float | Array], ...] = ()  # factors
    ageing: Callable[[float, float, float], float] | None = None  # age by age, mean slip and time of a step
    friction_of_node: Array | None = None  # (n,), factor
    load_over_test: tuple[Over, ...] = ()  # factors
    load_at_instant: tuple[Callable[[float, float, float], float], ...] = ()  # N beside, by load, periods, arm's place
    rig_forces: tuple[Callable[[Array, Slow], tuple[float, float]], ...] = ()  # N on block and arm
    excitation: tuple[Callable[[Array], Array], ...] = ()  # beside cos, over amplitude, by phase
    rigid: float = RIGID_SPRINGS  # N/m^3, of asperities that hardly yield
    springs: Springs | None = None  # N/m^3, sliding and normal, of asperities that do
    gap: Callable[[Array], Array] | None = None  # by nodes (n, 2) in m
    wear_factors: tuple[Callable[[Worn, Slow], Array], ...] = ()
    layer: Callable[[Array], Layer] | None = None  # by nodes
    sensors: tuple[Callable[[Channels, Slow], Channels], ...] = ()  # from the joint to the recorder
    periods: int = 1  # of the drive, after which the motion repeats


def opened(gap: Callable[[Array], Array] | None, nodes: Array) -> Array:
    """Return the gap of the unworn faces, (n,) m, zero where they meet first."""
    height = np.zeros(len(nodes)) if gap is None else gap(nodes)
    return np.asarray(height - height.min())
