"""Shots inside matplotlib axes: where they lie and the labels on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fretflow_post import style
from fretflow_post.scene import View

_ARROW = {"arrowstyle": "-|>", "color": "black", "lw": 1.6, "shrinkA": 0, "shrinkB": 0}


def inches(left: float, bottom: float, width: float, tall: float, height: float) -> tuple[
        float, float, float, float]:
    """Return the place of axes given in inches on a figure of the full width and of `height`."""
    return left / style.WIDTH, bottom / height, width / style.WIDTH, tall / height


def axes_pixels(axes: Axes) -> tuple[int, int]:
    """Return the width and height of `axes` in the saved picture."""
    figure, box = axes.get_figure(), axes.get_position()
    width, height = figure.get_size_inches() if isinstance(figure, Figure) else (style.WIDTH, style.HEIGHT)
    return round(box.width * float(width) * style.DPI), round(box.height * float(height) * style.DPI)


def show_shot(axes: Axes, image: NDArray[np.uint8], view: View) -> None:
    """Fill `axes` with a shot; its data coordinates are then the shot's pixels."""
    width, height = view.size
    axes.imshow(image, extent=(0.0, width, height, 0.0), aspect="auto")
    axes.set_axis_off()


def edge_label(axes: Axes, view: View, start: Sequence[float], end: Sequence[float], text: str) -> None:
    """Draw an arrow beside the lower edge from `start` to `end` (mm) with its label below."""
    tail, head = view.pixels(np.array([start, end]))
    along = (head - tail) / np.linalg.norm(head - tail)
    below = np.array([-along[1], along[0]])
    below *= np.sign(below[1])
    tail, head = tail + 13.0 * below, head + 13.0 * below
    axes.annotate("", xy=tuple(head), xytext=tuple(tail), arrowprops=_ARROW)
    angle = float(np.degrees(np.arctan2(-along[1], along[0])))
    x, y = 0.5 * (tail + head) + 13.0 * below
    axes.text(x, y, text, rotation=(angle + 90.0) % 180.0 - 90.0, ha="center", va="center",
              rotation_mode="anchor", fontsize=13)


def axis_arrows(axes: Axes, view: View, caption: str = "x: sliding direction", length: float = 70.0) -> None:
    """Draw the directions x, y and z in the lower left corner over their `caption`."""
    directions = view.axes[:2].T * [length, -length]  # of x, y, z in the image
    low = np.minimum(directions.min(axis=0), 0.0)
    high = np.maximum(directions.max(axis=0), 0.0)
    origin = np.array([18.0 - low[0], view.size[1] - 46.0 - high[1]])
    for name, arrow in zip("xyz", directions, strict=True):
        axes.annotate("", xy=tuple(origin + arrow), xytext=tuple(origin), arrowprops=_ARROW)
        x, y = origin + arrow + 13.0 * arrow / np.linalg.norm(arrow)
        axes.text(x, y, name, ha="center", va="center", fontsize=15)
    axes.text(10.0, view.size[1] - 8.0, caption, ha="left", va="bottom", fontsize=13,
              bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 2.0})
