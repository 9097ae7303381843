"""Curves: hysteresis loops, frequency responses, wear volume, natural frequencies; each PNG with its CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fretflow.contact.interface import area_mean
from fretflow.core.store import write_csv
from fretflow.core.units import pretty_number
from fretflow.pipeline.run_records import ForcedResponse, stated_error
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.reduction.reduced_specimen import FREQUENCY_LIMIT, ReducedSpecimen
from fretflow.structure.two_mass_rig.lumped import RigModes
from fretflow.wear.history import WearHistory
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from fretflow_post import style
from fretflow_post.mode_shapes import plot_rig_modes

UM, MM3 = 1e6, 1e9


@dataclass(frozen=True)
class LoopCurve:
    """A hysteresis loop at a cycle count: relative displacements in m and friction force in N, (N,) each."""

    cycles: int
    observed: NDArray[np.float64]
    faces: NDArray[np.float64]
    force: NDArray[np.float64]


def loop_of(period: PeriodicSolution, areas: NDArray[np.float64], cycles: int) -> LoopCurve:
    """Return the hysteresis loop of `period`, along x.

    Displacement of the faces is the area mean over the contact nodes; `areas` in m^2, (nodes,).
    """
    return LoopCurve(cycles, (period.upper_observation - period.lower_observation)[:, 0],
                area_mean(period.displacement[:, :, 0], areas), period.friction_force)


def plot_loops(path: Path, loops: Sequence[LoopCurve]) -> list[Path]:
    """Draw hysteresis `loops` at the observed points and at the faces; write PNG and CSV."""
    with style.styled():
        figure = style.new_figure("Hysteresis loops", "friction force of the upper specimen on the lower one "
                                  "against their relative displacement, one steady period", height=8.6)
        panels = [figure.add_axes((0.07 + 0.43 * k, 0.105, 0.36, 0.7)) for k in range(2)]
        for k, loop in enumerate(loops):
            colour, line = style.curve_look(k)
            for axes, motion in zip(panels, (loop.observed, loop.faces), strict=True):
                axes.plot(_closed(motion) * UM, _closed(loop.force), color=colour, linestyle=line,
                          label=style.counted(loop.cycles))
        titles = ("At the observed points", "At the contact faces (area mean)")
        for axes, title in zip(panels, titles, strict=True):
            axes.set(xlabel="relative displacement, x (µm)", ylabel="friction force, x (N)", title=title)
        panels[1].legend(title="cycles", loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
        png = style.save_figure(figure, path)
    many = {"cycles": np.concatenate([np.full(len(p.force), p.cycles) for p in loops]),
            "sample": np.concatenate([np.arange(len(p.force)) for p in loops]),
            "observed_displacement_m": np.concatenate([p.observed for p in loops]),
            "faces_displacement_m": np.concatenate([p.faces for p in loops]),
            "friction_force_N": np.concatenate([p.force for p in loops])}
    return [png, write_csv(path.with_suffix(".csv"), many)]


def _closed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.append(values, values[0])


def _checked(responses: Sequence[ForcedResponse]) -> str:
    """Say how far the contact's backbone, which the curves are made with, is off."""
    stated = stated_error(responses)
    return f";\ncontact by its backbone: {stated}" if stated else ""


def plot_responses(path: Path, responses: Sequence[ForcedResponse]) -> list[Path]:
    """Draw forced responses, amplitude per force with the resonances marked, and phase; write PNG and CSV."""
    with style.styled():
        figure = style.new_figure(
            "Forced response of the moving mass",
            f"force of {style.figures(responses[0].excitation)} N at every frequency; first harmonic; "
            f"marked: the resonances{_checked(responses)}", height=10.0 if len(responses) == 1 else 12.6)
        parts = (0.085, 0.23, 0.37, 0.51) if len(responses) == 1 else (0.07, 0.18, 0.52, 0.38)  # bottom, height of two
        upper = figure.add_axes((0.11, parts[2], 0.86, parts[3]))
        lower = figure.add_axes((0.11, parts[0], 0.86, parts[1]), sharex=upper)
        if len(responses) > 1:
            _draw_change(figure.add_axes((0.11, 0.29, 0.86, 0.18), sharex=upper), responses[0], responses[-1])
        for k, response in enumerate(responses):
            _draw_response(upper, lower, response, k)
        readable_log(upper.yaxis, (1.0, 2.0, 5.0))
        readable_log(upper.xaxis, (1.0, 2.0, 3.0, 4.0, 5.0, 7.0))
        upper.set(ylabel="amplitude per force (µm/N)")
        upper.tick_params(labelbottom=False)
        upper.legend(loc="best")
        lower.set(xlabel="frequency of the force (Hz)", ylabel="phase lag (°)", yticks=[0, 45, 90, 135, 180])
        png = style.save_figure(figure, path)
    counts = [len(r.frequency) for r in responses]
    columns = {"cycles": np.repeat([r.cycles for r in responses], counts),
               "excitation_N": np.repeat([r.excitation for r in responses], counts),
               "frequency_Hz": np.concatenate([r.frequency for r in responses]),
               "amplitude_m": np.concatenate([r.amplitude for r in responses]),
               "phase_rad": np.concatenate([r.phase for r in responses])}
    return [png, write_csv(path.with_suffix(".csv"), columns)]


