"""The figures that a run ends with, read from its result files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.case.config import Case
from fretflow.case.plausibility import warnings
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.core.units import pretty_quantity
from fretflow.pipeline.response_curves import kept_peaks
from fretflow.pipeline.run_records import SIDES, LoopSeries, RunRecords, stated_error
from fretflow.pipeline.stage import SUMMARY_FILE, case_sum, write_json
from fretflow.pipeline.trends import Trend, is_papers, judge_all
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen, reduction_warnings
from fretflow.wear.history import WearHistory

SAME = 1e-6  # of the face's width: coordinates so close are one


@dataclass(frozen=True)
class Figure:
    """One line of the summary: what it is, its SI value for further use, and the text for people."""

    name: str
    value: float
    unit: str
    text: str


def summarise(case: Case, folders: Mapping[str, Path]) -> tuple[list[Figure], Sequence[Trend]]:
    """Return the figures of the stages in `folders`, and the paper's trends of its own tests once wear is known."""
    run = RunRecords(folders)
    meshes = [_meshes(run)] if (folders.get("mesh", Path()) / "upper.h5").is_file() else []
    if not run.has("reduce"):
        return meshes, []
    peaks = [Figure(f"nonlinear resonance, {name}", frequency, "Hz", text)
             for name, frequency, text in kept_peaks(folders)]
    figures = [*meshes, _reduction(*run.reduced), *peaks]
    if run.has("preload"):
        figures.append(_static_load(run.static_pressure, run.areas))
    if not run.has("solve"):
        return figures, []
    figures += _period(run.unworn, run.interface)
    if not run.has("wear"):
        return figures, []
    ridge = min(side.ridge_height for side in (case.specimen.upper, case.specimen.lower))
    figures += _wear(run.history, run.interface, ridge)
    if run.has("response"):
        figures += _loops(run.observed_loops)
    responses = run.responses
    resonances = (responses[0].resonance, responses[1].resonance) if len(responses) == len(SIDES) else None
    if resonances is not None:
        shift = resonances[1] / resonances[0] - 1.0
        checked = f"; {stated}" if (stated := stated_error(responses)) else ""
        figures.append(Figure("first resonance, worn against unworn", shift, "1",
                              f"{100.0 * shift:+.3f} % ({resonances[0]:.5g} to {resonances[1]:.5g} Hz){checked}"))
    if not is_papers(case):
        return figures, []
    return figures, judge_all(case.test, run.interface, run.unworn, run.history, resonances)


def result_warnings(case: Case, folders: Mapping[str, Path]) -> list[str]:
    """Return what makes results doubtful: a reduction beyond its limit, a contact too narrow for its nodes."""
    run = RunRecords(folders)
    if not run.has("reduce"):
        return []
    texts = reduction_warnings(dict(zip(SIDES, run.reduced, strict=True)))
    return texts + _narrow(case, run.nodes, run.static_pressure > 0.0) if run.has("preload") else texts


def _narrow(case: Case, nodes: NDArray[np.float64], closed: NDArray[np.bool_]) -> list[str]:
    """Return a warning where the nodes (n, 2), m, that touch lie in one line, across which nothing is resolved."""
    touching, wide = nodes[closed], float(np.ptp(nodes, axis=0).max())
    axes = [axis for axis, span in zip("xy", np.ptp(touching, axis=0), strict=True) if span < SAME * wide]
    remedy = "mesh the contact more finely" if case.mesh.upper else (
        f"raise mesh.contact_elements (now {case.mesh.contact_elements})")
    return [f"the load is carried by one row of nodes ({len(touching)} of {len(nodes)}), one node wide along "
            f"{' and '.join(axes)}: its width is not resolved; {remedy}, or raise specimen.face_radius"] if axes else []


def write_summary(home: Path, case: Case, folders: Mapping[str, Path]) -> Path:
    """Write figures and trends of `case` to the run's folder `home`; a figure that cannot be told is null."""
    path = home / SUMMARY_FILE
    figures, trends = summarise(case, folders)
    values = [{"value": figure.value if np.isfinite(figure.value) else None} for figure in figures]
    write_json(path, {"case_sum": case_sum(case), "warnings": [*warnings(case), *result_warnings(case, folders)],
                      "figures": [asdict(figure) | value for figure, value in zip(figures, values, strict=True)],
                      "trends": [asdict(trend) for trend in trends]})
    return path


