"""The loops command: what is read off a recording, as a table, a picture, CSV and JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import floor, isfinite, log10
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape

from fretflow.cli.terminal import Json, Terminal, keep_json, new_table, positive, show_files

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from fretflow.recordings.loop_sets import LoopsRead
    from fretflow.recordings.notes import Note
    from fretflow.recordings.readings import LoopReading, RecordedReadings

HEADINGS = {"dissipated_energy": "energy per cycle"}  # where it is not the quantity's own name
MOST_ROWS = 40
ROUNDING = 1e-9  # relative: a smaller deviation is none
WIDE = 104  # characters of a terminal in which a value and its deviation stand side by side


def loops(
    recording: Path, /, *, normal_load: str | None = None, frequency: str | None = None,
    displacement: str | None = None, force: str | None = None, time: str | None = None, out: Path = Path("runs"),
    json: Json = None,
) -> None:
    """Read recorded hysteresis loops: friction, stiffness, energy and sliding with uncertainty, for each cycle count.

    Writes OUT/NAME-loops/ with a picture and CSV. Whatever had to be cleaned or left out is listed with its rows.

    Parameters
    ----------
    recording
        folder with a recording.toml, or one file of loops: CSV, HDF5 or MATLAB
    normal_load
        such as "60 N", where the recording does not say it
    frequency
        such as "100 Hz", of a single file
    displacement
        of a single file: "COLUMN [UNIT]", "[UNIT]" or "COLUMN" where its heading has the unit; likewise:
    force
        column and unit of the friction force
    time
        column and unit of the time
    out
        folder of all results; a recording's own are in OUT/NAME-loops
    """
    from fretflow.core.plugins import FIGURES, provided
    from fretflow.core.store import write_csv
    from fretflow.recordings.loop_sets import as_json, csv_columns, read_sets, recorded
    from fretflow.recordings.schema import name_of

    columns = {"displacement": displacement, "friction_force": force, "time": time}
    made, load = recorded(recording, {channel: text for channel, text in columns.items() if text is not None},
                          positive("--normal-load", normal_load, "N"), positive("--frequency", frequency, "Hz"))
    sets, notes = read_sets(made, load)
    console = Terminal(highlight=False)
    console.print(escape(made.title))
    for loops_read in sets:
        console.print(_table(loops_read, "" if console.width >= WIDE else "\n") if made.kind.friction_alone
                      else _lumped_table(loops_read))
    _print_notes(console, notes)
    home = out / f"{name_of(recording)}-loops"
    home.mkdir(parents=True, exist_ok=True)
    files = []
    for loops_read in sets:
        files.append(write_csv(home / f"{loops_read.name}_readings.csv", csv_columns(loops_read)))
        files += provided(FIGURES, "loops")(home / f"{loops_read.name}.png", made.title, loops_read)
    if json is not None:
        files += keep_json(json, as_json(made, load, sets, notes))
    show_files(files, "pictures and numbers")


def _table(loops_read: LoopsRead, between: str) -> Table:
    from fretflow.core.units import pretty_unit, readable_unit
    from fretflow.recordings.loop_sets import QUANTITIES

    readings = loops_read.readings
    shown = {name: HEADINGS.get(name, name.replace("_", " ")) for name in loops_read.shown}
    scales = {name: readable_unit(loops_read.largest(name), QUANTITIES[name]) for name in shown}
    sources = _sources(readings, shown)
    ends = {"regime": readings.regime, "mostly by": sources}
    same = {heading: cells[0] for heading, cells in ends.items() if len(set(cells)) == 1}
    title = f"{loops_read.name}: {same['regime']}; " if "regime" in same else f"{loops_read.name}: "
    title += "± one standard deviation" + (f", mostly {same['mostly by']}" if "mostly by" in same else "")
    view = new_table(title, loops_read.index, *(", ".join(filter(None, (heading, pretty_unit(scales[name][0]))))
                                                for name, heading in shown.items()),
                     *(heading for heading in ends if heading not in same))
    rows = range(len(readings.cycles))
    for k in rows if len(rows) <= MOST_ROWS else [*rows[:MOST_ROWS // 2], *rows[-MOST_ROWS // 2:]]:
        view.add_row(loops_read.called[k], *(_cell(readings, name, k, scales[name][1]).replace("±", f"{between}±")
                                                    for name in shown),
                     *(cells[k] for heading, cells in ends.items() if heading not in same))
    if len(rows) > MOST_ROWS:
        view.caption = f"the first and last of {len(rows)}; the CSV has all"
    return view


def _sources(readings: RecordedReadings, shown: Mapping[str, str]) -> list[str]:
    """Return what most of the uncertainty of the first reading shown comes from, and of others if it differs."""
    every = zip(*(getattr(readings, name).dominated_by for name in shown), strict=True)
    return [", ".join(dict.fromkeys(str(source) for source in row if source is not None)) or "-" for row in every]


def _cell(readings: RecordedReadings, name: str, k: int, size: float) -> str:
    from fretflow.core.units import pretty_number

    estimate: LoopReading = getattr(readings, name)
    if name == "tangential_stiffness" and not isfinite(estimate.value[k]) and isfinite(
            readings.stiffness_at_least[k]):
        return f"> {pretty_number(readings.stiffness_at_least[k] / size, 3)}"
    return with_error(estimate.value[k] / size, estimate.sd[k] / size)


def with_error(value: float, sd: float) -> str:
    """Return ``"0.4003±0.0017"``: the deviation with two figures, the value to the same place."""
    from fretflow.core.units import pretty_number

    if not isfinite(value):
        return "-"
    if not isfinite(sd):
        return f"{pretty_number(value, 5)}±?"
    if sd <= ROUNDING * abs(value):
        return pretty_number(value, 5)
    digits = max(0, 1 - floor(log10(sd)))
    return f"{value:.{min(digits, 9)}f}±{sd:.{min(digits, 9)}f}"


def _lumped_table(loops_read: LoopsRead) -> Table:
    """Show what a lumped system's record tells without a model: its force holds inertia, so no friction law."""
    import numpy as np

    from fretflow.core.units import pretty_unit, readable_unit

    readings = loops_read.readings
    stroke, work = readings.peak_to_peak, readings.dissipated_energy
    mean = work.value / (2.0 * stroke.value)
    parts = [("stroke", stroke.value, stroke.sd, "m"), ("work of the force", work.value, work.sd, "J"),
             ("work / (2 stroke)", mean, mean * np.hypot(work.sd / work.value, stroke.sd / stroke.value), "N")]
    scales = [readable_unit(float(np.nanmax(np.abs(value))), unit) for _, value, _, unit in parts]
    view = new_table(f"{loops_read.name}: a lumped system, whose force holds its inertia; what each whole cycle tells",
                     loops_read.index, *(f"{name}, {pretty_unit(unit)}"
                                         for (name, *_), (unit, _) in zip(parts, scales, strict=True)))
    for k, called in enumerate(loops_read.called):
        view.add_row(called, *(with_error(value[k] / size, sd[k] / size) for (_, value, sd, _), (_, size) in zip(
            parts, scales, strict=True)))
    return view


def _print_notes(console: Console, notes: Sequence[Note]) -> None:
    if notes:
        console.print("warnings:" if len(notes) > 1 else "warning:")
    for note in notes:
        console.print(f"  {escape(str(note))}", soft_wrap=True)
