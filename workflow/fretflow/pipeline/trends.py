"""The paper's trends, each judged on the results of a run.

Source: Tubita et al. 2021, sections 2.2, 4.2 and 4.3. A judgement compares; it never alters a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Case, Specimen
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.wear.history import WearHistory

PUBLISHED_SLIDING = {53.0: 14e-6, 75.0: 22e-6}  # m by excitation in N, section 2.2
FREQUENCY, LOAD, FRICTION = 100.0, 60.0, 0.88  # Hz, N, 1, of all its tests, section 2.2
STEEL = ("youngs_modulus", "poissons_ratio", "density")  # of its specimens: a case's defaults
SETTLED_CYCLES, EITHER_WAY = 500_000, 0.5  # section 4.3; figure 7 tells the one figure to half of it either way
SETTLED_WITHIN = 0.1  # of the final rate
MAINLY = 0.5  # of the worn volume: where more of it lies, wear is "mainly localised" (section 4.3)
SLIDING_WITHIN = 0.1  # of the published distance
CORNER = 0.75  # share of the half width from which on, in both directions, a node counts as corner


@dataclass(frozen=True)
class Trend:
    """What the paper saw and what a run shows; `met` is None where the run cannot tell."""

    name: str
    met: bool | None
    found: str
    paper: str


def is_papers(case: Case) -> bool:
    """Return whether `case` is one of the paper's tests as far as the joint goes: load, excitation, steel, friction."""
    test, steel = case.test, Specimen()
    stated = [(test.excitation_frequency, FREQUENCY), (test.normal_load, LOAD),
              (case.contact.friction_coefficient, FRICTION),
              *((getattr(side, name), getattr(steel, name)) for side in (case.specimen.upper, case.specimen.lower)
                for name in STEEL)]
    return round(test.excitation_amplitude, 3) in PUBLISHED_SLIDING and all(np.isclose(a, b) for a, b in stated)


def judge_slip_zones(interface: Interface, solution: PeriodicSolution) -> Trend:
    """Judge whether the border slips while the middle still sticks, in the unworn `solution`."""
    name, paper = (
        "stick in the middle, slip at the borders before gross slip",
        "so before gross slip (fig. 4b)",
    )
    distance = np.abs(_centred(interface.nodes)).max(axis=1)
    slip, stick = solution.state == ContactState.SLIP, solution.state == ContactState.STICK
    mixed = slip.any(axis=1) & stick.any(axis=1)
    if not mixed.any():
        return Trend(name, None, "no instant with both stick and slip", paper)
    outer = _weighted(distance, slip[mixed] * interface.areas)
    inner = _weighted(distance, stick[mixed] * interface.areas)
    return Trend(
        name,
        outer > inner,
        f"while both occur, slip lies at {outer:.2f} and stick at {inner:.2f} of the "
        "half width from the centre",
        paper,
    )


def judge_wear_pattern(interface: Interface, history: WearHistory) -> Trend:
    """Judge whether wear lies mainly in the corners and evens out; an early state is a tenth of the test."""
    name, paper = (
        "wear first at the corners, later uniform",
        "mainly in the corners at 190,000 cycles, uniform at 1,900,000 (fig. 5)",
    )
    end = int(history.cycles[-1])
    early = int(np.argmin(np.abs(history.cycles - end / 10)))
    if early == 0 or early == len(history.cycles) - 1 or not history.volume[-1] > 0.0:
        return Trend(name, None, "too few wear steps to tell early from late", paper)
    areas = interface.areas
    corners = np.all(np.abs(_centred(interface.nodes)) >= CORNER, axis=1)
    first, last = (_weighted(history.depth[k][corners], areas[corners]) / _weighted(history.depth[k], areas)
                   for k in (early, -1))
    part = float(areas[corners].sum() / areas.sum())
    return Trend(
        name,
        first * part > MAINLY and abs(last - 1.0) < abs(first - 1.0),
        f"corner over mean depth: {first:.2f} at {history.cycles[early]:,} cycles, {last:.2f} at {end:,}; the corners, "
        f"{100.0 * part:.0f} % of the face, hold {100.0 * first * part:.0f} % of the early wear",
        paper,
    )


