"""A run as a recording: its loops and what wore off, as files that `fretflow loops` and `diagnose` read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fretflow.case.casefile import entries
from fretflow.case.config import Case, Mesh
from fretflow.core.errors import InputError
from fretflow.core.store import write_csv, write_whole
from fretflow.core.units import exact_quantity
from fretflow.pipeline.run_records import RunRecords
from fretflow.recordings.schema import FILE
from fretflow.structure.sensors import Signals

REPEATS = 3  # drawn where there is noise: the fewest whose scatter has a scatter of its own
SEED = 20320  # of the noise, so that a run exported twice is the same recording
CHANNELS = {"excitation": ("excitation_N", "N"), "displacement": ("displacement_um", "um"),
            "friction_force": ("friction_force_N", "N")}


def export_recording(case: Case, run: RunRecords, channels: Mapping[int, Signals], folder: Path, noise: float = 0.0
                     ) -> list[Path]:
    """Write a run's loops, and where there is wear the worn volume and depth, as a recording of its rig.

    Parameters
    ----------
    case : Case
        What was run.
    run : RunRecords
        Its complete stages.
    channels : mapping of int to Signals
        Of its periods by cycle count, before any sensor, as ``RunResults.channels`` has them.
    folder : Path
        Of the recording, which holds none yet.
    noise : float
        Standard deviation of white noise on displacement and force, as a share of half their range; with it, each
        loop is drawn three times, so that it can be told from the physics.

    Returns
    -------
    list of Path
        ``recording.toml`` and the tables that it names.

    Raises
    ------
    InputError
        If the folder holds a recording, the noise is no share, or the specimens are observed in two distances.
    """
    upper, lower = case.specimen.upper, case.specimen.lower
    if (folder / FILE).exists():
        raise InputError(f"{folder / FILE}: exists and is left as it is; name another folder")
    if not 0.0 <= noise < 1.0:
        raise InputError(f"noise: must be a share from 0 to below 1, got {noise}")
    if upper.observation_distance != lower.observation_distance:
        raise InputError("specimen.observation_distance: differs between upper and lower, and a recording has one; run "
                         "the case with one")
    folder.mkdir(parents=True, exist_ok=True)
    source = f"run of {case.name}, exported; {stiffness_told(case.mesh)}"
    lines = ['format = "fretflow-recording/1"', f"title = {json.dumps(case.title or case.name)}",
             f"source = {json.dumps(source)}", "", "[test]", 'kind = "fretting-rig"',
             *(f"{one.key} = {one.toml}" for one in entries(case.test) if one.value is not None)]
    for name, table in (("rig", case.rig), ("specimen.upper", upper), ("specimen.lower", lower)):
        lines += ["", f"[{name}]", *(f"{one.key} = {one.toml}" for one in entries(table) if one.value is not None)]
    lines += ["", "[loops]", 'file = "loops.csv"',
              f'displacement_of = "{exact_quantity(upper.observation_distance, "m")}"',
              *(f'{name} = {{ column = "{heading}", unit = "{unit}" }}' for name, (heading, unit) in CHANNELS.items()),
              'time = { column = "time_s", unit = "s" }', *(f'{name} = {{ column = "{name}" }}'
                                                            for name in ("cycle", "repeat"))]
    files = [write_csv(folder / "loops.csv", _loops(channels, noise))]
    if run.has("wear"):
        lines += ["", "[wear]", f'worn_volume = "{exact_quantity(run.history.volume[-1], "m^3")}"', "", "[wear_depth]",
                  'file = "wear_depth.csv"', *(f'{name} = {{ column = "{name}_um", unit = "um" }}'
                                               for name in ("x", "y", "depth"))]
        places = {"x_um": run.nodes[:, 0], "y_um": run.nodes[:, 1], "depth_um": run.history.depth[-1]}
        files.append(write_csv(folder / "wear_depth.csv", {name: 1e6 * values for name, values in places.items()}))
    write_whole(folder / FILE, ("\n".join(lines) + "\n").encode())
    return [folder / FILE, *files]


def stiffness_told(mesh: Mesh) -> str:
    """Return what meshes add to the specimens' stiffness: a diagnosis allows for what they leave out."""
    side = f"{mesh.contact_elements} by {mesh.contact_elements}"
    own = mesh.upper is not None or mesh.lower is not None
    of = "that mesh makes them" if own else f"{side} elements of degree {mesh.degree} make them"
    return f"specimens are as stiff as {of}, which a diagnosis tells as a Young's modulus above the case's"


def _loops(channels: Mapping[int, Signals], noise: float) -> dict[str, Any]:
    """Return the columns of all periods, one after the other."""
    rng, parts = np.random.default_rng(SEED), []
    for cycles, seen in channels.items():
        x, force = seen.displacement, seen.friction_force
        for repeat in range(REPEATS if noise else 1):
            x_noise, force_noise = (0.5 * noise * np.ptp(one) * rng.standard_normal(len(one)) for one in (x, force))
            parts.append(np.column_stack([
                np.full(len(x), cycles), np.full(len(x), repeat), seen.step * np.arange(len(x)),
                np.asarray(seen.excitation), 1e6 * (x + x_noise), force + force_noise]))
    rows = np.concatenate(parts)
    names = ("cycle", "repeat", "time_s", *(heading for heading, _ in CHANNELS.values()))
    return {name: rows[:, k].astype(int) if k < 2 else rows[:, k] for k, name in enumerate(names)}
