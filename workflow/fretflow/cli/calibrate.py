"""`fretflow calibrate`: runs what is needed, shows what the data determine, writes calibrated cases."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fretflow.case.casefile import dump_case
from fretflow.case.config import Case
from fretflow.cli.report import Terminal, new_table, show_files
from fretflow.core.errors import InputError
from fretflow.core.store import write_whole
from fretflow.core.units import format_quantity
from fretflow.pipeline.calibrate import calibrate_rig, calibrate_wear, calibrated_case
from fretflow.pipeline.runner import Runner
from fretflow.structure.two_mass_rig.identification import Identification
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.identification import WearCoefficient

UNITS = {"moving_mass": "kg", "arm_mass": "kg", "in_phase_frequency": "Hz", "out_of_phase_frequency": "Hz",
         "damping_ratio": ""}


def calibrate_cases(cases: Sequence[Case], runner: Runner, out: Path) -> None:
    """Identify what the cases' [measured] tables allow, show it and write calibrated cases and a JSON file.

    Raises
    ------
    InputError
        If nothing was measured that could be calibrated on.
    """
    if not any(case.measured.sliding_distance or case.measured.worn_volume for case in cases):
        raise InputError("[measured]: no case has a sliding_distance or a worn_volume to calibrate on")
    rig = None
    if any(case.measured.sliding_distance for case in cases):
        reduced = {case.name: runner.run(case, "reduce")["reduce"].folder for case in cases}
        rig = calibrate_rig(cases, reduced)
        show_rig(rig)
    coefficients: dict[str, WearCoefficient] = {}
    for case in cases:
        if case.measured.worn_volume:
            coefficients[case.name] = calibrate_wear(
                calibrated_case(case, rig, None),
                lambda one: {name: result.folder for name, result in runner.run(one, "wear").items()})
            show_wear(case, coefficients[case.name])
    shared = _mean(list(coefficients.values()))
    files = [_write(out, calibrated_case(case, rig, shared), _remarks(rig, coefficients)) for case in cases]
    content = json.dumps(_plain(rig, coefficients), indent=2)
    write_whole(out / "calibration.json", f"{content}\n".encode())
    show_files([*files, out / "calibration.json"], "calibrated cases, for `fretflow run`")


def show_rig(found: Identification) -> None:
    """Print the parameters with their intervals, the fit, and what the data determine together."""
    console = Terminal()
    view = new_table("rig", "parameter", "case", "calibrated", "95 % interval", "by these data")
    for row in _parameters(found):
        view.add_row(row["name"], row["before"], row["after"], f"{row['low']} to {row['high']}",
                     "determined" if row["determined"] else "not determined")
    console.print(view)
    view = new_table("fit", "measured", "value", "model", "off by, standard deviations")
    for name, value, predicted, off in zip(found.data.names, found.data.value, found.predicted, found.deviation,
                                           strict=True):
        unit = "Hz" if name in UNITS else "m"
        view.add_row(name, format_quantity(value, unit, 4), format_quantity(predicted, unit, 4), f"{off:+.2f}")
    console.print(view)
    view = new_table("what the data determine together", "product of powers", "known to", "gain over prior")
    for index, (sd, strength) in enumerate(zip(found.direction_sd, found.strength, strict=True)):
        view.add_row(found.product(index), f"+-{sd:.1%}", f"{(1.0 + strength**2) ** 0.5:.2g}")
    console.print(view)


def show_wear(case: Case, found: WearCoefficient) -> None:
    """Print K_w and what simpler readings of the same volume would give."""
    low, high = found.interval
    view = new_table(f"wear coefficient, {case.name}", "", "m^2/N")
    view.add_row("by the wear history", f"{found.value:.4g}, 95 % {low:.4g} to {high:.4g} by the volume's error")
    view.add_row("if volume were proportional", f"{found.proportional:.4g}")
    view.add_row("by the unworn contact's rate", f"{found.unworn:.4g}")
    Terminal().print(view)


def _parameters(found: Identification) -> list[dict[str, Any]]:
    low, high = found.interval
    return [{"name": name, "before": format_quantity(before, unit, 4), "after": format_quantity(after, unit, 4),
             "low": format_quantity(a, unit, 3), "high": format_quantity(b, unit, 3), "determined": bool(known)}
            for (name, unit), before, after, a, b, known in zip(
                UNITS.items(), found.prior.value, found.value, low, high, found.determined, strict=True)]


def _mean(found: Sequence[WearCoefficient]) -> float | None:
    """Return the mean coefficient, each by the inverse of its variance."""
    if not found:
        return None
    weights = [1.0 / one.sd**2 for one in found]
    return sum(w * one.value for w, one in zip(weights, found, strict=True)) / sum(weights)


def _remarks(rig: Identification | None, coefficients: Mapping[str, WearCoefficient]) -> list[str]:
    lines = ["# Calibrated on measured values; intervals are of 95 %."]
    if rig is not None:
        lines += [f"# rig.{row['name']}: {row['low']} to {row['high']}, "
                  + ("determined" if row["determined"] else "not determined by these data")
                  for row in _parameters(rig)]
    for name, one in coefficients.items():
        low, high = one.interval
        lines.append(f"# wear.coefficient by {name}: {low:.4g} to {high:.4g} m^2/N")
    return lines


def _write(out: Path, case: Case, remarks: Sequence[str]) -> Path:
    path = out / f"{case.name}.toml"
    write_whole(path, ("\n".join(remarks) + "\n\n" + dump_case(case)).encode())
    return path


def _plain(rig: Identification | None, coefficients: Mapping[str, WearCoefficient]) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "wear_coefficient_m2_per_N": {name: {"value": one.value, "low": one.interval[0], "high": one.interval[1]}
                                      for name, one in coefficients.items()}}
    if rig is None:
        return plain
    low, high = rig.interval
    springs = LumpedRig.from_modes(*map(float, rig.value))
    plain["rig"] = {
        name: {"value": value, "low": a, "high": b, "unit": UNITS[name] or "1", "determined": bool(known)}
        for name, value, a, b, known in zip(rig.prior.names, map(float, rig.value), map(float, low), map(float, high),
                                            rig.determined, strict=True)}
    plain["springs_N_per_m"] = {"ground": springs.ground_stiffness, "hinge": springs.hinge_stiffness}
    plain["fit"] = {name: {"measured": value, "model": predicted, "standard_deviations_off": off}
                    for name, value, predicted, off in zip(rig.data.names, map(float, rig.data.value),
                                                           map(float, rig.predicted), map(float, rig.deviation),
                                                           strict=True)}
    plain["determined_products"] = [{"product": rig.product(k), "relative_sd": float(rig.direction_sd[k]),
                                     "gain": float((1.0 + rig.strength[k]**2) ** 0.5)}
                                    for k in range(len(rig.strength))]
    return plain
