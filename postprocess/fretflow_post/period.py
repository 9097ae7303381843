"""A period as an animation: tractions over the contact, what sticks and slips, and where on the loop it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fretflow.contact.law import ContactState
from fretflow.core.records import Array
from fretflow.solvers.periodic import PeriodicSolution
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray
from PIL.Image import Image, frombuffer

from fretflow_post import style
from fretflow_post.contact_grid import contact_cells, node_patches

FRAMES, PER_SECOND = 24, 8  # a period in three seconds
DPI = 60  # of the animation: a file of less than 1 MB
STATE_LOOKS = {ContactState.STICK: ("sticks", style.BLUE), ContactState.SLIP: ("slips", style.ORANGE),
               ContactState.SEPARATION: ("is open", "#F2F2F2")}


def plot_period(path: Path, nodes: Array, areas: Array, period: PeriodicSolution, when: str) -> Path:
    """Write `period` as an animation in GIF beside `path`.

    Parameters
    ----------
    path
        Its suffix is replaced.
    nodes, areas
        Contact nodes in m, (nodes, 2), and their areas in m^2, (nodes,).
    period
        The motion and its forces.
    when
        Words for the title.
    """
    moments = np.linspace(0, len(period.friction_force), min(FRAMES, len(period.friction_force)), endpoint=False)
    traction = -period.force[:, :, 0] / areas * 1e-6  # of the upper specimen on the lower one, as in the loop
    limit = float(np.abs(traction).max()) or 1.0
    with style.styled():
        figure = style.new_figure(f"One period, {when}", "traction along x of the upper specimen on the lower one; "
                                  "each node fills the area around it", height=6.4)
        grid = figure.add_gridspec(1, 3, left=0.065, right=0.98, bottom=0.16, top=0.78, wspace=0.35)
        panels = [figure.add_subplot(grid[0, k]) for k in range(3)]
        tractions, owner = _patches(panels[0], nodes, "tangential traction (MPa)")
        tractions.set(cmap=style.SHAPE_MAP, clim=(-limit, limit))
        panels[0].set_ylabel("y (mm)")
        figure.colorbar(tractions, ax=panels[0], fraction=0.046)
        states, _ = _patches(panels[1], nodes, "what each node does")
        states.set(cmap=ListedColormap([STATE_LOOKS[state][1] for state in sorted(STATE_LOOKS)]),
                   clim=(-0.5, len(STATE_LOOKS) - 0.5))
        panels[1].legend(handles=[Patch(facecolor=colour, edgecolor="black", label=name)
                                  for name, colour in STATE_LOOKS.values()], loc="upper center", ncols=3, frameon=False,
                         bbox_to_anchor=(0.5, -0.14), fontsize=13, handlelength=1.0, columnspacing=1.0)
        x = (period.upper_observation - period.lower_observation)[:, 0] * 1e6
        _loop(panels[2], x, period.friction_force)
        (dot,) = panels[2].plot([], [], "o", color=style.VERMILLION, markersize=13)

        def show(k: int) -> None:
            tractions.set_array(traction[k, owner])
            states.set_array(period.state[k, owner].astype(float))
            dot.set_data([x[k]], [period.friction_force[k]])

        moving = [tractions, *panels[0].spines.values(), states, *panels[1].spines.values(), dot]
        shots = list(_shots(figure, moving, show, moments.astype(int)))
        path = path.with_suffix(".gif")
        path.parent.mkdir(parents=True, exist_ok=True)
        shots[0].save(path, save_all=True, append_images=shots[1:], duration=1000 // PER_SECOND, loop=0)
        return path


def _shots(figure: Figure, moving: Sequence[Artist], show: Callable[[int], None], moments: Iterable[int]
           ) -> Iterator[Image]:
    """Yield pictures of a figure at some moments, over one of all that does not move: its words take longest."""
    for one in moving:
        one.set_animated(True)
    figure.set_dpi(DPI)
    canvas: Any = FigureCanvasAgg(figure)  # of which few methods are typed
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    for moment in moments:
        show(moment)
        canvas.restore_region(still)
        for one in moving:
            figure.draw_artist(one)
        yield frombuffer("RGBA", canvas.get_width_height(), bytes(canvas.buffer_rgba())).convert("RGB")


def _patches(axes: Axes, nodes: Array, title: str) -> tuple[PolyCollection, NDArray[np.int64]]:
    """Return the areas around the nodes as polygons, and the node of each."""
    points, quads, owner = node_patches(np.column_stack([nodes * 1e3, np.zeros(len(nodes))]), contact_cells(nodes))
    drawn = PolyCollection(list(points[quads][:, :, :2]), edgecolor="face", linewidth=0.3)
    axes.add_collection(drawn)
    axes.autoscale_view()
    axes.set(title=title, xlabel="x, sliding direction (mm)", aspect="equal")
    axes.grid(False)
    return drawn, owner


def _loop(axes: Axes, x: Array, force: Array) -> None:
    axes.plot(np.append(x, x[0]), np.append(force, force[0]), color=style.BLUE)
    axes.set(title="where on the loop", xlabel="relative displacement (µm)", ylabel="friction force (N)")
