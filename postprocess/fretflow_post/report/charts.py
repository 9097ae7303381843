"""Charts of the report: figures of Bokeh as JSON within the page, whose script shows, zooms and exports them."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import bokeh
import numpy as np
from bokeh.embed import json_item
from bokeh.models import (
    BoxZoomTool,
    ColorBar,
    ColumnDataSource,
    FixedTicker,
    HoverTool,
    LinearColorMapper,
    NoOverlap,
    NumeralTickFormatter,
    PanTool,
    PlainText,
    ResetTool,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure
from fretflow.core.records import Array
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

WIDTH, HEIGHT, LOW = 460, 330, 250  # pixels of a chart, and the height of a flat one
MARGINS = 130  # pixels above and below a map
MOST_POINTS = 600  # of a curve
# Colours on white; where the page is dark its script takes those of its style sheet.
LOOKS = {"measured": "#1b232e", "before": "#c04a00", "after": "#0068ad", "ink": "#1b232d", "muted": "#5a6674",
         "line": "#d8dee5", "paper": "#fffffe"}
LINES: dict[str, dict[str, object]] = {
    "measured": {"line_width": 3.2, "line_alpha": 0.5}, "before": {"line_width": 1.8, "line_dash": [6, 4]},
    "after": {"line_width": 1.7}}

Limits = tuple[float, float]


def script() -> str:
    """Return the library that draws charts in a browser."""
    return (Path(bokeh.__file__).parent / "server/static/js/bokeh.min.js").read_text(encoding="utf-8")


class Chart:
    """A chart that is filled step by step; `describe` is read out to those who cannot see it.

    It is as wide as there is room, and keeps its shape where its `width` is given. No text is taken for a formula.
    """

    def __init__(self, describe: str, x_label: str, y_label: str, x: Limits | None = None, y: Limits | None = None,
                 height: int = HEIGHT, width: int | None = None) -> None:
        self.describe = describe
        self.labels = x_label, y_label
        box = BoxZoomTool()
        self.figure = figure(
            width=width or WIDTH, height=height, sizing_mode="scale_width" if width else "stretch_width",
            toolbar_location="above",
            tools=[box, PanTool(), WheelZoomTool(), ResetTool()], active_drag=box, **{
                f"{name}_range": limits for name, limits in (("x", x), ("y", y)) if limits is not None})
        self.figure.toolbar.logo = None
        self.figure.toolbar.autohide = True
        self.figure.background_fill_color = self.figure.border_fill_color = LOOKS["paper"]
        self.figure.outline_line_color = None
        self.figure.grid.grid_line_color = LOOKS["line"]
        self.figure.xaxis.major_label_policy = NoOverlap()  # of cycles on a phone; rows of maps keep all their names
        for axis, label in zip((*self.figure.xaxis, *self.figure.yaxis), self.labels, strict=True):
            axis.axis_label = PlainText(text=label)
            axis.axis_label_text_font_style = "normal"
            axis.axis_line_color = axis.major_tick_line_color = axis.major_label_text_color = LOOKS["muted"]
            axis.minor_tick_line_color, axis.axis_label_text_color = None, LOOKS["ink"]
            axis.formatter.power_limit_high, axis.formatter.power_limit_low = 7, -4  # beyond them with an exponent
            if label == "cycles":
                axis.formatter, axis.ticker.min_interval = NumeralTickFormatter(format="0,0"), 1.0

    def curve(self, name: str, look: str, x: Array, y: Array, **line: object) -> None:
        """Add the line through (`x`, `y`), broken where a value is missing."""
        self.figure.line("x", "y", source=_source(x=x, y=y), name=name, line_color=LOOKS[look],
                         **{**LINES.get(look, {}), **line})

    def band(self, look: str, x: Array, low: Array, high: Array) -> None:
        """Add the area between two lines over `x`."""
        known = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        self.figure.varea("x", "low", "high", source=_source(x=x[known], low=low[known], high=high[known]),
                          fill_color=LOOKS[look], fill_alpha=0.15)

    def points(self, name: str, look: str, x: Array, y: Array, told: Sequence[str]) -> None:
        """Add points, each with what is told of it."""
        drawn = self.figure.scatter("x", "y", source=_source(x=x, y=y, told=told), name=name, size=7,
                                    color=LOOKS[look])
        self.figure.add_tools(HoverTool(renderers=[drawn], tooltips=[("", "@told")]))

    def level(self, y: float) -> None:
        """Add a horizontal line at `y`."""
        self.figure.add_layout(Span(location=y, dimension="width", line_color=LOOKS["muted"]))

    def read(self, along: bool = False) -> None:
        """Let the curves be read where the pointer is, or all of them at its x."""
        places = [(label, f"@{axis}") for label, axis in zip(self.labels, "xy", strict=True)]
        self.figure.add_tools(HoverTool(tooltips=[("", "$name"), *places], mode="vline" if along else "mouse",
                                        line_policy="nearest"))

    def image(self, values: Array, box: tuple[float, float, float, float], colours: Sequence[str], limits: Limits,
              label: str, names: Sequence[str] = ()) -> None:
        """Add coloured `values` (rows, columns), first row on top, over a box (left, right, low, high), and a scale.

        Each row of its own name is a picture of its own, so that it is told where the pointer is.
        """
        left, right, low, high = box
        tall = (high - low) / (len(values) if names else 1)
        pictures = [row[None] for row in values] if names else [values[::-1]]
        mapper = LinearColorMapper(list(colours), low=limits[0], high=limits[1], nan_color="rgba(0, 0, 0, 0)")
        source = ColumnDataSource({
            "image": [picture.astype(np.float32) for picture in pictures], "told": list(names or [""]),
            "y": [high - (k + 1) * tall for k in range(len(pictures))]})
        drawn = self.figure.image("image", x=left, y="y", dw=right - left, dh=tall, source=source, color_mapper=mapper,
                                  level="image")
        told = [("", "@told"), (self.labels[0], "$x")] if names else [(self.labels[0], "$x"), (self.labels[1], "$y")]
        self.figure.add_tools(HoverTool(renderers=[drawn], tooltips=[*told, (label, "@image")]))
        self.figure.grid.visible = False
        self.figure.add_layout(ColorBar(
            color_mapper=mapper, title=label, height=10, background_fill_color=None, title_text_font_style="normal",
            title_text_color=LOOKS["ink"], major_label_text_color=LOOKS["muted"], padding=2), "below")

    def mark(self, places: dict[float, str]) -> None:
        """Name `places` along y instead of their numbers."""
        self.figure.yaxis.ticker = FixedTicker(ticks=sorted(places))
        self.figure.yaxis.major_label_overrides = {at: PlainText(text=name) for at, name in places.items()}

    def markup(self) -> Markup:
        """Return the chart as the element that the page's script fills."""
        told = json.dumps(json_item(self.figure), separators=(",", ":")).replace("<", "\\u003c")
        return Markup('<div class="chart" role="figure" aria-label="{}"><script type="application/json">{}</script>'
                      "</div>").format(self.describe, Markup(told))


