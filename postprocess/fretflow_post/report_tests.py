"""The report's worn volumes of a wear series: predicted over measured, before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from fretflow.core.units import readable_unit
from fretflow.inference.verdict import WearTests
from fretflow.inference.words import number, pretty_unit
from markupsafe import Markup
from numpy.typing import NDArray

from fretflow_post.report_svg import Chart, extent, horizontal, vertical

Array = NDArray[np.float64]

RADIUS = 3.4  # pixels


@dataclass(frozen=True)
class TestsView:
    """A chart for each prediction, with its title and what it says."""

    __test__ = False

    panels: tuple[tuple[str, Markup, str], ...]  # "before" or "after", chart, words


def tests_view(tests: WearTests | None, with_after: bool) -> TestsView | None:
    """Return the worn volumes as charts on one scale, or None where there are none."""
    if tests is None or not len(tests.measured):
        return None
    shown = [("before", tests.before, tests.r2_before)] + (
        [("after", tests.after, tests.r2_after)] if with_after else [])
    unit, size = readable_unit(float(np.median(tests.measured)), "m^3")
    if unit == "um^3":
        unit, size = "mm^3", 1e-9  # which wear volumes are told in
    reach = extent([values / size for values in (tests.measured, *(one[1] for one in shown))], around_zero=True)
    printed = pretty_unit(unit)
    return TestsView(tuple((name, _chart(tests, values, name, printed, size, reach), f"R² = {number(r2, 0.01)}")
                           for name, values, r2 in shown))


def _chart(tests: WearTests, predicted: Array, name: str, unit: str, size: float, reach: tuple[float, float]) -> Markup:
    chart = Chart(horizontal(f"measured volume ({unit})", *reach, unit), vertical(f"predicted volume ({unit})", *reach,
                                                                                   unit),
                  f"predicted volume {name} over measured volume of each test")
    ends = np.array(reach)
    chart.curve("equal", "equal", ends, ends)
    for row, x, y in zip(tests.rows, tests.measured / size, predicted / size, strict=True):
        chart.parts.append(Markup(
            '<circle class="at {}" cx="{:.1f}" cy="{:.1f}" r="{}"><title>row {}: measured {} {}, predicted {}</title>'
            "</circle>").format(name, float(chart.x.pixels(x)), float(chart.y.pixels(y)), RADIUS, row, number(float(x)),
                                unit, number(float(y))))
    return chart.markup()