def _draw_response(upper: Axes, lower: Axes, response: ForcedResponse, index: int) -> None:
    colour, line = style.curve_look(index)
    receptance = response.amplitude * UM / response.excitation
    top = float(receptance.max())
    upper.loglog(response.frequency, receptance, color=colour, linestyle=line,
                 label=f"{style.when_words(response.cycles)}: {response.resonance:.4g} Hz, "
                       f"{style.figures(top)} µm/N")
    upper.plot(response.resonance, top, marker="o", markersize=10, color=colour)
    lower.plot(response.frequency, np.degrees(response.phase), color=colour, linestyle=line)


def _draw_change(axes: Axes, first: ForcedResponse, last: ForcedResponse) -> None:
    """Draw the later response minus the earlier one, at the frequencies that both were computed at."""
    f, old, new = np.intersect1d(first.frequency, last.frequency, return_indices=True)
    change = last.amplitude[new] / last.excitation - first.amplitude[old] / first.excitation
    axes.axhline(0.0, color=style.EDGE_COLOUR, linewidth=1.0)
    axes.plot(f, change * UM, color=style.PURPLE, marker="." if len(f) < 100 else "")
    axes.set(ylabel="worn − unworn\n(µm/N)")
    axes.yaxis.set_label_coords(-0.085, 0.5)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.tick_params(labelbottom=False)


def readable_log(axis: Axis, steps: tuple[float, ...]) -> None:
    """Label a logarithmic axis with plain numbers at `steps` of every decade."""
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: pretty_number(value)))
    axis.set_minor_formatter(NullFormatter())


def plot_wear_volume(path: Path, history: WearHistory) -> list[Path]:
    """Draw worn volume and its rate against cycles; write PNG and CSV.

    The rate is the mean of each jump, drawn over the jump's cycles.
    """
    jumps = np.diff(history.cycles)
    rate = np.diff(history.volume) * MM3 / jumps * 1e6
    unit, factor = _cycle_unit(int(history.cycles[-1]))
    with style.styled():
        figure = style.new_figure("Worn volume", f"both faces together; {len(jumps)} jumps of cycles; "
                                  f"{style.figures(float(history.volume[-1]) * MM3)} mm³ at "
                                  f"{style.counted(int(history.cycles[-1]))} cycles", height=9.2)
        upper = figure.add_axes((0.1, 0.5, 0.87, 0.36))
        lower = figure.add_axes((0.1, 0.09, 0.87, 0.34), sharex=upper)
        mark = "o" if len(jumps) <= 60 else ""
        upper.plot(history.cycles / factor, history.volume * MM3, marker=mark, color=style.BLUE)
        upper.set(ylabel="worn volume\n(mm³)")
        upper.tick_params(labelbottom=False)
        lower.stairs(rate, history.cycles / factor, baseline=None, color=style.VERMILLION, linewidth=2.2)
        lower.set(ylabel="wear rate\n(mm³ per million cycles)", xlabel=f"cycles{unit}")
        for axes in (upper, lower):
            axes.set_ylim(bottom=0.0)
            axes.yaxis.set_label_coords(-0.07, 0.5)
        end = history.cycles[-1] / factor
        lower.set_xlim(-0.02 * end, 1.03 * end)
        png = style.save_figure(figure, path)
    columns = {"cycles": history.cycles, "worn_volume_m3": history.volume,
               "deepest_m": history.depth.max(axis=1),
               "dissipated_energy_J_per_cycle": history.dissipated_energy,
               "sliding_distance_m": history.sliding_distance}
    return [png, write_csv(path.with_suffix(".csv"), columns)]


