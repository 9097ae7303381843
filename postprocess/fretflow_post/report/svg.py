"""Charts of the report as SVG text: axes, curves, bands and coloured maps.

Colours are left to the page's style sheet. A chart carries what its readout needs in ``data-`` attributes: the axes'
scales, and for a map its values as whole multiples of a step.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from fretflow_post import style

Array = NDArray[np.float64]

WIDTH, HEIGHT = 460.0, 330.0  # pixels of a chart
LEFT, RIGHT, TOP, BOTTOM = 70.0, 12.0, 12.0, 46.0  # margins
MOST_POINTS = 600  # of a curve
NOWHERE = "M-99-99"  # keeps the place of a missing point; draws nothing
LETTER = 6.6  # pixels a letter takes, about


@dataclass(frozen=True)
class Axis:
    """A linear scale: `low` to `high` in the unit that the label names, `start` to `end` in pixels."""

    label: str
    low: float
    high: float
    start: float
    end: float
    unit: str = ""

    def pixels(self, values: Array) -> Array:
        """Return where `values` lie."""
        return self.start + (np.asarray(values) - self.low) / (self.high - self.low) * (self.end - self.start)

    def ticks(self, most: int = 6) -> list[tuple[float, str]]:
        """Return position and text of the ticks."""
        places = [float(t) for t in MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(self.low, self.high)]
        step = places[1] - places[0]
        slack = 1e-6 * step
        return [(float(self.pixels(np.array(t))), _tick_text(t, step)) for t in places
                if self.low - slack <= t <= self.high + slack]

    def data(self, letter: str) -> Markup:
        """Return the attributes that let a readout turn pixels into values."""
        numbers = " ".join(f"{v:.9g}" for v in (self.low, self.high, self.start, self.end))
        return Markup(' data-{0}="{1}" data-{0}-unit="{2}" data-{0}-label="{3}"').format(
            letter, numbers, self.unit, self.label)


def horizontal(label: str, low: float, high: float, unit: str = "", width: float = WIDTH, left: float = LEFT) -> Axis:
    """Return the axis along the lower edge of a chart."""
    return Axis(label, low, high, left, width - RIGHT, unit)


def vertical(label: str, low: float, high: float, unit: str = "", height: float = HEIGHT) -> Axis:
    """Return the axis along the left edge of a chart."""
    return Axis(label, low, high, height - BOTTOM, TOP, unit)


def extent(values: Iterable[Array], margin: float = 0.05, around_zero: bool = False) -> tuple[float, float]:
    """Return the range of all finite `values` with a `margin` on both sides; (-1, 1) where there is none."""
    finite = [v[np.isfinite(v)] for v in map(np.asarray, values)]
    flat = np.concatenate([*finite, np.zeros(int(around_zero))]) if finite else np.zeros(0)
    if not flat.size:
        return -1.0, 1.0
    low, high = float(flat.min()), float(flat.max())
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        reach = abs(high) or 1.0
        return low - reach, high + reach
    return low - margin * (high - low), high + margin * (high - low)


@dataclass
class Chart:
    """A chart that is filled step by step; `describe` is read out to those who cannot see it."""

    x: Axis
    y: Axis
    describe: str
    width: float = WIDTH
    height: float = HEIGHT
    readout: str = ""  # how the page's script reads it: "curves", "trace", "map" or not at all
    parts: list[Markup] = field(default_factory=list)
    attributes: Markup = field(default_factory=Markup)

    def curve(self, name: str, look: str, x: Array, y: Array) -> None:
        """Add the line through (`x`, `y`), broken where a value is missing."""
        px, py = self.x.pixels(x), self.y.pixels(y)
        self.parts.append(Markup('<path class="curve {}" data-name="{}" d="{}"/>').format(look, name, _path(px, py)))

    def trace(self, look: str, x: Array, y: Array) -> None:
        """Add a line that no readout reads."""
        self.parts.append(Markup('<path class="{}" d="{}"/>').format(look, _path(self.x.pixels(x), self.y.pixels(y))))

    def band(self, look: str, x: Array, low: Array, high: Array) -> None:
        """Add the area between two lines over `x`."""
        known = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        if known.sum() > 1:
            px = self.x.pixels(np.r_[x[known], x[known][::-1]])
            py = self.y.pixels(np.r_[high[known], low[known][::-1]])
            self.parts.append(Markup('<path class="band {}" d="{}Z"/>').format(look, _path(px, py)))

    def level(self, look: str, y: float) -> None:
        """Add a horizontal line at `y`."""
        at = float(self.y.pixels(np.array(y)))
        self.parts.append(Markup('<path class="{}" d="M{:.1f} {:.1f}H{:.1f}"/>').format(
            look, self.x.start, at, self.x.end))

    def text(self, x: float, y: float, words: str, look: str = "") -> None:
        """Write `words` at a place in pixels."""
        self.parts.append(Markup('<text x="{:.1f}" y="{:.1f}" class="{}">{}</text>').format(x, y, look, words))

    def image(self, colours: NDArray[np.uint8], box: tuple[float, float, float, float]) -> None:
        """Add a picture (rows, columns, 4), its first row on top, in a box of pixels (x, y, width, height)."""
        self.parts.append(Markup(
            '<image href="{}" x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" preserveAspectRatio="none"/>'
        ).format(png(colours), *box))

    def values(self, values: Array, step: float, box: tuple[float, float, float, float], unit: str,
               rows: Sequence[str] = ()) -> None:
        """Give the readout of a map its values (rows, columns), first row on top, and the names of its rows."""
        cells = ",".join("" if not np.isfinite(v) else f"{v / step:.0f}" for v in values.ravel())
        self.readout = "map"
        self.attributes += Markup(
            ' data-columns="{}" data-step="{:.6g}" data-box="{}" data-unit="{}" data-names="{}" data-values="{}"'
        ).format(values.shape[1], step, " ".join(f"{v:.1f}" for v in box), unit, "\n".join(rows), cells)

    def markup(self, x_axis: bool = True, y_axis: bool = True) -> Markup:
        """Return the chart as an SVG element."""
        attributes = self.attributes
        if self.readout:
            attributes += Markup(' data-readout="{}" tabindex="0"').format(self.readout)
            attributes += self.x.data("x") + self.y.data("y")
        frame = Markup('<path class="frame" d="M{:.1f} {:.1f}V{:.1f}H{:.1f}"/>').format(
            self.x.start, self.y.end, self.y.start, self.x.end)
        axes = (self._x_axis() if x_axis else Markup()) + (self._y_axis() if y_axis else Markup())
        element = Markup('<svg class="chart" viewBox="0 0 {:.0f} {:.0f}" role="img" aria-label="{}"{}>{}{}{}</svg>')
        return element.format(
            self.width, self.height, self.describe, attributes, axes, frame, Markup().join(self.parts))

    def _x_axis(self) -> Markup:
        found = Markup()
        for at, text in self.x.ticks(7):
            found += Markup('<path class="grid" d="M{0:.1f} {1:.1f}V{2:.1f}"/>'
                            '<text class="tick" x="{0:.1f}" y="{3:.1f}" text-anchor="middle">{4}</text>').format(
                at, self.y.start, self.y.end, self.y.start + 16.0, text)
        middle = 0.5 * (self.x.start + self.x.end)
        return found + Markup('<text class="label" x="{:.1f}" y="{:.1f}" text-anchor="middle">{}</text>').format(
            middle, self.y.start + 36.0, self.x.label)

    def _y_axis(self) -> Markup:
        found = Markup()
        for at, text in self.y.ticks():
            found += Markup('<path class="grid" d="M{0:.1f} {1:.1f}H{2:.1f}"/>'
                            '<text class="tick" x="{3:.1f}" y="{4:.1f}" text-anchor="end">{5}</text>').format(
                self.x.start, at, self.x.end, self.x.start - 6.0, at + 4.0, text)
        middle = 0.5 * (self.y.start + self.y.end)
        return found + Markup('<text class="label" transform="translate(13 {:.1f}) rotate(-90)" text-anchor="middle">'
                              "{}</text>").format(middle, self.y.label)


def thinned(*curves: Array) -> NDArray[np.int64]:
    """Return the indices of some MOST_POINTS samples of `curves` (N,), every stretch by its extremes.

    Evenly spaced ones would fold what oscillates faster into a zigzag that was not measured.
    """
    count = len(curves[0])
    if count <= MOST_POINTS:
        return np.arange(count)
    kept = [0, count - 1]
    for part in np.array_split(np.arange(count), MOST_POINTS // (2 * len(curves))):
        for values in (np.nan_to_num(curve[part]) for curve in curves):
            kept += [part[np.argmin(values)], part[np.argmax(values)]]
    return np.unique(np.array(kept, dtype=np.int64))


def coloured(values: Array, name: str, low: float, high: float) -> NDArray[np.uint8]:
    """Return the colours (..., 4) of `values` on the map `name`; what is missing is transparent."""
    share = (np.clip(np.nan_to_num(values, nan=low), low, high) - low) / (high - low)
    colours = style.colour_map(name)(share, bytes=True)
    colours[~np.isfinite(values)] = 0
    return np.asarray(colours, dtype=np.uint8)


def png(colours: NDArray[np.uint8]) -> str:
    """Return a picture (rows, columns, 4) as a data URL."""
    content = io.BytesIO()
    imsave(content, colours, format="png")
    return f"data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}"


def figure_image(figure: Figure, describe: str) -> Markup:
    """Return a figure as a picture that grows without getting coarse."""
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    return Markup('<img class="figure" src="data:image/svg+xml;base64,{}" alt="{}">').format(
        base64.b64encode(content.getvalue()).decode(), describe)


def colour_bar(name: str, low: float, high: float, label: str, ticks: Sequence[tuple[float, str]] | None = None,
               width: float = 340.0) -> Markup:
    """Return the scale of a coloured map as a chart of its own; `ticks` by share of its length, if not its values."""
    axis = Axis(label, low, high, 18.0, width - 18.0)
    chart = Chart(axis, Axis("", 0.0, 1.0, 20.0, 6.0), label, width, 62.0)
    ramp = coloured(np.linspace(low, high, 128)[None, :], name, low, high)
    placed = [(axis.start + s * (axis.end - axis.start), t) for s, t in ticks or ()] or axis.ticks(7)
    for at, words in placed:
        chart.text(at, 36.0, words, "tick middle")
    chart.image(ramp, (axis.start, 6.0, axis.end - axis.start, 14.0))
    chart.text(0.5 * width, 56.0, label, "label middle")
    return chart.markup(x_axis=False, y_axis=False)


def _path(px: Array, py: Array) -> str:
    commands, pen = [], "M"
    for x, y in zip(px.tolist(), py.tolist(), strict=True):
        if np.isfinite(x) and np.isfinite(y):
            commands.append(f"{pen}{x:.1f} {y:.1f}")
            pen = "L"
        else:
            commands.append(NOWHERE)
            pen = "M"
    return "".join(commands)


def _tick_text(value: float, step: float) -> str:
    digits = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    if round(step * 10.0**digits, 6) % 1.0:
        digits += 1  # a step such as 2.5
    largest = max(abs(value), step)
    if largest >= 1e6 or step < 1e-5:
        return f"{value:.3g}".replace("-", "−")
    text = f"{value:,.{digits}f}"
    return "0" if float(text.replace(",", "")) == 0.0 else text.replace("-", "−")
