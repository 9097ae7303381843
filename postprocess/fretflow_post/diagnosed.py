"""A diagnosis as figures to look at or to go on with: loops, readings over the cycles, parameters, wear."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from fretflow.core.errors import InputError, did_you_mean
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.verdict import Diagnosis, Estimate, Evolution, Verdict
from fretflow.inference.words import headline, together
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from fretflow_post import style
from fretflow_post.corner import plot_corner
from fretflow_post.wear_maps import plot_wear_maps

Array = NDArray[np.float64]

MOST_LOOPS = 6  # more would be too small to compare
READ = (("friction_limit", "friction limit", "N"), ("tangential_stiffness", "tangential stiffness", "N/m"),
        ("dissipated_energy", "energy of a cycle", "J"), ("sliding_distance", "sliding distance", "m"))


def plot_diagnosis(diagnosis: Diagnosis, what: str = "loops") -> Figure:
    """Return a figure of ``loops``, ``evolution``, ``parameters`` or ``wear``.

    Raises
    ------
    InputError
        If there is no such figure, or the diagnosis has nothing to draw there.
    """
    if what not in FIGURES:
        raise InputError(f"plot: {what!r} is none of {', '.join(FIGURES)}{did_you_mean(what, FIGURES)}")
    with style.styled():
        return FIGURES[what](diagnosis)


def _titled(diagnosis: Diagnosis, what: str = "", **size: float) -> Figure:
    named = f": {together(diagnosis.effects)}" if diagnosis.effects else ""
    told = headline(diagnosis) + named
    return style.new_figure(diagnosis.title or diagnosis.recording, f"{told}; {what}" if what else told, **size)


def _nothing(what: str) -> InputError:
    return InputError(f"plot: this diagnosis has no {what}")


def _loops(diagnosis: Diagnosis) -> Figure:
    """Return up to six of the loops: measured, as the refitted baseline has them and with the named effects."""
    every = diagnosis.comparisons
    some = np.linspace(0, len(every) - 1, min(MOST_LOOPS, len(every))).round().astype(int)
    shown = [every[k] for k in np.unique(some)]
    figure = _titled(diagnosis, f"{len(shown)} of {len(every)} loops" if len(shown) < len(every) else "")
    columns = min(3, max(1, len(shown)))
    grid = figure.add_gridspec(max(1, -(-len(shown) // columns)), columns, left=0.07, right=0.97, bottom=0.08,
                               top=0.84, hspace=0.35, wspace=0.28)
    for k, one in enumerate(shown):
        axes = figure.add_subplot(grid[k // columns, k % columns])
        parts = (("measured", one.displacement, one.force), ("baseline", one.before_displacement, one.before_force),
                 (diagnosis.after_model or "after", one.after_displacement, one.after_force))
        for (name, x, force), (_, colour, line, _) in zip(parts, style.LOOKS, strict=True):
            axes.plot(np.append(x, x[0]) * 1e6, np.append(force, force[0]), color=colour, linestyle=line, label=name)
        axes.set(title=one.label + (", held out" if one.held_out else ""), xlabel="displacement (µm)",
                 ylabel="force (N)")
        if k == 0:
            axes.legend(loc="best")
    return figure


def readings(evolution: Evolution) -> Iterator[tuple[str, str, Array]]:
    """Return what is known of an evolution: name, printed unit, and values (3, n) in that unit."""
    for field, name, si in READ:
        values = getattr(evolution, field)
        if np.isfinite(values[0]).any():
            unit, size = readable_unit(float(np.nanmax(np.abs(values))), si)
            yield name, pretty_unit(unit), values / size


def _evolution(diagnosis: Diagnosis) -> Figure:
    """Return the readings over the cycles: measured, before and after."""
    if diagnosis.evolution is None:
        raise _nothing("loops at several cycle counts")
    figure = _titled(diagnosis, "what is read off the loops over the cycles")
    grid = figure.add_gridspec(2, 2, left=0.08, right=0.97, bottom=0.08, top=0.86, hspace=0.3, wspace=0.22)
    for k, (name, unit, values) in enumerate(readings(diagnosis.evolution)):
        axes = figure.add_subplot(grid[k // 2, k % 2])
        for (look, colour, line, mark), own in zip(style.LOOKS, values, strict=True):
            axes.plot(diagnosis.evolution.cycles, own, color=colour, linestyle=line, marker=mark, label=look)
        axes.set(ylabel=f"{name} ({unit})", xlabel="cycles")
        _count_cycles(axes)
        if k == 0:
            axes.legend(loc="best")
    return figure


def _count_cycles(axes: Axes) -> None:
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.counted(value)))


def drawn_parameters(diagnosis: Diagnosis) -> list[Estimate]:
    """Return the parameters of which there are draws."""
    return [one for one in diagnosis.parameters if len(one.draws) and np.isfinite(one.draws).all()]


def _corner(diagnosis: Diagnosis) -> Figure:
    """Return the posterior of the fitted parameters, each and in pairs."""
    shown = drawn_parameters(diagnosis)
    if not shown:
        raise _nothing("fitted parameters")
    return plot_corner(_titled(diagnosis, "90 % and 50 % regions", width=12.0, height=12.0), [
        (one.name, one.unit, one.draws) for one in shown])


def _wear(diagnosis: Diagnosis) -> Figure:
    """Return the worn depth measured and predicted, what they differ by, and profiles."""
    wear = diagnosis.wear_map
    if wear is None or not np.isfinite(wear.measured).any():
        raise _nothing("measured wear map")
    after = diagnosis.verdict is not Verdict.NONE
    return plot_wear_maps(_titled(diagnosis, "wear depth of both faces"), wear, after)


FIGURES: dict[str, Callable[[Diagnosis], Figure]] = {
    "loops": _loops, "evolution": _evolution, "parameters": _corner, "wear": _wear}
