"""A run, or a diagnosis, on one figure to look at or to go on with: nothing is written."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from fretflow.core.units import readable_unit
from fretflow.pipeline.results import RunResults
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from fretflow_post import style
from fretflow_post.curves import readable_log
from fretflow_post.diagnosed import plot_diagnosis as plot_diagnosis

Panel = Callable[[Axes, RunResults], None]


def plot_results(run: RunResults) -> Figure:
    """Return loops, mean pressure and wear depth at the last kept cycle count, worn volume, response: what there is."""
    panels: list[Panel] = [_loops, _map("mean_pressure", "Mean pressure", style.PRESSURE_MAP)]
    if run.has("wear"):
        panels += [_map("wear_depth", "Wear depth of both faces", style.DEPTH_MAP), _volume]
    if run.responses:
        panels.append(_response)
    columns = 2 if len(panels) <= 4 else 3
    with style.styled():
        figure = style.new_figure(run.case.title or run.case.name, f"{run.home}; maps {_last(run)}")
        grid = figure.add_gridspec(-(-len(panels) // columns), columns, left=0.07, right=0.97, bottom=0.08, top=0.86,
                                   hspace=0.4, wspace=0.32)
        for k, draw in enumerate(panels):
            draw(figure.add_subplot(grid[k // columns, k % columns]), run)
    return figure


def _loops(axes: Axes, run: RunResults) -> None:
    for k, cycles in enumerate(run.loops.cycles.values):
        one = run.loops.sel(cycles=cycles)
        colour, line = style.curve_look(k)
        axes.plot(_closed(one.displacement.values) * 1e6, _closed(one.friction_force.values), color=colour,
                  linestyle=line, label=style.when_words(int(cycles)))
    axes.set(title="Hysteresis loops", xlabel="relative displacement (µm)", ylabel="friction force (N)")
    axes.legend(loc="center", frameon=False)


def _map(name: str, title: str, colours: str) -> Panel:
    def draw(axes: Axes, run: RunResults) -> None:
        last = run.maps.isel(cycles=-1)
        unit, size = readable_unit(float(last[name].max()), last[name].attrs["units"])
        drawn = axes.tricontourf(last.x * 1e3, last.y * 1e3, last[name] / size, 24, cmap=colours)
        bar = axes.figure.colorbar(drawn, ax=axes, ticks=MaxNLocator(6))
        bar.set_label(unit.replace("um", "µm"))
        axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
        axes.grid(False)

    return draw


def _last(run: RunResults) -> str:
    return style.when_words(int(run.maps.cycles[-1]))


def _volume(axes: Axes, run: RunResults) -> None:
    axes.plot(run.wear.cycles, run.wear.volume * 1e9, color=style.BLUE)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: style.counted(value)))
    axes.set(title="Worn volume", xlabel="cycles", ylabel="mm³")


def _response(axes: Axes, run: RunResults) -> None:
    for k, (state, curve) in enumerate(run.curves.items()):
        colour, line = style.curve_look(k)
        axes.loglog(curve.frequency, curve.amplitude * 1e6, color=colour, linestyle=line, label=state)
    readable_log(axes.xaxis, (1.0, 2.0, 5.0))
    readable_log(axes.yaxis, (1.0, 3.0))
    axes.set(title="Response of the moving mass", xlabel="frequency (Hz)", ylabel="amplitude (µm)")
    axes.legend(loc="best")


def _closed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.append(values, values[0])
