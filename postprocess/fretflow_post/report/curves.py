"""Backbones, responses and worn profiles in the report: measured points, and the curves of both predictions."""

from __future__ import annotations

import numpy as np
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.verdict import MeasuredCurve
from fretflow.inference.words import number
from markupsafe import Markup

from fretflow_post.report.svg import Chart, extent, horizontal, vertical

RADIUS = 3.0  # pixels of a measured point
FIXED = {"1": ("%", 0.01), "Hz": ("Hz", 1.0), "m*kg^0.5": ("m·√kg", 1.0)}  # which need no other size or have none


def curve_views(curves: tuple[MeasuredCurve, ...], with_after: bool) -> tuple[tuple[str, Markup], ...]:
    """Return the title and the chart of each curve."""
    return tuple((one.label, _chart(one, with_after)) for one in curves)


def _chart(one: MeasuredCurve, with_after: bool) -> Markup:
    shown = {"before": one.before} | ({"after": one.after} if with_after else {})
    (x_unit, x_size), (y_unit, y_size) = (FIXED.get(unit) or _readable(values, unit) for values, unit in (
        (one.x, one.x_unit), (one.measured, one.y_unit)))
    reach = extent([values / y_size for values in (one.measured, *shown.values())])
    chart = Chart(horizontal(f"{one.x_label} ({x_unit})", *extent([one.x / x_size]), x_unit),
                  vertical(f"{one.y_label} ({y_unit})", *reach, y_unit),
                  f"{one.y_label} over {one.x_label}, measured and predicted")
    for name, values in shown.items():
        chart.curve(name, name, one.x / x_size, values / y_size)
    for x, y in zip(one.x / x_size, one.measured / y_size, strict=True):
        chart.parts.append(Markup(
            '<circle class="at measured" cx="{:.1f}" cy="{:.1f}" r="{}"><title>{} {}, measured {} {}</title></circle>'
        ).format(float(chart.x.pixels(x)), float(chart.y.pixels(y)), RADIUS, number(float(x)), x_unit, number(float(y)),
                 y_unit))
    return chart.markup()


def _readable(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]], unit: str) -> tuple[str, float]:
    found, size = readable_unit(float(np.median(np.abs(values))), unit)
    return pretty_unit(found), size
