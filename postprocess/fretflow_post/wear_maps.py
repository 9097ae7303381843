"""Wear depth over the contact, measured and predicted: maps, what they differ by, and profiles along the sliding."""

from __future__ import annotations

import numpy as np
from fretflow.core.records import Array
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.verdict import WearMap
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from fretflow_post import style

RASTER = 210  # pixels of a map along its longer side
LEAST = 3  # pixels along its shorter one
MOST_PLACES = 40  # along a profile
NOT_ROUND_OFF = 1e-9  # m: points that are closer along x stand on one line across


def known_maps(wear: WearMap, after: bool) -> dict[str, Array]:
    """Return the depths in m that are known: measured, before and, if asked for, after."""
    shown = {"measured": wear.measured, "before": wear.before} | ({"after": wear.after} if after else {})
    return {name: values for name, values in shown.items() if np.isfinite(values).any()}


def differences(wear: WearMap, after: bool) -> dict[str, Array]:
    """Return measured minus predicted depths in m."""
    return {name: wear.measured - values for name, values in known_maps(wear, after).items() if name != "measured"}


def profile(x: Array, depth: Array) -> tuple[Array, Array, Array]:
    """Return places along x, and over all points across there the mean depth and its standard deviation, (n,) each."""
    known = np.isfinite(depth)
    x, depth = x[known], depth[known]
    places, line = np.unique(np.round(x / NOT_ROUND_OFF), return_inverse=True)
    if len(places) > MOST_PLACES:
        edges = np.linspace(x.min(), x.max(), MOST_PLACES + 1)
        _, line = np.unique(np.clip(np.digitize(x, edges) - 1, 0, MOST_PLACES - 1), return_inverse=True)
    count = np.bincount(line)
    mean = np.bincount(line, depth) / count
    return np.bincount(line, x) / count, mean, np.sqrt(np.bincount(line, (depth - mean[line])**2) / count)


def raster(x: Array, y: Array, values: Array) -> tuple[Array, tuple[float, float, float, float]]:
    """Return `values` at the nearest point, first row on top, and the edges (left, right, low, high) of the picture.

    Pixels further from every point than the points are from each other stay empty.
    """
    points = np.column_stack((x, y))
    tree = cKDTree(points)
    apart = np.median(tree.query(points, k=2)[0][:, 1]) if len(points) > 1 else 1.0
    left, right = float(x.min() - 0.5 * apart), float(x.max() + 0.5 * apart)
    low, high = float(y.min() - 0.5 * apart), float(y.max() + 0.5 * apart)
    pixel = max(right - left, high - low) / RASTER
    across, up = (max(LEAST, round(length / pixel)) for length in (right - left, high - low))
    centres = np.meshgrid(left + (np.arange(across) + 0.5) / across * (right - left),
                          high - (np.arange(up) + 0.5) / up * (high - low))
    distance, nearest = tree.query(np.column_stack([c.ravel() for c in centres]))
    pixels = np.where(distance <= 1.5 * apart, values[nearest], np.nan)
    return pixels.reshape(up, across), (left, right, low, high)


def plot_wear_maps(figure: Figure, wear: WearMap, after: bool) -> Figure:
    """Fill `figure` below its title: depths on one scale, what they differ by on another, profiles along x."""
    depths, away = known_maps(wear, after), differences(wear, after)
    unit, size = readable_unit(max(float(np.nanmax(values)) for values in depths.values()), "m")
    grid = figure.add_gridspec(2, 3, left=0.07, right=0.95, bottom=0.08, top=0.85, hspace=0.35, wspace=0.35)
    top, limit = (style.round_scale(max((float(np.nanmax(np.abs(values))) for values in maps.values()), default=0.0)
                                    / size)[0] for maps in (depths, away))
    for k, (name, values) in enumerate(depths.items()):
        _map(figure.add_subplot(grid[0, k]), wear, values / size, name, style.DEPTH_MAP, (0.0, top), unit)
    for k, (name, values) in enumerate(away.items()):
        _map(figure.add_subplot(grid[1, k + 1]), wear, values / size, f"measured − {name}", style.SHAPE_MAP,
             (-limit, limit), unit)
    axes = figure.add_subplot(grid[1, 0])
    for (name, values), (_, colour, line, _) in zip(depths.items(), style.LOOKS, strict=False):
        x, mean, sd = profile(wear.x, values)
        axes.plot(x * 1e3, mean / size, color=colour, linestyle=line, label=name)
        if name == "measured":
            axes.fill_between(x * 1e3, (mean - sd) / size, (mean + sd) / size, color=colour, alpha=0.15, linewidth=0.0)
    axes.set(title="mean across, band: sd across", xlabel="x, sliding direction (mm)",
             ylabel=f"depth ({pretty_unit(unit)})")
    axes.legend(loc="best")
    return figure


def _map(axes: Axes, wear: WearMap, depth: Array, title: str, colours: str, limits: tuple[float, float], unit: str
         ) -> None:
    pixels, extent = raster(wear.x * 1e3, wear.y * 1e3, depth)
    drawn = axes.imshow(pixels, extent=extent, cmap=colours, vmin=limits[0], vmax=limits[1], interpolation="nearest")
    axes.figure.colorbar(drawn, ax=axes, fraction=0.046).ax.set_title(pretty_unit(unit), fontsize=13)
    axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)")
    axes.grid(False)
