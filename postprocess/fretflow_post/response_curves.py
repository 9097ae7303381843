"""Nonlinear frequency responses: all periods found, stable and unstable, with resonances, half-power points, folds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from fretflow.pipeline.response_curves import RunCurve
from fretflow.solvers.continuation.curve import Peak, SweepDirection, channel_index
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from fretflow_post import style
from fretflow_post.curves import UM, readable_log

BLOCK = channel_index("block")
UNSTABLE = (0, (4, 2))


def plot_curves(path: Path, curves: Sequence[RunCurve]) -> list[Path]:
    """Draw amplitude per force and phase of the moving mass along `curves`; write a PNG.

    Each curve has a colour; followed upward it is drawn strong, downward thin. What is unstable is dashed.
    """
    with style.styled():
        figure = style.new_figure(
            "Nonlinear frequency response of the moving mass",
            "first harmonic; all periods found by continuation, upward (thick) and downward (thin)", height=10.6)
        upper = figure.add_axes((0.09, 0.37, 0.88, 0.52))
        lower = figure.add_axes((0.09, 0.08, 0.88, 0.23), sharex=upper)
        for index, run in enumerate(curves):
            _draw(upper, lower, run, style.CURVE_COLOURS[index % len(style.CURVE_COLOURS)])
        readable_log(upper.yaxis, (1.0, 2.0, 5.0))
        readable_log(upper.xaxis, (1.0, 2.0, 3.0, 4.0, 5.0, 7.0))
        upper.set(ylabel="amplitude per force (µm/N)")
        upper.tick_params(labelbottom=False)
        handles, labels = upper.get_legend_handles_labels()
        signs = _signs(curves)
        upper.legend([*handles, *signs.values()], [*labels, *signs], loc="best")
        lower.set(xlabel="frequency of the force (Hz)", ylabel="phase lag (°)", yticks=[0, 45, 90, 135, 180])
        return [style.save_figure(figure, path)]


def _draw(upper: Axes, lower: Axes, run: RunCurve, colour: str) -> None:
    curve = run.curve
    frequency, motion = curve.frequency, curve.first_harmonic[:, BLOCK]
    receptance = np.abs(motion) * UM / curve.excitation
    phase = np.degrees(np.mod(-np.angle(motion), 2.0 * np.pi))
    for direction in (SweepDirection.DOWN, SweepDirection.UP):
        own = curve.along(direction)
        if not len(own):
            continue
        peak = run.peak(direction)
        label = _label(run, peak) if direction is SweepDirection.UP or not len(curve.along(SweepDirection.UP)) else None
        width = 2.4 if direction is SweepDirection.UP else 1.0
        for part, stable in _stretches(own, curve.stable):
            line = "-" if stable else UNSTABLE
            upper.loglog(frequency[part], receptance[part], color=colour, linestyle=line, linewidth=width, label=label)
            lower.plot(frequency[part], phase[part], color=colour, linestyle=line, linewidth=width)
            label = None
        turns, gaps = curve.turning_points(direction), own[curve.bridged[own]]
        upper.plot(frequency[turns], receptance[turns], "^", color=colour, markerfacecolor="white")
        upper.plot(frequency[gaps], receptance[gaps], "x", color=colour)
        if direction is SweepDirection.UP:
            _mark(upper, peak, curve.excitation, colour)


def _mark(axes: Axes, peak: Peak, excitation: float, colour: str) -> None:
    top = peak.amplitude * UM / excitation
    axes.plot(peak.frequency, top, "o", color=colour, markersize=10)
    sides = [side for side in (peak.lower_half_power, peak.upper_half_power) if side is not None]
    axes.plot(sides, [top / np.sqrt(2.0)] * len(sides), "|", color=colour, markersize=16, markeredgewidth=2.0)


def _label(run: RunCurve, peak: Peak) -> str:
    damping = "" if peak.damping_ratio is None else f", damping {100.0 * peak.damping_ratio:.2g} %"
    return (f"{style.figures(run.curve.excitation)} N, {style.when_words(run.cycles)}: {peak.frequency:.4g} Hz, "
            f"{style.figures(peak.amplitude * UM)} µm{damping}")


def _stretches(own: NDArray[np.int64], stable: NDArray[np.bool_]) -> list[tuple[NDArray[np.int64], bool]]:
    """Return runs of points that are all stable or not, each with the first point of the next."""
    parts, place = [], 0
    for kind, members in groupby(own, key=lambda k: bool(stable[k])):
        count = len(list(members))
        parts.append((own[place:place + count + 1], kind))
        place += count
    return parts


def _signs(curves: Sequence[RunCurve]) -> dict[str, Line2D]:
    """Return the signs that occur in `curves`, by their meaning."""
    peaks = [run.peak(direction) for run in curves for direction in SweepDirection if len(run.curve.along(direction))]
    turns = sum(len(run.curve.turning_points(direction)) for run in curves for direction in SweepDirection)
    signs = {"resonance": (True, Line2D([], [], color=style.BLACK, linestyle="", marker="o", markersize=10)),
             "half power": (any(peak.damping_ratio is not None for peak in peaks),
                            Line2D([], [], color=style.BLACK, linestyle="", marker="|", markersize=16,
                                   markeredgewidth=2.0)),
             "unstable": (any(not np.all(run.curve.stable) for run in curves),
                          Line2D([], [], color=style.BLACK, linestyle=UNSTABLE)),
             "turning point": (turns > 0, Line2D([], [], color=style.BLACK, linestyle="", marker="^",
                                                 markerfacecolor="white")),
             "gap bridged": (any(np.any(run.curve.bridged) for run in curves),
                             Line2D([], [], color=style.BLACK, linestyle="", marker="x"))}
    return {meaning: line for meaning, (occurs, line) in signs.items() if occurs}
