"""Corner plots: what is known of each parameter and of each pair, from draws of their posterior."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from fretflow.core.records import Array
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.words import parameter_words
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from scipy.stats import gaussian_kde

from fretflow_post import style

DECADES = 10.0  # ends of a 90 % interval that are further apart, relatively, are drawn by their logarithm
HELD = (0.9, 0.5)  # shares of the draws within the regions
LETTERS = 15  # of a line of a label
LONGEST = 3  # digits before or after the point of a tick's text
GRID = 32  # points to a side at which a density is drawn
ROUND_OFF = 1e-9  # relative: a parameter that varies less has no density


def plot_corner(figure: Figure, parameters: Sequence[tuple[str, str, Array]]) -> Figure:
    """Fill `figure` below its title with a triangle of panels.

    Parameters
    ----------
    figure
        With a title.
    parameters
        Name such as ``wear.coefficient``, SI unit and draws (n,) in SI of each; draws of one row belong together.
    """
    count, width = len(parameters), figure.get_size_inches()[0]
    small = min(13.0, 54.0 / count + 2.5)
    grid = figure.add_gridspec(count, count, left=1.6 / width, right=0.98, bottom=1.6 / width, top=1.0 - 1.2 / width,
                               hspace=0.08, wspace=0.08)
    columns = [_readable(*one) for one in parameters]
    wide = [bool(np.all(values > 0.0) and np.quantile(values, 0.95) > DECADES * np.quantile(values, 0.05))
            for _, values in columns]
    columns = [(label, np.log10(values) if far else values) for (label, values), far in zip(columns, wide, strict=True)]
    for row, (label, values) in enumerate(columns):
        for column in range(row + 1):
            axes = figure.add_subplot(grid[row, column])
            axes.grid(False)
            for axis, outer, text, far in ((axes.xaxis, row == count - 1, columns[column][0], wide[column]),
                                           (axes.yaxis, column == 0 < row, label, wide[row])):
                axis.set_major_locator(MaxNLocator(3, prune=None if far else "both", integer=far))
                if far:
                    axis.set_major_formatter(FuncFormatter(lambda power, _: f"$10^{{{power:g}}}$"))
                axis.set_tick_params(labelsize=small - 2.0, labelrotation=30.0 if axis is axes.xaxis else 0.0)
                if outer:
                    axis.set_label_text(text, fontsize=small)
                else:
                    axis.set_tick_params(labelleft=False, labelbottom=False)
            if column == row:
                _marginal(axes, values)
            else:
                _pair(axes, columns[column][1], values)
        for column in range(row):
            _correlation(figure, grid[column, row].get_position(figure).bounds, columns[column][1], values, small)
    figure.align_labels()
    return figure


def write_corner(path: Path, title: str, subtitle: str, parameters: Sequence[tuple[str, str, Array]]) -> Path:
    """Write the corner plot of `parameters`, as of `plot_corner`, to the PNG `path` and return it."""
    with style.styled():
        return style.save_figure(plot_corner(style.new_figure(title, subtitle, 12.0, 12.0), parameters), path)


def _readable(name: str, si: str, draws: Array) -> tuple[str, Array]:
    middle = float(np.median(np.abs(draws)))
    unit, size = readable_unit(middle, si)
    power = int(np.floor(np.log10(middle / size))) if middle > 0.0 else 0
    if not -LONGEST < power <= LONGEST:  # told in the label once
        unit, size = f"$10^{{{power}}}$ {pretty_unit(unit)}".rstrip(" 1"), size * 10.0**power
    of, _, own = name.rpartition(".")
    unit = pretty_unit(unit)
    lines = (fill(of, LETTERS), fill(parameter_words(own), LETTERS), *((f"({unit})",) if unit not in ("", "1") else ()))
    return "\n".join(lines), draws / size


def _varies(values: Array) -> bool:
    return bool(np.ptp(values) > ROUND_OFF * max(float(np.abs(values).max()), 1e-300))


def _marginal(axes: Axes, values: Array) -> None:
    low, middle, high = np.quantile(values, (0.5 - HELD[0] / 2.0, 0.5, 0.5 + HELD[0] / 2.0))
    axes.hist(values, bins=24, color=style.SKY, histtype="stepfilled")
    axes.axvline(middle, color=style.BLACK, linewidth=1.4)
    for end in (low, high):
        axes.axvline(end, color=style.BLACK, linewidth=1.1, linestyle="--")
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def _pair(axes: Axes, x: Array, y: Array) -> None:
    """Draw the smallest regions that hold shares of the draws."""
    if not (_varies(x) and _varies(y)) or abs(np.corrcoef(x, y)[0, 1]) > 1.0 - ROUND_OFF:
        axes.plot(x, y, ".", color=style.BLUE, markersize=2.0, rasterized=True)
        return
    density = gaussian_kde(np.stack([x, y]))
    levels = np.quantile(density(np.stack([x, y])), [1.0 - share for share in HELD])
    across, up = (np.linspace(values.min(), values.max(), GRID) for values in (x, y))
    height = density(np.stack([v.ravel() for v in np.meshgrid(across, up)])).reshape(GRID, GRID)
    axes.contourf(across, up, height, [*levels, max(float(height.max()), 2.0 * levels[-1])],
                  colors=["#BBDDF2", style.BLUE])
    axes.plot(np.median(x), np.median(y), "+", color=style.BLACK)


def _correlation(figure: Figure, box: tuple[float, float, float, float], x: Array, y: Array, size: float) -> None:
    if _varies(x) and _varies(y):
        left, bottom, width, height = box
        r = float(np.corrcoef(x, y)[0, 1])
        told = f"{round(r, 2) + 0.0:.2f}".replace("-", "−")  # no minus before nothing
        figure.text(left + 0.5 * width, bottom + 0.5 * height, told, ha="center", va="center", fontsize=size,
                    color=style.EDGE_COLOUR, alpha=0.35 + 0.65 * abs(r))
