"""The modes command: natural frequencies of the specimens, full model against reduced."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fretflow.cli.terminal import (
    Force,
    Json,
    Out,
    Progress,
    Terminal,
    keep_json,
    load,
    new_table,
    show_files,
    show_warnings,
)

if TYPE_CHECKING:
    from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen


def modes(case: Path, /, *, out: Out = Path("runs"), force: Force = False, json: Json = None) -> None:
    """List each specimen's natural frequencies: full model against Craig-Bampton; with a CSV and a plot.

    Parameters
    ----------
    case
        case file
    """
    from fretflow.core.plugins import FIGURES, provided
    from fretflow.core.store import read_record
    from fretflow.pipeline.run import leading
    from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen

    parsed = load(case)
    progress = Progress()
    with leading(out, progress) as runner, progress:
        folder = runner.run(parsed, "reduce", force)["reduce"].folder
    specimens = {side: read_record(folder / f"{side}.h5", ReducedSpecimen) for side in ("upper", "lower")}
    _show(specimens)
    kept = keep_json(json, {side: {"full_Hz": one.full_frequencies, "reduced_Hz": one.reduced_frequencies,
                                   "error": one.frequency_error} for side, one in specimens.items()})
    show_files([*provided(FIGURES, "modes")(out / parsed.name / "modes.png", *specimens.values()), *kept], "files")


def _show(specimens: Mapping[str, ReducedSpecimen]) -> None:
    """Print the natural frequencies of each specimen, full model against reduced."""
    from fretflow.structure.reduction.reduced_specimen import reduction_warnings

    console = Terminal()
    for side, specimen in specimens.items():
        view = new_table(f"{side} specimen, back face clamped: {specimen.full_dofs:,} DOF against "
                         f"{len(specimen.stiffness)}", "mode", "full model, Hz", "Craig-Bampton, Hz", "error")
        rows = zip(
            specimen.full_frequencies, specimen.reduced_frequencies, specimen.frequency_error, strict=True
        )
        for number, (full, reduced, error) in enumerate(rows, start=1):
            view.add_row(str(number), f"{full:.2f}", f"{reduced:.2f}", f"{error:.5%}")
        console.print(view)
    show_warnings(reduction_warnings(specimens))
