"""The loops command: what is read off a recording, as a table, a picture, CSV and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fretflow.cli.report import Terminal, new_table, show_files
from fretflow.core.errors import ConfigError, InputError, UnreliableRecordingError
from fretflow.core.plugins import FIGURES, provided
from fretflow.core.store import write_csv, write_whole
from fretflow.core.units import parse_quantity, readable_unit
from fretflow.recordings.bare import Wanted, read_bare
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.notes import Note
from fretflow.recordings.plausibility import check_friction
from fretflow.recordings.readings import LoopReading, RecordedReadings, read_recorded_loops, without_friction
from fretflow.recordings.recording import Recording, read_joint_recording
from fretflow.recordings.repeatability import repeatability
from fretflow.recordings.schema import FILE, name_of
from fretflow.recordings.series import loops_of_series

Array = NDArray[np.float64]

QUANTITIES = {
    "friction_coefficient": "1", "friction_limit": "N", "tangential_stiffness": "N/m", "dissipated_energy": "J",
    "sliding_distance": "m", "peak_to_peak": "m",
}
HEADINGS = ("friction coefficient", "friction limit", "tangential stiffness", "energy per cycle", "sliding distance",
            "peak to peak")
MOST_ROWS = 40
WIDE = 104  # characters of a terminal in which a value and its deviation stand side by side


@dataclass(frozen=True)
class Read:
    """A set of loops and what was read off them."""

    name: str
    index: str  # what tells the loops apart
    loops: LoopSet
    readings: RecordedReadings


def show_loops(path: Path, options: Mapping[str, str | None], normal_load: str | None, frequency: str | None, out: Path,
               json_file: Path | None) -> list[Path]:
    """Read the loops of a recording, print what they show and return the files that were written.

    Parameters
    ----------
    path : Path
        Folder of a recording, its ``recording.toml``, or a single file of loops.
    options : mapping
        For a single file, ``"COLUMN [UNIT]"`` by channel; None where it is to be found by itself.
    normal_load, frequency : str or None
        With their units; refused where the recording says something else.
    out : Path
        Folder of the results.
    json_file : Path or None
        File for all numbers.

    Raises
    ------
    RecordingError
        If the recording cannot be used.
    ConfigError
        If an option or ``recording.toml`` is in error.
    """
    recording, load = _recording(path, options, normal_load, frequency)
    sets, notes = _read(recording, load)
    console = Terminal(highlight=False)
    console.print(escape(recording.title))
    for found in sets:
        console.print(_lumped_table(found) if not recording.kind.friction_alone else _table(
            found, "" if console.width >= WIDE else "\n"))
    _print_notes(console, notes)
    home = out / f"{name_of(path)}-loops"
    home.mkdir(parents=True, exist_ok=True)
    files = []
    for found in sets:
        files.append(write_csv(home / f"{found.name}_readings.csv", _columns(found)))
        files += provided(FIGURES, "loops")(home / f"{found.name}.png", recording.title, found.loops, found.readings,
                                            found.index)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(json_file, json.dumps(_plain(recording, load, sets, notes), indent=1, allow_nan=False).encode())
        files.append(json_file)
    show_files(files, "pictures and numbers")
    return files


def _recording(path: Path, options: Mapping[str, str | None], normal_load: str | None, frequency: str | None) -> tuple[
        Recording, float | None]:
    """Return the recording and its normal load in N, from the file or else from the user."""
    if not path.exists():
        raise InputError(f"{path}: there is no such folder or file; give a folder with a {FILE}, or one file of loops")
    given = {channel: text for channel, text in options.items() if text is not None}
    load = _option("--normal-load", normal_load, "N")
    hertz = _option("--frequency", frequency, "Hz")
    if not path.is_dir() and path.suffix != ".toml":
        return read_bare(path, Wanted(given, hertz)), load
    if given:
        option = next(iter(given)).removeprefix("friction_")
        raise InputError(f"--{option}: columns are named in {FILE} already; leave it out")
    recording = read_joint_recording(path)
    test = recording.test
    for option, mine, stated in (("--normal-load", load, test.normal_load),
                                 ("--frequency", hertz, test.excitation_frequency)):
        if mine is not None and stated is not None and abs(mine / stated - 1.0) > 1e-6:
            raise UnreliableRecordingError(f"{option}: {mine:g} where the recording says {stated:g}; leave the option "
                                           f"out or correct {FILE}")
        if option == "--frequency" and mine is not None and stated is None:
            raise InputError(f"--frequency: give test.excitation_frequency in {FILE}, which tells all else of the test")
    return recording, load if test.normal_load is None else test.normal_load


def _option(name: str, text: str | None, unit: str) -> float | None:
    if text is None:
        return None
    try:
        value = parse_quantity(text, unit)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from error
    if not value > 0.0:
        raise ConfigError(f"{name}: must be positive, got {text}")
    return value


def _read(recording: Recording, load: float | None) -> tuple[list[Read], tuple[Note, ...]]:
    """Return all loops of the recording, read, and its notes."""
    notes = recording.notes
    relative = (recording.test.normal_load_sd or 0.0) / (recording.test.normal_load or 1.0)
    sets = []

    def add(name: str, index: str, loops: LoopSet, loads: Sequence[float | None], consecutive: bool = False) -> None:
        known = np.array([np.nan if value is None else value for value in loads])
        readings = read_recorded_loops(loops, known, relative, consecutive)
        lumped = not recording.kind.friction_alone
        shown = np.flatnonzero(np.isfinite(readings.friction_coefficient.value))
        if shown.size and not lumped:
            k = shown[np.argmax(readings.friction_coefficient.value[shown])]
            check_friction(f"{recording.path}: {name}: friction force of loop {readings.cycles[k]}",
                           float(readings.friction_coefficient.value[k]), float(known[k]))
        sets.append(Read(name, index, loops, without_friction(readings) if lumped else readings))

    if recording.loops is not None:
        add("loops", "cycles", recording.loops, [load] * len(recording.loops.cycles))
    if recording.series is not None:
        loops, found = loops_of_series(recording.series)
        notes += found
        add("series", "cycles", loops, [load] * len(loops.cycles), consecutive=True)
    if recording.sweep is not None:
        add("sweep", "conditions", recording.sweep.loops, [c.normal_load for c in recording.sweep.conditions])
    if not sets:
        raise InputError(f"{recording.path}: has no loops, series or sweep to read")
    if recording.kind.friction_alone and any(np.isnan(s.readings.friction_coefficient.value).all() and
                                                     np.isfinite(s.readings.friction_limit.value).any() for s in sets):
        notes += (Note("test", "the normal load is not known, so the friction limit is given instead of a coefficient; "
                       "--normal-load adds it", "normal_load"),)
    return sets, notes


def _table(found: Read, between: str) -> Table:
    readings = found.readings
    shown = {name: heading for name, heading in zip(QUANTITIES, HEADINGS, strict=True) if np.isfinite(
        getattr(readings, name).value).any()}
    if np.isfinite(readings.stiffness_at_least).any():
        shown = {name: heading for name, heading in zip(QUANTITIES, HEADINGS, strict=True)
                 if name in shown or name == "tangential_stiffness"}
    if "friction_coefficient" in shown:
        shown.pop("friction_limit", None)
    scales = {name: readable_unit(_largest(readings, name), QUANTITIES[name]) for name in shown}
    sources = [_sources(readings, k, shown) for k in range(len(readings.cycles))]
    ends = {"regime": readings.regime, "mostly by": sources}
    same = {heading: cells[0] for heading, cells in ends.items() if len(set(cells)) == 1}
    title = f"{found.name}: {same['regime']}; " if "regime" in same else f"{found.name}: "
    title += "± one standard deviation" + (f", mostly {same['mostly by']}" if "mostly by" in same else "")
    view = new_table(title, found.index, *(
        heading + (f", {scales[name][0]}" if scales[name][0] != "1" else "") for name, heading in shown.items()),
        *(heading for heading in ends if heading not in same))
    rows = range(len(readings.cycles))
    for k in rows if len(rows) <= MOST_ROWS else [*rows[:MOST_ROWS // 2], *rows[-MOST_ROWS // 2:]]:
        view.add_row(f"{readings.cycles[k]:_}", *(_cell(readings, name, k, scales[name][1]).replace("±", f"{between}±")
                                                    for name in shown),
                     *(cells[k] for heading, cells in ends.items() if heading not in same))
    if len(rows) > MOST_ROWS:
        view.caption = f"the first and last of {len(rows)}; the CSV has all"
    return view


def _sources(readings: RecordedReadings, k: int, shown: Mapping[str, str]) -> str:
    """Return what most of the uncertainty of the first reading shown comes from, and of others if it differs."""
    parts = [str(source) for name in shown if (source := getattr(readings, name).dominated_by[k]) is not None]
    return ", ".join(dict.fromkeys(parts)) or "-"


def _largest(readings: RecordedReadings, name: str) -> float:
    values = getattr(readings, name).value
    if name == "tangential_stiffness" and not np.isfinite(values).any():
        values = readings.stiffness_at_least
    return float(np.nanmax(np.abs(values)))


def _cell(readings: RecordedReadings, name: str, k: int, size: float) -> str:
    estimate: LoopReading = getattr(readings, name)
    if name == "tangential_stiffness" and not np.isfinite(estimate.value[k]) and np.isfinite(
            readings.stiffness_at_least[k]):
        return f"> {readings.stiffness_at_least[k] / size:.3g}"
    return with_error(estimate.value[k] / size, estimate.sd[k] / size)


def with_error(value: float, sd: float) -> str:
    """Return ``"0.4003±0.0017"``: the deviation with two figures, the value to the same place."""
    if not np.isfinite(value):
        return "-"
    if not np.isfinite(sd) or sd == 0.0:
        return f"{value:.5g}" + ("" if sd == 0.0 else "±?")
    digits = max(0, 1 - int(np.floor(np.log10(sd))))
    return f"{value:.{min(digits, 9)}f}±{sd:.{min(digits, 9)}f}"


def _lumped_table(found: Read) -> Table:
    """Show what a lumped system's record tells without a model: its force holds inertia, so no friction law."""
    readings = found.readings
    stroke, work = readings.peak_to_peak, readings.dissipated_energy
    mean = work.value / (2.0 * stroke.value)
    parts = [("stroke", stroke.value, stroke.sd, "m"), ("work of the force", work.value, work.sd, "J"),
             ("work / (2 stroke)", mean, mean * np.hypot(work.sd / work.value, stroke.sd / stroke.value), "N")]
    scales = [readable_unit(float(np.nanmax(np.abs(value))), unit) for _, value, _, unit in parts]
    view = new_table(f"{found.name}: a lumped system, whose force holds its inertia; what each whole cycle tells",
                     found.index, *(f"{name}, {unit}" for (name, *_), (unit, _) in zip(parts, scales, strict=True)))
    for k, cycle in enumerate(readings.cycles):
        view.add_row(f"{cycle}", *(with_error(value[k] / size, sd[k] / size) for (_, value, sd, _), (_, size) in zip(
            parts, scales, strict=True)))
    return view


