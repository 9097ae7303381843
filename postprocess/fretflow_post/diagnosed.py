"""A diagnosis as figures to look at or to go on with: all that its report draws."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from fretflow.core.errors import InputError, did_you_mean, printable
from fretflow.core.records import Array
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.inference.parameters import HALF
from fretflow.inference.verdict import Diagnosis, Estimate, Evolution, MeasuredCurve, ResidualLaw, ResidualMap, Verdict
from fretflow.inference.words import channel_words, headline, together
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from fretflow_post import style
from fretflow_post.corner import plot_corner
from fretflow_post.wear_maps import plot_wear_maps

MOST_LOOPS = 6  # more would be too small to compare
SAME = 1e-9  # of the largest value: a channel that is predicted this well was given, not predicted
LARGE = 12.0  # sd: above it colours follow the square root, so that what is left after is seen beside what was before
SMALLEST_LIMIT = 6.0  # sd: smaller differences than this are never drawn in full colour
LARGEST_SHARE = 0.99  # of the differences before lies within the colours
FIXED_UNITS = {"1": ("%", 0.01), "Hz": ("Hz", 1.0), "m*kg^0.5": ("m·√kg", 1.0)}  # which need no other size or have none
READ = (("friction_limit", "friction limit", "N"), ("tangential_stiffness", "tangential stiffness", "N/m"),
        ("dissipated_energy", "energy of a cycle", "J"), ("sliding_distance", "sliding distance", "m"))


def _drawn(draw: Callable[[Diagnosis], Figure | None]) -> Callable[[Diagnosis], Figure | None]:
    """Return `draw` in the style of all figures; it returns None where there is nothing to draw."""
    def styled(diagnosis: Diagnosis) -> Figure | None:
        with style.styled():
            return draw(diagnosis)

    return styled


def plot_diagnosis(diagnosis: Diagnosis, what: str = "loops") -> Figure:
    """Return a figure of one of `FIGURES`: loops, evolution, maps, parameters, wear, curves, volumes or law.

    Raises
    ------
    InputError
        If there is no such figure, or the diagnosis has nothing to draw there.
    """
    if what not in FIGURES:
        raise InputError(f"plot: {what!r} is none of {', '.join(FIGURES)}{did_you_mean(what, FIGURES)}")
    figure = FIGURES[what](diagnosis)
    if figure is None:
        raise InputError(f"plot: this diagnosis has nothing to draw as {what!r}")
    return figure


def _titled(diagnosis: Diagnosis, what: str = "", **size: float) -> Figure:
    named = f": {together(diagnosis.effects)}" if diagnosis.effects else ""
    told = headline(diagnosis) + named
    return style.new_figure(diagnosis.title or diagnosis.recording, f"{told}; {what}" if what else told, **size)


def _axes(figure: Figure, count: int, columns: int) -> Iterator[Axes]:
    columns = min(columns, count)
    grid = figure.add_gridspec(-(-count // columns), columns, left=0.09, right=0.97, bottom=0.12, top=0.85, hspace=0.35,
                               wspace=0.28)
    return (figure.add_subplot(grid[k // columns, k % columns]) for k in range(count))


@_drawn
def _loops(diagnosis: Diagnosis) -> Figure | None:
    """Return up to six of the loops: measured, as the refitted baseline has them and with the named effects."""
    every = diagnosis.comparisons
    if not every:
        return None
    some = np.linspace(0, len(every) - 1, min(MOST_LOOPS, len(every))).round().astype(int)
    shown = [every[k] for k in np.unique(some)]
    figure = _titled(diagnosis, f"{len(shown)} of {len(every)} loops" if len(shown) < len(every) else "")
    for axes, one in zip(_axes(figure, len(shown), 3), shown, strict=True):
        parts = (("measured", one.displacement, one.force), ("baseline", one.before_displacement, one.before_force),
                 (diagnosis.after_model or "after", one.after_displacement, one.after_force))
        for (name, x, force), (_, colour, line, _) in zip(parts, style.LOOKS, strict=True):
            axes.plot(np.append(x, x[0]) * 1e6, np.append(force, force[0]), color=colour, linestyle=line, label=name)
        axes.set(xlabel="displacement (µm)", ylabel="force (N)")
        axes.set_title(printable(one.label) + (", held out" if one.held_out else ""), parse_math=False)
    figure.legend(*axes.get_legend_handles_labels(), loc="lower center", ncols=3, frameon=False)
    return figure


def readings(evolution: Evolution) -> Iterator[tuple[str, str, Array]]:
    """Return what is known of an evolution: name, printed unit, and values (3, n) in that unit."""
    for field, name, si in READ:
        values = getattr(evolution, field)
        if np.isfinite(values[0]).any():
            unit, size = readable_unit(float(np.nanmax(np.abs(values))), si)
            yield name, pretty_unit(unit), values / size


@_drawn
def _evolution(diagnosis: Diagnosis) -> Figure | None:
    """Return the readings over the cycles: measured, before and after."""
    if diagnosis.evolution is None:
        return None
    figure = _titled(diagnosis, "what is read off the loops over the cycles")
    read = list(readings(diagnosis.evolution))
    for k, (axes, (name, unit, values)) in enumerate(zip(_axes(figure, len(read), 2), read, strict=True)):
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


@_drawn
def _corner(diagnosis: Diagnosis) -> Figure | None:
    """Return the posterior of the fitted parameters, each and in pairs."""
    shown = drawn_parameters(diagnosis)
    if not shown:
        return None
    return plot_corner(_titled(diagnosis, "90 % and 50 % regions", width=12.0, height=12.0), [
        (one.name, one.unit, one.draws) for one in shown])


@_drawn
def _wear(diagnosis: Diagnosis) -> Figure | None:
    """Return the worn depth measured and predicted, what they differ by, and profiles."""
    wear = diagnosis.wear_map
    if wear is None or not np.isfinite(wear.measured).any():
        return None
    return plot_wear_maps(_titled(diagnosis, "wear depth of both faces"), wear, "after" in _predicted(diagnosis))


def _predicted(diagnosis: Diagnosis) -> tuple[str, ...]:
    return ("before",) if diagnosis.verdict is Verdict.NONE else ("before", "after")


def residuals(diagnosis: Diagnosis) -> tuple[list[ResidualMap], float, float]:
    """Return the maps of predicted channels, from how many sd on colours are full, and which power they follow."""
    maps = [one for one in diagnosis.residual_maps if np.nanmax(np.abs(one.before), initial=0.0) > SAME]
    known = [np.abs(one.before[np.isfinite(one.before)]) for one in maps]
    largest = float(np.quantile(np.concatenate(known), LARGEST_SHARE)) if maps else 0.0
    limit = style.round_scale(max(SMALLEST_LIMIT, largest))[0]
    return maps, limit, 0.5 if limit > LARGE else 1.0


@_drawn
def _maps(diagnosis: Diagnosis) -> Figure | None:
    """Return the differences over loop and phase: a row for each channel."""
    maps, limit, exponent = residuals(diagnosis)
    if not maps:
        return None
    figure, shown = _titled(diagnosis, "(measured − predicted) / standard deviation"), _predicted(diagnosis)
    panels = [(one, name) for one in maps for name in shown]
    colours = ListedColormap(style.palette(style.SHAPE_MAP, exponent))
    for axes, (one, name) in zip(_axes(figure, len(panels), len(shown)), panels, strict=True):
        drawn = axes.imshow(getattr(one, name), cmap=colours, vmin=-limit, vmax=limit, aspect="auto",
                            extent=(0.0, 1.0, len(one.rows), 0.0), interpolation="nearest")
        figure.colorbar(drawn, ax=axes)
        axes.set(xlabel="share of the period")
        axes.set_title(f"{channel_words(one.channel)}, {name}", parse_math=False)
        axes.set_yticks(np.arange(len(one.rows)) + 0.5, [printable(row) for row in one.rows], fontsize=10,
                        parse_math=False)
        axes.grid(False)
    return figure


def curve_units(one: MeasuredCurve) -> Iterator[tuple[str, float]]:
    """Return the printed unit and its size in SI, of the abscissa and of the ordinate."""
    for values, unit in ((one.x, one.x_unit), (one.measured, one.y_unit)):
        readable, size = FIXED_UNITS.get(unit) or readable_unit(float(np.median(np.abs(values))), unit)
        yield pretty_unit(readable), size


@_drawn
def _curves(diagnosis: Diagnosis) -> Figure | None:
    """Return backbones, responses or worn profiles: measured points and predicted lines."""
    if not diagnosis.curves:
        return None
    figure = _titled(diagnosis, "points measured, lines predicted")
    for axes, one in zip(_axes(figure, len(diagnosis.curves), 3), diagnosis.curves, strict=True):
        (x_unit, x_size), (y_unit, y_size) = curve_units(one)
        for name, colour, line, mark in style.LOOKS:
            if name == "measured" or name in _predicted(diagnosis):
                axes.plot(one.x / x_size, getattr(one, name) / y_size, color=colour, label=name,
                          linestyle="" if mark else line, marker=mark)
        axes.set_xlabel(f"{one.x_label} ({x_unit})", parse_math=False)
        axes.set_ylabel(f"{one.y_label} ({y_unit})", parse_math=False)
        axes.set_title(printable(one.label), parse_math=False)
        axes.legend(loc="best")
    return figure


@_drawn
def _volumes(diagnosis: Diagnosis) -> Figure | None:
    """Return the predicted over the measured volume of each test."""
    tests = diagnosis.wear_tests
    if tests is None or not len(tests.measured):
        return None
    figure = _titled(diagnosis, "worn volumes of the tests", height=8.0)
    (axes,) = _axes(figure, 1, 1)
    for name, colour, _, _ in style.LOOKS[1:1 + len(_predicted(diagnosis))]:
        axes.plot(tests.measured * 1e9, getattr(tests, name) * 1e9, "o", color=colour, label=name)
    axes.axline((0.0, 0.0), slope=1.0, color="grey", linewidth=1.0)
    axes.set(xlabel="measured volume (mm³)", ylabel="predicted volume (mm³)")
    axes.legend(loc="best")
    return figure


def law_curve(law: ResidualLaw | None) -> tuple[tuple[str, str], Array, Array, Array] | None:
    """Return labels of the axes, the state, the difference and half its 90 % interval, (n,) each, in printed units."""
    if law is None or not (np.isfinite(law.x) & np.isfinite(law.y)).any():
        return None
    (x_unit, x_size), (y_unit, y_size) = (readable_unit(float(np.nanmax(np.abs(values))), unit) for values, unit in (
        (law.x, law.state_unit), (law.y, law.channel_unit)))
    x_label, y_label = (f"{name} ({pretty_unit(unit)})" if unit else name for name, unit in (
        (law.state, x_unit), (f"{channel_words(law.channel)}, measured − predicted", y_unit)))
    order = np.argsort(law.x)
    return (x_label, y_label), law.x[order] / x_size, law.y[order] / y_size, HALF * law.sd[order] / y_size


@_drawn
def _law(diagnosis: Diagnosis) -> Figure | None:
    """Return what an unlisted effect does, from the data."""
    curve = law_curve(diagnosis.residual_law)
    if curve is None:
        return None
    labels, x, y, half_width = curve
    figure = _titled(diagnosis, "what is missing, from the data, with its 90 % interval")
    (axes,) = _axes(figure, 1, 1)
    axes.plot(x, y, color=style.BLUE)
    axes.fill_between(x, y - half_width, y + half_width, color=style.BLUE, alpha=0.2, linewidth=0.0)
    axes.set_xlabel(labels[0], parse_math=False)
    axes.set_ylabel(labels[1], parse_math=False)
    return figure


FIGURES: dict[str, Callable[[Diagnosis], Figure | None]] = {
    "loops": _loops, "evolution": _evolution, "maps": _maps, "parameters": _corner, "wear": _wear, "curves": _curves,
    "volumes": _volumes, "law": _law}
