"""What facts are of: the quantities of `recordings.kinds.facts`, read off a worn test, simulated or run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isqrt
from types import MappingProxyType

import numpy as np
from scipy.integrate import trapezoid

from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.core.records import Array
from fretflow.experiments.rig.model import on_points
from fretflow.recordings.kinds.facts import CORNER, SETTLED_WITHIN, Fact
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.wear.history import WearHistory


@dataclass(frozen=True)
class WornTest:
    """A test as far as facts see it."""

    interface: Interface
    normal_load: float  # N
    unworn: PeriodicSolution
    history: WearHistory
    resonance: Callable[[int], float | None]  # Hz after so many cycles; None where it is not known

    def reaches(self, cycles: int) -> bool:
        """Tell whether the test went so far, or nothing changes any more."""
        return bool(cycles <= self.history.cycles[-1]) or self.history.stopped_by == "vanishing rate"

    def depth(self, cycles: int) -> Array:
        """Return the depth (nodes,) after some cycles, m, linear between the steps of the wear."""
        return np.array([np.interp(cycles, self.history.cycles, own) for own in self.history.depth.T])

    def volume(self, cycles: int) -> float:
        """Return the worn volume after some cycles, m^3."""
        return float(self.interface.areas @ self.depth(cycles))

    def corners(self, cycles: int) -> float:
        """Return the mean depth in the corners after some cycles, m, at as many places a side as there are nodes."""
        nodes = self.interface.nodes
        low, high = nodes.min(axis=0), nodes.max(axis=0)
        places = isqrt(len(nodes))
        inner = CORNER + (1.0 - CORNER) * (np.arange(places) + 0.5) / places
        side = np.r_[-inner, inner]
        places = 0.5 * (low + high) + 0.5 * (high - low) * np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        return float(on_points(nodes, self.depth(cycles), places).mean())


def quantity_of(fact: Fact, cycles: int, test: WornTest) -> float | None:
    """Return in SI what a fact is of after `cycles` of a test; None where the test does not tell."""
    if not test.reaches(max(cycles, fact.since or 0)):
        return None
    if fact.quantity == "corner-depth-growth":
        before = test.corners(fact.since or 0)
        return test.corners(cycles) / before if before > 0.0 else None
    return READERS[fact.quantity](test, cycles)


def mean_sliding(history: WearHistory, cycles: int) -> float:
    """Return the sliding distance averaged over so many cycles from the start (trapezoidal), m."""
    if not cycles:
        return float(history.sliding_distance[0])
    counts = np.unique(np.r_[history.cycles[history.cycles < cycles], cycles])
    return float(trapezoid(np.interp(counts, history.cycles, history.sliding_distance), counts)) / cycles


def _resonance_change(test: WornTest, cycles: int) -> float | None:
    before, after = test.resonance(0), test.resonance(cycles)
    return None if before is None or after is None else after / before - 1.0


def _corner_ratio(test: WornTest, cycles: int) -> float | None:
    volume = test.volume(cycles)
    return test.corners(cycles) * float(test.interface.areas.sum()) / volume if volume > 0.0 else None


def _corner_share(test: WornTest, cycles: int) -> float | None:
    ratio = _corner_ratio(test, cycles)
    return None if ratio is None else (1.0 - CORNER)**2 * ratio


def settling_cycles(test: WornTest, cycles: int) -> float | None:
    """Return the cycles from which on the volume rate stays near that after `cycles`; None without wear.

    The crossing lies between two steps, in proportion on a logarithmic scale of cycles.
    """
    own = test.history
    kept = own.cycles <= cycles
    counts, rate = own.cycles[kept], own.rate[kept] @ test.interface.areas
    if not rate[-1] > 0.0:
        return None
    beyond = np.abs(rate / rate[-1] - 1.0) - SETTLED_WITHIN
    away = np.flatnonzero(beyond > 0.0)
    if not len(away):
        return 0.0
    last = int(away[-1])
    share = beyond[last] / (beyond[last] - beyond[last + 1])
    before, after = np.log1p(counts[last:last + 2])
    return float(np.expm1(before + share * (after - before)))


def _slip_outside(test: WornTest, cycles: int) -> float | None:
    """Return how much farther out slip lies than stick, in half widths; None where both never occur at once."""
    nodes, areas, state = test.interface.nodes, test.interface.areas, test.unworn.state
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    distance = np.abs((2.0 * nodes - low - high) / (high - low)).max(axis=1)
    slip, stick = state == ContactState.SLIP, state == ContactState.STICK
    mixed = slip.any(axis=1) & stick.any(axis=1)
    if not mixed.any():
        return None
    outer, inner = (float(np.sum(own[mixed] * areas * distance) / np.sum(own[mixed] * areas)) for own in (slip, stick))
    return outer - inner


def _stick_share(test: WornTest, cycles: int) -> float:
    areas = test.interface.areas
    return float(areas[np.all(test.unworn.state == ContactState.STICK, axis=0)].sum() / areas.sum())


def _wear_coefficient(test: WornTest, cycles: int) -> float | None:
    path = 2.0 * cycles * mean_sliding(test.history, cycles)
    return test.volume(cycles) / (test.normal_load * path) if path > 0.0 else None


READERS: Mapping[str, Callable[[WornTest, int], float | None]] = MappingProxyType({
    "sliding-distance": lambda test, cycles: mean_sliding(test.history, cycles),
    "resonance": lambda test, cycles: test.resonance(cycles), "resonance-change": _resonance_change,
    "corner-share": _corner_share, "corner-depth-ratio": _corner_ratio, "settling-cycles": settling_cycles,
    "slip-outside": _slip_outside, "stick-share": _stick_share, "wear-coefficient": _wear_coefficient,
    "wear-volume": lambda test, cycles: test.volume(cycles)})