def _source(**columns: object) -> ColumnDataSource:
    return ColumnDataSource({name: np.asarray(values, np.float32) if isinstance(values, np.ndarray) else values
                             for name, values in columns.items()})


def extent(values: Iterable[Array], margin: float = 0.05, around_zero: bool = False) -> Limits:
    """Return the range of all finite `values` with a `margin` on both sides; (-1, 1) where there is none."""
    finite = [v[np.isfinite(v)] for v in map(np.asarray, values)]
    flat = np.concatenate([*finite, np.zeros(int(around_zero))]) if finite else np.zeros(0)
    if not flat.size:
        return -1.0, 1.0
    low, high = float(flat.min()), float(flat.max())
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        half = abs(high) or 1.0
        return low - half, high + half
    return low - margin * (high - low), high + margin * (high - low)


def thinned(*curves: Array, most: int = MOST_POINTS) -> NDArray[np.int64]:
    """Return the indices of some `most` samples of `curves` (N,), every stretch by its extremes.

    Evenly spaced ones would fold what oscillates faster into a zigzag that was not measured.
    """
    count = len(curves[0])
    if count <= most:
        return np.arange(count)
    kept = [0, count - 1]
    for part in np.array_split(np.arange(count), most // (2 * len(curves))):
        for values in (np.nan_to_num(curve[part]) for curve in curves):
            kept += [part[np.argmin(values)], part[np.argmax(values)]]
    return np.unique(np.array(kept, dtype=np.int64))


def figure_image(still: Figure, describe: str) -> Markup:
    """Return a figure as a picture that grows without getting coarse."""
    content = io.BytesIO()
    still.savefig(content, format="svg", metadata={"Date": None})
    return svg_image(content.getvalue(), describe)


def svg_image(content: bytes, describe: str) -> Markup:
    """Return an SVG as a picture within the page."""
    return Markup('<img class="figure" src="data:image/svg+xml;base64,{}" alt="{}">').format(
        base64.b64encode(content).decode(), describe)
