"""One look for every picture: fonts, colours, sizes, scales with round numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from pathlib import Path

import matplotlib.style
import numpy as np
from fretflow.core.errors import InputError, printable
from fretflow.core.plugins import FORMATS, formats_asked
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, PowerNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

DPI = 100
# What a file says of itself; no date, so that the same picture is the same file.
METADATA: dict[str, dict[str, str | None]] = {
    "png": {"Software": "fretflow"}, "svg": {"Creator": "fretflow", "Date": None},
    "pdf": {"Creator": "fretflow", "CreationDate": None}}
_FORMATS: ContextVar[tuple[str, ...]] = ContextVar("formats")
WIDTH, HEIGHT = 16.0, 10.0  # inches, 1600 x 1000 pixels

DEPTH_MAP = "viridis"
PRESSURE_MAP = "plasma"
SHARE_MAP = "cividis"
SHAPE_MAP = "PuOr_r"  # two-sided, told apart by colour-blind readers

# Okabe and Ito's palette, told apart by colour-blind readers too.
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILLION, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7")
CURVE_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
LINE_STYLES = ("-", "--", "-.", ":")
# What was measured, and predicted before and after: name, colour, line, marker.
LOOKS = (("measured", BLACK, "-", "o"), ("before", VERMILLION, "--", ""), ("after", BLUE, "-.", ""))
UPPER_COLOUR, LOWER_COLOUR = "#9DC3E6", "#D9D9D9"
CONTACT_COLOUR = VERMILLION
EDGE_COLOUR = "#404040"

_RC = {
    "font.family": "DejaVu Sans", "font.size": 15, "axes.titlesize": 17, "axes.labelsize": 16,
    "figure.titlesize": 22, "legend.fontsize": 14, "xtick.labelsize": 14, "ytick.labelsize": 14,
    "axes.grid": True, "grid.color": "#D0D0D0", "grid.linewidth": 0.8, "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False, "lines.linewidth": 2.2, "lines.markersize": 7,
    "axes.formatter.use_mathtext": True, "legend.framealpha": 0.9, "image.interpolation": "antialiased",
}


def styled() -> AbstractContextManager[None]:
    """Return a context in which figures are made and saved with this look, whatever a matplotlibrc file says."""
    return matplotlib.style.context(["default", _RC])


def new_figure(title: str, subtitle: str, width: float = WIDTH, height: float = HEIGHT) -> Figure:
    """Return an empty figure with its title and one line of explanation at the top."""
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    figure.suptitle(printable(title), y=1.0 - 0.32 / height, va="center", fontweight="bold", parse_math=False)
    figure.text(0.5, 1.0 - 0.78 / height, subtitle, ha="center", va="center", fontsize=15)
    return figure


@contextmanager
def saved_as(formats: Sequence[str]) -> Iterator[None]:
    """Have figures saved in `formats` within this context, whatever the user's variable says.

    Raises
    ------
    InputError
        If one is not among `METADATA`.
    """
    token = _FORMATS.set(known_formats(formats, "output.figure_formats"))
    try:
        yield
    finally:
        _FORMATS.reset(token)


def known_formats(formats: Sequence[str], where: str) -> tuple[str, ...]:
    """Return `formats`, told at `where`, if pictures can be saved in all of them."""
    for name in formats:
        if name not in METADATA:
            raise InputError(f"{where}: {name!r} is none of {', '.join(METADATA)}")
    return tuple(formats)


def save_figure(figure: Figure, path: Path) -> Path:
    """Write `figure` in each of the formats asked for, PNG if none is, and return the path of the first."""
    path.parent.mkdir(parents=True, exist_ok=True)
    formats = _FORMATS.get(()) or known_formats(formats_asked(), FORMATS)
    for suffix in formats:
        figure.savefig(path.with_suffix(f".{suffix}"), dpi=DPI, metadata=METADATA[suffix])
    return path.with_suffix(f".{formats[0]}")


def colour_map(name: str) -> Colormap:
    """Return the colour map `name`."""
    return matplotlib.colormaps[name]


def palette(name: str, exponent: float = 1.0) -> list[str]:
    """Return 256 colours of the map `name`; those of a two-sided one follow the values to the power `exponent`."""
    share = np.linspace(-1.0, 1.0, 256)
    return [to_hex(one) for one in colour_map(name)(0.5 + 0.5 * np.sign(share) * np.abs(share) ** exponent)]


def round_scale(largest: float, intervals: int = 6) -> tuple[float, list[float]]:
    """Return the top of a scale from zero that covers `largest`, and its round ticks."""
    if not largest > 0.0:
        return 1.0, [0.0, 0.5, 1.0]
    ticks = [float(t) for t in MaxNLocator(intervals, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, largest)
             if t >= 0.0]
    return ticks[-1], ticks


def round_factor(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`, at least 1."""
    if not value > 1.0:
        return 1.0
    power = float(10.0 ** np.floor(np.log10(value) + 1e-12))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-12))


def curve_look(index: int) -> tuple[str, str]:
    """Return colour and line style of curve `index`; neighbours differ in both."""
    return CURVE_COLOURS[index % len(CURVE_COLOURS)], LINE_STYLES[index % len(LINE_STYLES)]


def root_ticks(top: float) -> list[float]:
    """Return round ticks from zero to `top` that stand clear of each other on a square-root scale."""
    decade = 10.0 ** np.floor(np.log10(top))
    chosen = [top]
    for tick in (step * decade * power for power in (1.0, 0.1, 0.01) for step in (5.0, 2.0, 1.0)):
        if np.sqrt(chosen[-1] / top) - np.sqrt(tick / top) > 0.07 and tick > 0.004 * top:
            chosen.append(float(tick))
    return [0.0, *chosen[::-1]]


def add_colour_bar(figure: Figure, axes: Axes, name: str, ticks: list[float], label: str,
                   exponent: float = 1.0, beyond: bool = False) -> Colorbar:
    """Fill `axes` with the colour bar of map `name` from the first to the last of `ticks`.

    Colours follow the values to the power `exponent`; the bar ends in an arrow where some are `beyond` the last tick.
    """
    scale = matplotlib.cm.ScalarMappable(PowerNorm(exponent, ticks[0], ticks[-1]), colour_map(name))
    bar = figure.colorbar(scale, cax=axes, ticks=ticks, extend="max" if beyond else "neither")
    bar.ax.minorticks_off()
    bar.set_label(label, fontsize=16, labelpad=10)
    bar.ax.grid(False)
    return bar


def counted(number: float, unit: str = "") -> str:
    """Return `number` for people: 190000 -> ``190,000``."""
    return f"{number:,.0f} {unit}".rstrip()


def when_words(cycles: int) -> str:
    """Return when something is, by wear cycles."""
    return "unworn" if cycles == 0 else f"after {counted(cycles)} cycles"


def figures(value: float) -> str:
    """Return `value` with three significant figures, without an exponent where it stays readable."""
    if value == 0.0 or not np.isfinite(value):
        return f"{value:g}"
    digits = max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:,.{digits}f}" if 1e-4 <= abs(value) < 1e7 else f"{value:.3g}"
