"""The calibrate command: runs what is needed, shows what the data determine, writes calibrated cases."""

from __future__ import annotations

from json import loads
from pathlib import Path
from typing import TYPE_CHECKING

from fretflow.cli.terminal import Json, Out, Progress, Terminal, keep_json, load, new_table, show_files

if TYPE_CHECKING:
    from fretflow.structure.two_mass_rig.identification import Identification
    from fretflow.wear.identification import WearCoefficient


def calibrate(case: Path, /, *cases: Path, out: Out = Path("runs"), json: Json = None) -> None:
    """Identify the rig and the wear coefficient from what the cases' [measured] tables hold.

    Masses, springs (by the two modes) and damping follow from in_phase_frequency, out_of_phase_frequency and the
    sliding_distance of every case given, the wear coefficient from worn_volume; each with a 95 % interval and whether
    the data determine it. Standard deviations that are not given are assumed: 5 % of a distance or a volume, 1 % of a
    mode. Cases that are calibrated together are of one joint. Writes OUT/NAME-calibrated.toml for each case,
    OUT/calibration.json, and the posterior as OUT/calibration.png and, for ArviZ, calibration.nc.

    Parameters
    ----------
    case
        case file with a [measured] table; more may follow
    cases
        the same joint at other loads
    """
    from fretflow.pipeline.calibrate import calibrate_cases
    from fretflow.pipeline.run import check_names, leading

    parsed = [load(path) for path in (case, *cases)]
    check_names(parsed)
    progress = Progress()
    with leading(out, progress) as runner, progress:
        files = calibrate_cases(parsed, runner, out, _show_rig, _show_wear)
    files += keep_json(json, loads(files[-1].read_text(encoding="utf-8")))
    show_files(files, "calibrated cases, for `fretflow run`")


def _show_rig(identification: Identification) -> None:
    """Print the parameters with their intervals, the fit, and what the data determine together."""
    from fretflow.core.units import pretty_quantity
    from fretflow.pipeline.calibrate import UNITS, parameter_rows

    console = Terminal()
    view = new_table("rig", "parameter", "case", "calibrated", "95 % interval", "by these data")
    for row in parameter_rows(identification):
        view.add_row(row["name"], row["before"], row["after"], f"{row['low']} to {row['high']}",
                     "determined" if row["determined"] else "not determined")
    console.print(view)
    view = new_table("fit", "measured", "value", "model", "off by, standard deviations")
    data = identification.data
    for name, value, predicted, off in zip(data.names, data.value, identification.predicted, identification.deviation,
                                           strict=True):
        unit = "Hz" if name in UNITS else "m"
        view.add_row(name, pretty_quantity(value, unit, 4), pretty_quantity(predicted, unit, 4), f"{off:+.2f}")
    console.print(view)
    view = new_table("what the data determine together", "product of powers", "95 % interval, times", "gain over prior")
    products = zip(*identification.product_interval, identification.strength, strict=True)
    for index, (low, high, strength) in enumerate(products):
        view.add_row(identification.product(index), f"{low:.3g} to {high:.3g}", f"{(1.0 + strength**2) ** 0.5:.2g}")
    console.print(view)


def _show_wear(name: str, coefficient: WearCoefficient) -> None:
    """Print K_w and what simpler readings of the same volume would give."""
    low, high = coefficient.interval
    view = new_table(f"wear coefficient, {name}", "", "m²/N")
    view.add_row("by the wear history", f"{coefficient.value:.4g}, 95 % {low:.4g} to {high:.4g} by the volume's error")
    view.add_row("if volume were proportional", f"{coefficient.proportional:.4g}")
    view.add_row("by the unworn contact's rate", f"{coefficient.unworn:.4g}")
    Terminal().print(view)