def judge_settling(history: WearHistory) -> Trend:
    """Judge whether the wear rate comes within a tenth of its final value after about half a million cycles."""
    name, paper = "wear rate settles after about 500,000 cycles", "constant from 500,000 cycles on (fig. 7)"
    settled = settling_cycles(history)
    if settled is None or history.cycles[-1] < 2 * SETTLED_CYCLES:
        return Trend(name, None, f"{history.cycles[-1]:,} cycles are too few to tell", paper)
    return Trend(name, abs(settled / SETTLED_CYCLES - 1.0) <= EITHER_WAY,
                 f"within {100.0 * SETTLED_WITHIN:.0f} % of the final rate from {settled:,} cycles on", paper)


def settling_cycles(history: WearHistory) -> int | None:
    """Return the cycles from which on the volume rate stays near its last value; None without wear."""
    rates = np.diff(history.volume) / np.diff(history.cycles)
    if not len(rates) or not rates[-1] > 0.0:
        return None
    away = np.flatnonzero(np.abs(rates / rates[-1] - 1.0) > SETTLED_WITHIN)
    return int(history.cycles[away[-1] + 1]) if len(away) else 0


def judge_resonance(unworn: float, worn: float) -> Trend:
    """Judge whether the first resonance (Hz) rises with wear."""
    return Trend("first resonance rises with wear", worn > unworn,
                 f"{unworn:.4g} Hz unworn, {worn:.4g} Hz worn ({100.0 * (worn / unworn - 1.0):+.2f} %)",
                 "the first natural frequency increases (fig. 6a)")


def judge_sliding(excitation: float, history: WearHistory) -> Trend:
    """Judge the mean sliding distance of the test against the one published for `excitation` (N)."""
    name = "sliding about 14 µm at 53 N and 22 µm at 75 N"
    found = mean_sliding(history)
    published = PUBLISHED_SLIDING.get(round(excitation, 3))
    text = f"{found * 1e6:.2f} µm at {excitation:g} N, mean of the test"
    if published is None:
        return Trend(name, None, text, "published for 53 N and 75 N only")
    return Trend(name, abs(found / published - 1.0) <= SLIDING_WITHIN, text,
                 f"{published * 1e6:.0f} µm at {excitation:g} N")


def mean_sliding(history: WearHistory) -> float:
    """Return the sliding distance averaged over the cycles (trapezoidal), m."""
    if len(history.cycles) == 1:
        return float(history.sliding_distance[0])
    means = 0.5 * (history.sliding_distance[1:] + history.sliding_distance[:-1])
    return _weighted(means, np.diff(history.cycles).astype(float))


def judge_all(interface: Interface, excitation: float, unworn: PeriodicSolution,
              history: WearHistory, resonances: tuple[float, float] | None) -> Sequence[Trend]:
    """Return every trend, in the paper's order; `resonances` are the unworn and the worn one (Hz).

    The paper's faces are flat, so that a curved one cannot tell.
    """
    judged = [judge_slip_zones(interface, unworn), judge_wear_pattern(interface, history)]
    if resonances is not None:
        judged.append(judge_resonance(*resonances))
    judged += [judge_settling(history), judge_sliding(excitation, history)]
    if np.ptp(interface.gap) > 0.0:
        return [replace(trend, met=None, found=f"{trend.found}; these faces are curved, the paper's flat")
                for trend in judged]
    return judged


def _centred(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions (nodes, 2) between -1 and 1 in both directions."""
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    return np.asarray((2.0 * nodes - low - high) / (high - low))


def _weighted(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    return float(np.sum(weights * values) / np.sum(weights))