def _print_notes(console: Console, notes: Sequence[Note]) -> None:
    if notes:
        console.print("warnings:" if len(notes) > 1 else "warning:")
    for note in notes:
        console.print(f"  {escape(str(note))}", soft_wrap=True)


def _columns(found: Read) -> dict[str, Any]:
    readings = found.readings
    columns: dict[str, Any] = {found.index: readings.cycles, "repeats": found.loops.repeats[found.loops.repeats > 0],
                               "regime": readings.regime}
    for name, unit in QUANTITIES.items():
        estimate: LoopReading = getattr(readings, name)
        tail = "" if unit == "1" else f"_{unit.replace('/', '_per_')}"
        columns[f"{name}{tail}"] = estimate.value
        for part in ("sd", "noise", "repeats", "calibration"):
            columns[f"{name}_{part}{tail}"] = getattr(estimate, part)
    columns["tangential_stiffness_at_least_N_per_m"] = readings.stiffness_at_least
    return columns


def _plain(recording: Recording, load: float | None, sets: Sequence[Read], notes: Sequence[Note]) -> dict[str, Any]:
    """Return everything as JSON takes it; what a loop does not show is null."""
    return {
        "recording": str(recording.path), "title": recording.title, "kind": str(recording.kind),
        "normal_load": None if load is None else {"value": load, "unit": "N"},
        "sets": [{"name": found.name, "told_apart_by": found.index, "aligned_to": found.loops.aligned_to,
                  "loops": [_plain_row(found, k) for k in range(len(found.readings.cycles))],
                  "repeatability": _plain_repeats(found.loops)} for found in sets],
        "warnings": [{"text": note.text, "block": note.block, "channel": note.channel, "rows": note.rows}
                     for note in notes],
    }


def _plain_row(found: Read, k: int) -> dict[str, Any]:
    readings = found.readings
    row: dict[str, Any] = {found.index.removesuffix("s"): int(readings.cycles[k]), "regime": readings.regime[k]}
    for name, unit in QUANTITIES.items():
        estimate: LoopReading = getattr(readings, name)
        source = estimate.dominated_by[k]
        row[name] = {"value": _number(estimate.value[k]), "sd": _number(estimate.sd[k]), "unit": unit,
                     "mostly_by": None if source is None else str(source)}
    row["tangential_stiffness"]["at_least"] = _number(readings.stiffness_at_least[k])
    return row


def _plain_repeats(loops: LoopSet) -> dict[str, Any] | None:
    if loops.repeats.max() < 2:
        return None
    found = {name: repeatability(np.where(loops.usable[:, :, None], values, np.nan))
             for name, values in loops.channels.items()}
    return {name: {"noise_sd": float(np.sqrt(np.mean(r.noise_sd**2))), "gain_sd": r.gain_sd, "offset_sd": r.offset_sd,
                   "repeat_sd": float(np.sqrt(np.mean(r.repeat_sd**2))), "unit": loops.units[name]}
            for name, r in found.items()}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
