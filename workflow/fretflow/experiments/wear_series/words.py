"""What is said of a wear series' diagnosis: what to measure next, warnings, notes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fretflow.effects.volume_law import FREQUENCY, PRESSURE, SLIDING, VolumeLaw
from fretflow.experiments.wear_series.data import WearData
from fretflow.inference.verdict import ResidualLaw, WearTests
from fretflow.inference.words import listed, separating


def next_measurement(sets: Sequence[frozenset[str]], data: WearData, powers: tuple[str, ...],
                     rivals: Sequence[VolumeLaw], left: ResidualLaw | None) -> str:
    """Return the measurement that would tell alternatives apart, or more of what is left.

    Parameters
    ----------
    sets
        The alternatives, each a set of effects.
    data
        The tests.
    powers
        The states whose powers the law has.
    rivals
        Laws with powers of others that are about as probable.
    left
        What an unlisted effect does.
    """
    if left is not None:
        return (f"Tests at further values of the {left.state} with all else the same, each repeated three times, to "
                "see whether what is left follows it.")
    if len(sets) != 1:
        return separating(sets) if sets else ""
    mixed = [pair for pair in together(data) if set(pair) & set(powers)]
    if mixed:
        return f"Tests that change {mixed[0][0]} and {mixed[0][1]} apart, to tell whose power it is."
    if rivals:
        own, other = set(powers) - set(rivals[0].powers), set(rivals[0].powers) - set(powers)
        if not other:
            return f"More tests at other values of the {listed(own)}, to tell whether it has a power."
        return (f"Tests that change the {listed(own)} and keep the {listed(other)}, or the reverse, to tell whose "
                "power it is.")
    return separating(sets)


def together(data: WearData) -> tuple[tuple[str, str], ...]:
    """Return pairs of conditions that vary together: what is left of one is beside the other within its scatter.

    With n tests a correlation r leaves ``sqrt(1 - r^2)`` of a condition; the powers are told apart where that exceeds
    one test's share, ``1 / sqrt(n)``, twice over.
    """
    logs = {name: np.log(data.tests.states[name]) for name in (PRESSURE, SLIDING, FREQUENCY) if name in data.varied}
    return tuple((one, other) for one, other in combinations(logs, 2)
                 if 1.0 - float(np.corrcoef(logs[one], logs[other])[0, 1])**2 < 4.0 / data.tests.count)


def warnings(data: WearData) -> list[str]:
    """Return what limits any diagnosis of the tests."""
    return [*map(str, data.series.notes), *data.notes, *(
        f"{one} and {other} vary together in these tests, so that their powers are not known apart"
        for one, other in together(data))]


def notes(data: WearData, view: WearTests) -> list[str]:
    """Return how the tests scatter, and what of them is explained."""
    tests = data.tests
    grows = {0.0: "in proportion to the volume", 1.0: "not at all with the volume"}.get(
        tests.power, f"as the power {1.0 - tests.power:g} of the volume")
    return [f"scatter: {data.sd / tests.scale:.2g} of the volume at {1e9 * tests.scale:.3g} mm³, growing {grows}; "
            f"from {data.sd_from}",
            f"one coefficient gives R² = {view.r2_before:.2f} of the worn volumes, the model of the verdict "
            f"{view.r2_after:.2f}"]