def _reduction(upper: ReducedSpecimen, lower: ReducedSpecimen) -> Figure:
    error = float(max(upper.frequency_error.max(), lower.frequency_error.max()))
    return Figure("Craig-Bampton error", error, "1",
                  f"{100.0 * error:.4f} %, the largest of {len(upper.full_frequencies)} frequencies of each specimen")


def _meshes(run: RunRecords) -> Figure:
    upper, lower = run.meshes
    worst = min(upper.min_scaled_jacobian, lower.min_scaled_jacobian)
    return Figure("mesh quality", worst, "1", f"{worst:.3g}, the smallest scaled Jacobian of {upper.cells} upper and "
                  f"{lower.cells} lower cells; {len(upper.contact_nodes)} contact nodes on each face")


def _static_load(pressure: NDArray[np.float64], areas: NDArray[np.float64]) -> Figure:
    load, closed = float(pressure @ areas), float(areas[pressure > 0.0].sum())
    return Figure("static load", load, "N",
                  f"{pretty_quantity(load, 'N', 8)}, the sum of the contact pressure; largest "
                  f"{pretty_quantity(pressure.max(), 'Pa', 4)}, mean {pretty_quantity(load / closed, 'Pa', 4)} "
                  f"over {closed * 1e6:.3g} mm² in contact")


def _loops(series: LoopSeries) -> list[Figure]:
    """Return what the first and the last loop show, at the observed points."""
    figures = []
    for name, unit in (("friction_coefficient", "1"), ("tangential_stiffness", "N/m")):
        first, last = (float(getattr(series, name)[k]) for k in (0, -1))
        shown = f"{_readable(first, unit)} unworn, {_readable(last, unit)} worn"
        figures.append(Figure(f"{name.replace('_', ' ')} from the loop", last, unit,
                              "not shown by the loops" if np.isnan([first, last]).all() else shown))
    return figures


def _readable(value: float, unit: str) -> str:
    return "not shown" if np.isnan(value) else pretty_quantity(value, unit, 4).removesuffix(" 1")


def _period(unworn: PeriodicSolution, interface: Interface) -> list[Figure]:
    sticking = np.all(unworn.state == ContactState.STICK, axis=0)
    always = float(interface.areas[sticking].sum() / interface.areas.sum())
    share = float(((unworn.state == ContactState.STICK) @ interface.areas).mean() / interface.areas.sum())
    sliding, error = float(np.ptp(interface.mean(unworn.displacement[:, :, 0]))), unworn.error_estimate
    stated = "no error estimate" if np.isnan(error) else f"estimated error {100.0 * error:.2f} %"
    return [
        Figure("stick share", share, "1",
               f"{100.0 * share:.1f} % of area and time sticks; {100.0 * always:.1f} % of the area never slips"),
        Figure("sliding distance, unworn", sliding, "m",
               f"{pretty_quantity(sliding, 'm', 4)} peak to peak by {unworn.method}, {stated}")]


def _wear(history: WearHistory, interface: Interface, ridge: float) -> list[Figure]:
    depth, sliding, volume = history.depth[-1], float(history.sliding_distance[-1]), float(history.volume[-1])
    mean = float(interface.mean(depth))
    largest = float(depth.max())
    end = "" if history.stopped_by == "cycles" else f", stopped by {history.stopped_by}"
    jumps = len(history.cycles) - 1
    beyond = "" if largest < ridge else (f"; more than the ridge of {pretty_quantity(ridge, 'm', 4)}, beyond what is "
                                         "modelled: check wear.coefficient and test.cycles")
    return [
        Figure("sliding distance, worn", sliding, "m",
               f"{pretty_quantity(sliding, 'm', 4)} peak to peak after {history.cycles[-1]:,} cycles{end}"),
        Figure("wear volume", volume, "m^3",
               f"{volume * 1e9:.4g} mm³; {jumps} jumps, {history.solves} periods"),
        Figure("largest wear depth", largest, "m", f"{pretty_quantity(largest, 'm', 4)}, both faces together{beyond}"),
        Figure("mean wear depth", mean, "m", f"{pretty_quantity(mean, 'm', 4)}, both faces together")]
