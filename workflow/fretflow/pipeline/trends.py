"""The paper's claims, each judged on the results of a run of its own tests.

They are the facts of ``examples/paper.toml``, which a diagnosis takes as a recording (Tubita et al. 2021, sections 2.2,
4.2 and 4.3). A judgement compares; it never alters a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fretflow.case.config import Case, Specimen, Test
from fretflow.contact.interface import Interface
from fretflow.core.units import pretty_quantity
from fretflow.experiments import facts
from fretflow.experiments.facts.quantities import WornTest, quantity_of
from fretflow.inference.parameters import HALF
from fretflow.recordings.kinds.facts import QUANTITIES, Fact, FactsFile, read_facts
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.wear.history import WearHistory

PAPER = "paper.toml"  # in the package; the example of that name


@dataclass(frozen=True)
class Trend:
    """What the paper claims and what a run shows; `met` is None where the run cannot tell."""

    name: str
    met: bool | None
    found: str
    paper: str


@cache
def papers_facts() -> FactsFile:
    """Return the paper's facts."""
    return read_facts(Path(facts.__path__[0]) / PAPER).file


def is_papers(case: Case) -> bool:
    """Return whether `case` is one of the paper's tests as far as the joint goes: load, drive, specimens, friction."""
    test, steel, paper = case.test, Specimen(), papers_facts()
    bodies = [side.model_copy(update={"observation_distance": steel.observation_distance})
              for side in (case.specimen.upper, case.specimen.lower)]
    return (any(_same(test, paper.condition_of(fact)) for fact in paper.facts) and bodies == [steel, steel]
            and case.mesh.upper is None
            and bool(np.isclose(case.contact.friction_coefficient, paper.contact.friction_coefficient)))


def judge_all(test: Test, interface: Interface, unworn: PeriodicSolution, history: WearHistory,
              resonances: tuple[float, float] | None) -> Sequence[Trend]:
    """Return the paper's claims of a test; `resonances` are the unworn and the worn one (Hz)."""
    paper = papers_facts()
    worn = WornTest(interface=interface, normal_load=test.normal_load, unworn=unworn, history=history,
                    resonance=lambda cycles: None if resonances is None else resonances[int(cycles > 0)])
    return [judge(fact, paper.cycles_of(fact), worn) for fact in paper.facts
            if _same(test, paper.condition_of(fact))]


def judge(fact: Fact, cycles: int, test: WornTest) -> Trend:
    """Judge whether what a test shows lies within the 90 % interval of a fact, or beyond its bound."""
    value = quantity_of(fact, cycles, test)
    if value is None:
        return Trend(fact.label, None, _why(fact, cycles, test), fact.says)
    away = fact.distance(value)
    met = fact.side * away > 0.0 if fact.side else abs(away) <= HALF
    text = pretty_quantity(value, QUANTITIES[fact.quantity][0], 3)
    if not met:
        text += f": {abs(away):.1f} sd too {'high' if away > 0.0 else 'low'}{_factor(value, fact.stated)}"
    return Trend(fact.label, met, text, fact.says)


def _factor(value: float, stated: float) -> str:
    if not value > 0.0 or not stated > 0.0:
        return ""
    factor = max(value / stated, stated / value)
    return f", a factor of {factor:.3g}" if factor > 2.0 else ""


def _why(fact: Fact, cycles: int, test: WornTest) -> str:
    if not test.reaches(cycles):
        return f"{test.history.cycles[-1]:,} cycles are too few to tell"
    return "no instant with both stick and slip" if fact.quantity == "slip-outside" else "the run does not show it"


def _same(test: Test, condition: tuple[float, float, float]) -> bool:
    return bool(np.allclose((test.excitation_amplitude, test.normal_load, test.excitation_frequency), condition,
                            rtol=1e-3))