def _cycle_unit(largest: int) -> tuple[str, float]:
    """Return the words and the divisor that keep the numbers on a cycle axis short."""
    for words, factor in ((" (millions)", 1e6), (" (thousands)", 1e3)):
        if largest >= factor:
            return words, factor
    return "", 1.0


def plot_modes(path: Path, upper: ReducedSpecimen, lower: ReducedSpecimen, rig: RigModes | None = None) -> list[Path]:
    """Draw each specimen's natural frequencies, full model against Craig-Bampton; write PNG and CSV.

    The modes of the `rig` are ``rig_modes`` beside `path`.
    """
    sides = {"upper": upper, "lower": lower}
    with style.styled():
        figure = style.new_figure("Natural frequencies of the specimens",
                                  "clamped at the back, contact face free; full finite-element model against "
                                  "Craig-Bampton", height=9.2)
        for k, (side, specimen) in enumerate(sides.items()):
            left = 0.08 + 0.485 * k
            top = figure.add_axes((left, 0.43, 0.42, 0.39))
            _frequency_bars(top, specimen)
            top.set_title(f"{side.capitalize()} specimen: {style.counted(specimen.full_dofs)} DOF reduced to "
                          f"{style.counted(len(specimen.stiffness))}", fontsize=15)
            _error_bars(figure.add_axes((left, 0.09, 0.42, 0.28), sharex=top), specimen)
        png = style.save_figure(figure, path)
    counts = [len(s.full_frequencies) for s in sides.values()]
    columns = {"specimen": np.repeat(list(sides), counts),
               "mode": np.concatenate([np.arange(1, count + 1) for count in counts]),
               "full_Hz": np.concatenate([s.full_frequencies for s in sides.values()]),
               "craig_bampton_Hz": np.concatenate([s.reduced_frequencies for s in sides.values()]),
               "error_percent": np.concatenate([100.0 * s.frequency_error for s in sides.values()])}
    files = [png, write_csv(path.with_suffix(".csv"), columns)]
    return files if rig is None else [*files, plot_rig_modes(path.with_name("rig_modes.png"), rig)]


def _frequency_bars(axes: Axes, specimen: ReducedSpecimen) -> None:
    mode = np.arange(1, len(specimen.full_frequencies) + 1)
    axes.bar(mode - 0.2, specimen.full_frequencies / 1e3, 0.4, color=style.BLUE, label="full model")
    axes.bar(mode + 0.2, specimen.reduced_frequencies / 1e3, 0.4, color=style.ORANGE, label="Craig-Bampton")
    axes.set(ylabel="frequency (kHz)")
    axes.set_ylim(top=1.25 * float(specimen.full_frequencies.max()) / 1e3)
    axes.legend(loc="upper left", ncols=2)
    axes.tick_params(labelbottom=False)
    axes.grid(False, axis="x")


def _error_bars(axes: Axes, specimen: ReducedSpecimen) -> None:
    """Draw the error of each mode on a logarithmic scale beside the limit that it is held to."""
    mode = np.arange(1, len(specimen.full_frequencies) + 1)
    error = np.maximum(100.0 * specimen.frequency_error, 1e-12)
    floor = 10.0 ** np.floor(np.log10(error.min()) - 0.3)
    axes.bar(mode, error - floor, 0.5, bottom=floor, color=style.GREEN)
    axes.axhline(100.0 * FREQUENCY_LIMIT, color=style.VERMILLION, linestyle="--",
                 label=f"limit {100.0 * FREQUENCY_LIMIT:g} %")
    axes.set(yscale="log", xlabel="mode", ylabel="error (%)")
    axes.set_ylim(floor, max(100.0 * FREQUENCY_LIMIT, float(error.max())) ** 1.4 * floor ** -0.4)  # room for the legend
    axes.xaxis.set_major_locator(MaxNLocator(21, integer=True, steps=[1, 2, 5, 10]))
    axes.margins(x=0.02)
    axes.legend(loc="upper left")
    axes.grid(False, axis="x")
