"""Recorded loops and what is read off them over the cycles; PNG with its CSV."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fretflow.core.records import Array
from fretflow.core.store import write_csv
from fretflow.core.units import pretty_unit, readable_unit
from fretflow.recordings.loop_sets import LoopsRead
from fretflow.recordings.readings import LoopReading, RecordedReadings
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from fretflow_post import style

MOST_LOOPS = 9  # drawn and named in the legend; more would not be told apart
MOST_BARS = 60  # told apart in a panel; of more a band is drawn
LIGHTEST = 0.92  # of the colour map: its end is too pale on white


@dataclass(frozen=True)
class Panel:
    """One reading over the cycles."""

    title: str
    estimate: LoopReading
    unit: str


def plot_recorded_loops(path: Path, title: str, loops_read: LoopsRead) -> list[Path]:
    """Draw the mean loop of each cycle count over its repeats, and the readings with one standard deviation.

    Of many cycle counts some are drawn, the first and last among them. The CSV holds the loops that are drawn.
    """
    loops, readings, index = loops_read.loops, loops_read.readings, loops_read.index
    x, force = loops.mean("displacement"), loops.mean(loops.force_name)
    kept = np.flatnonzero(loops.repeats)
    some = np.unique(np.linspace(0, len(kept) - 1, min(MOST_LOOPS, len(kept))).round().astype(int))
    drawn = kept[some]
    repeats = int(loops.repeats[kept].max())
    with style.styled():
        figure = style.new_figure(title, _subtitle(len(drawn), len(kept), repeats, index), height=9.4)
        axes = figure.add_axes((0.065, 0.095, 0.42, 0.76))
        scales = [readable_unit(float(np.nanmax(np.abs(values[drawn]))), si) for values, si in ((x, "m"), (force, "N"))]
        for place, k in enumerate(drawn):
            colour = style.colour_map(style.DEPTH_MAP)(LIGHTEST * place / max(1, len(drawn) - 1))
            for r in np.flatnonzero(loops.usable[k]):
                if repeats > 1:
                    axes.plot(_closed(loops.displacement[k, r], scales[0][1]), _closed(loops.force[k, r], scales[1][1]),
                              color=colour, linewidth=0.6, alpha=0.35)
            axes.plot(_closed(x[k], scales[0][1]), _closed(force[k], scales[1][1]), color=colour, linewidth=1.8,
                      label=_narrow(loops_read.called[some[place]]))
        axes.set(xlabel=f"relative displacement ({pretty_unit(scales[0][0])})",
                 ylabel=f"{loops.force_name.replace('_', ' ')} ({scales[1][0]})")
        axes.legend(title=index, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
        panels = _panels(readings)
        for row, panel in enumerate(panels):
            height = 0.76 / len(panels)
            box = (0.685, 0.095 + height * (len(panels) - 1 - row), 0.295, height - 0.035)
            _draw(figure.add_axes(box), panel, loops_read, row == len(panels) - 1)
        png = style.save_figure(figure, path)
    samples = len(loops.phase)
    columns = {index: np.repeat(loops.cycles[drawn], samples), "phase_rad": np.tile(loops.phase, len(drawn)),
               "displacement_m": x[drawn].ravel(), "force_N": force[drawn].ravel()}
    return [png, write_csv(path.with_suffix(".csv"), columns)]


def _subtitle(drawn: int, kept: int, repeats: int, index: str) -> str:
    what = f"{drawn} of {kept}" if drawn < kept else f"{kept}"
    what += " cycle counts" if index == "cycles" else f" {index}"
    over = f", mean of up to {repeats} repeats (thin: each)" if repeats > 1 else ""
    return f"loops of {what}{over}; bars or band: one standard deviation"


def _panels(readings: RecordedReadings) -> list[Panel]:
    known = np.isfinite(readings.friction_coefficient.value).any()
    first = (Panel("friction\ncoefficient", readings.friction_coefficient, "1") if known
             else Panel("friction limit", readings.friction_limit, "N"))
    panels = [first, Panel("tangential\nstiffness", readings.tangential_stiffness, "N/m"),
              Panel("dissipated\nenergy", readings.dissipated_energy, "J"),
              Panel("sliding\ndistance", readings.sliding_distance, "m"),
              Panel("peak to peak", readings.peak_to_peak, "m")]
    shown = [panel for panel in panels if np.isfinite(panel.estimate.value).any()]
    return shown[:4]


def _draw(axes: Axes, panel: Panel, loops_read: LoopsRead, last: bool) -> None:
    """Draw a reading over what tells the loops apart; cycles are joined, conditions have no order to join them by."""
    unit, size = readable_unit(float(np.nanmax(np.abs(panel.estimate.value))), panel.unit)
    value, sd = panel.estimate.value / size, panel.estimate.sd / size
    if loops_read.index == "conditions":
        places = np.arange(len(value))
        axes.errorbar(places, value, sd, color=style.BLUE, capsize=3, linewidth=0.0, elinewidth=1.2, marker="o")
        axes.set_xticks(places, [_narrow(name) for name in loops_read.called])
        axes.margins(x=0.12)
    else:
        _draw_over_cycles(axes, loops_read.readings.cycles, value, sd)
    axes.set_ylabel(panel.title + (f"\n({pretty_unit(unit)})" if unit != "1" else ""), fontsize=13)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axes.tick_params(labelbottom=last, labelsize=12)
    axes.set_xlabel(loops_read.index if last and loops_read.index == "cycles" else "")
    axes.margins(y=0.15)


def _draw_over_cycles(axes: Axes, cycles: NDArray[np.int64], value: Array, sd: Array) -> None:
    """Join readings by lines, with bars of one standard deviation, of many cycles with a band of it."""
    if len(cycles) <= MOST_BARS:
        axes.errorbar(cycles, value, sd, color=style.BLUE, capsize=3, linewidth=1.2, marker="o", markersize=5.0)
    else:
        axes.plot(cycles, value, color=style.BLUE, linewidth=1.2)
        axes.fill_between(cycles, value - sd, value + sd, color=style.BLUE, alpha=0.25, linewidth=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True, steps=[1, 2, 5, 10]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda count, _: style.counted(count)))


def _narrow(name: str) -> str:
    """Return what a loop is called with each number on a line of its own."""
    return re.sub(r" (?=\d)", "\n", name)


def _closed(values: Array, size: float) -> Array:
    return np.append(values, values[0]) / size
