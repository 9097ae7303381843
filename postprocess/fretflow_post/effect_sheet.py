"""The small picture of an effect for the catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap

import numpy as np
from fretflow.core.units import pretty_number
from fretflow.effects.effect import Effect, Sketch
from matplotlib.axes import Axes

from fretflow_post import style

LETTERS = 100  # of a line that the figure has room for


def plot_effect(path: Path, name: str, effect: Effect) -> Path:
    """Draw the sketch of `effect` at its parameters as the PNG file `path`; its folder is made if need be."""
    sketch = effect.sketch()
    path.parent.mkdir(parents=True, exist_ok=True)
    parts = [(0.46, 0.38), (0.1, 0.24)] if is_comparable(sketch) else [(0.14, 0.64)]  # bottom, height
    with style.styled():
        figure = style.new_figure(name, "\n".join(wrap(effect.equation, LETTERS)), height=3.3 * (1 + len(parts)))
        draw_sketch([figure.add_axes((0.12, bottom, 0.62, height)) for bottom, height in parts], sketch)
        return style.save_figure(figure, path)


def draw_sketch(panels: Sequence[Axes], sketch: Sketch) -> None:
    """Draw what a sketch shows and, in a second panel, what the effect changes of the baseline, which may be little."""
    for k, (label, (x, y)) in enumerate(sketch.curves.items()):
        colour, line = style.curve_look(k)
        panels[0].plot(x, y, color=colour, linestyle=line, label=label)
    panels[0].set(ylabel=sketch.y_label)
    if any(sketch.curves):
        panels[0].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    if len(panels) > 1:
        panels[0].tick_params(labelbottom=False)
        panels[1].sharex(panels[0])
        x, without = sketch.curves["baseline"]
        panels[1].plot(x, sketch.curves["effect"][1] - without, color=style.curve_look(1)[0])
        panels[1].axhline(0.0, color="black", linewidth=0.8)
        panels[1].set(ylabel="effect −\nbaseline")
    panels[-1].set(xlabel=sketch.x_label)
    panels[-1].xaxis.set_major_formatter(lambda value, _: pretty_number(value).replace("-", "−"))


def is_comparable(sketch: Sketch) -> bool:
    """Tell whether a sketch has two curves over the same."""
    if {*sketch.curves} != {"baseline", "effect"}:
        return False
    (without, _), (over, _) = sketch.curves.values()
    return bool(np.array_equal(without, over))
