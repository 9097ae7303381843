"""The small picture of an effect for the catalogue."""

from __future__ import annotations

from pathlib import Path
from textwrap import wrap

from fretflow.effects.effect import Effect

from fretflow_post import style

LETTERS = 100  # of a line that the figure has room for


def plot_effect(path: Path, name: str, effect: Effect) -> Path:
    """Draw the sketch of `effect` at its parameters as the PNG file `path`; its folder is made if need be."""
    sketch = effect.sketch()
    path.parent.mkdir(parents=True, exist_ok=True)
    with style.styled():
        figure = style.new_figure(name, "\n".join(wrap(effect.equation, LETTERS)), height=6.6)
        axes = figure.add_axes((0.12, 0.14, 0.62, 0.64))
        for k, (label, (x, y)) in enumerate(sketch.curves.items()):
            colour, line = style.curve_look(k)
            axes.plot(x, y, color=colour, linestyle=line, label=label)
        axes.set(xlabel=sketch.x_label, ylabel=sketch.y_label)
        if any(sketch.curves):
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
        return style.save_figure(figure, path)
