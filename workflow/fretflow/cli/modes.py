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
    from fretflow.structure.two_mass_rig.lumped import RigModes


def modes(case: Path, /, *, out: Out = Path("runs"), force: Force = False, json: Json = None) -> None:
    """List the natural modes of specimens and rig; with a CSV and pictures of the shapes.

    Of each specimen, clamped at the back, the full model against Craig-Bampton; of the rig, faces apart and stuck.

    Parameters
    ----------
    case
        case file
    """
    from fretflow.case.config import Output
    from fretflow.core.plugins import FIGURES, formats_asked, provided
    from fretflow.pipeline.problem import make_model
    from fretflow.pipeline.run import leading
    from fretflow.pipeline.run_records import RunRecords
    from fretflow.structure.two_mass_rig.lumped import RigModes

    parsed = load(case)
    progress = Progress()
    with leading(out, progress) as runner, progress:
        folders = {name: done.folder for name, done in runner.run(parsed, "reduce", force).items()}
    specimens = dict(zip(("upper", "lower"), RunRecords(folders).reduced, strict=True))
    _show(specimens)
    model = make_model(parsed, folders["reduce"])
    rig = RigModes.of(model.problem(model.initial()).boundary)
    _show_rig(rig)
    kept = keep_json(json, {side: {"full_Hz": one.full_frequencies, "reduced_Hz": one.reduced_frequencies,
                                   "error": one.frequency_error} for side, one in specimens.items()} | {"rig": rig})
    home = out / parsed.name
    files = provided(FIGURES, "modes")(home / "modes.png", *specimens.values(), rig)  # which checks the formats
    asked = Output.model_validate({"figures": ["mode_shapes"], "figure_formats": list(formats_asked())})
    show_files([*files, *provided(FIGURES, "run")(folders, home, asked), *kept], "files")


def _show_rig(rig: RigModes) -> None:
    """Print the modes of block and arm."""
    view = new_table("rig, block and arm along x, undamped", "faces", "mode", "frequency, Hz", "block", "arm")
    for faces, frequencies, shapes in (("apart", rig.apart_frequency, rig.apart_shape),
                                       ("stuck", rig.stuck_frequency, rig.stuck_shape)):
        for number, (frequency, shape) in enumerate(zip(frequencies, shapes, strict=True), 1):
            view.add_row(faces, str(number), f"{frequency:,.2f}", *(f"{one:+.3f}" for one in shape[:2]))
    Terminal().print(view)


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
            view.add_row(str(number), f"{full:,.2f}", f"{reduced:,.2f}", f"{100.0 * error:.5f} %")
        console.print(view)
    show_warnings(reduction_warnings(specimens))
