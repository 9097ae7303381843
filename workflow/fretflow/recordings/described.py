"""A ``recording.toml`` for one file of loops, from what its headings and numbers tell, with what is left to tell."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fretflow.core.units import format_quantity
from fretflow.recordings.channels import INDICES, unit_size
from fretflow.recordings.headings import NEEDED, columns_told, unit_example, unit_told
from fretflow.recordings.kinds.joints import IMPOSED_DISPLACEMENT
from fretflow.recordings.loopset import FORCES
from fretflow.recordings.periods import smoothed_record, upward_crossings
from fretflow.recordings.readers.tables import Table, read_table


@dataclass(frozen=True)
class Described:
    """A ``recording.toml`` as text, which columns were taken for which channels, and the channels that it lacks."""

    text: str
    taken: Mapping[str, str]
    lacks: tuple[str, ...]


def describe_file(path: Path, folder: Path) -> Described:
    """Return a ``recording.toml`` of `folder` for the loops in the file `path`.

    Raises
    ------
    RecordingError
        If the file cannot be used.
    """
    table = read_table(path)
    told = columns_told(table)
    known = {channel: (columns[0], unit_told(table, channel, columns[0]))
             for channel, columns in told.items() if len(columns) == 1}
    doubtful = {channel: columns for channel, columns in told.items() if len(columns) > 1}
    lacks = tuple(name for name in dict.fromkeys((*NEEDED, *doubtful)) if not known.get(name, ("", ""))[1])
    lines = [
        'format = "fretflow-recording/1"', f"title = {_text(path.stem)}", "", "[test]",
        f"kind = {_text(str(IMPOSED_DISPLACEMENT))}  # or fretting-rig, where all of the rig is known, or lumped",
        *_frequency(table, known), '# normal_load = "60 N"', '# excitation_amplitude = "50 N"', "",
        "[loops]" if "cycle" in known else "[series]", f"file = {_text(os.path.relpath(path, folder))}",
        '# displacement_of = "contact-faces"  # or "back-faces", or a distance from the interface such as "1 mm"',
        *_channels(table, known, doubtful, lacks)]
    return Described("\n".join(lines) + "\n", {channel: column for channel, (column, _) in known.items()}, lacks)


def _channels(table: Table, known: Mapping[str, tuple[str, str]], doubtful: Mapping[str, tuple[str, ...]],
              lacks: tuple[str, ...]) -> Iterator[str]:
    """Yield a line for each channel; a scale of -1 turns a sign."""
    turned = not lacks and _gives_energy(table, *(known[name][0] for name in NEEDED))
    for name in dict.fromkeys((*NEEDED, *known, *doubtful)):
        heading, unit = known.get(name, ("", ""))
        if name in INDICES:
            yield f"{name} = {{ column = {_text(heading)} }}"
            continue
        wrong = turned and name in FORCES
        told = [f"its column: one of {', '.join(doubtful.get(name, table.columns))}"] if not heading else []
        told += [f"its unit, such as {unit_example(name)}"] if not unit else []
        told += ["turned: as recorded, loops run the wrong way round and give energy"] if wrong else []
        yield (f"{name} = {{ column = {_text(heading)}, unit = {_text(unit)}, scale = {-1.0 if wrong else 1.0} }}"
               + (f"  # {'; '.join(told)}".replace("\n", " ") if told else ""))
    for heading in table.columns:
        if heading not in [column for column, _ in known.values()]:
            yield f"# not read: {_text(heading)}"


def _frequency(table: Table, known: Mapping[str, tuple[str, str]]) -> list[str]:
    """Return the line of the frequency by which the displacement comes back, where time is known."""
    unknown = ['# excitation_frequency = "100 Hz"']
    if "cycle" in known or not {"time", "displacement"} <= known.keys() or not known["time"][1]:
        return unknown
    x = table.columns[known["displacement"][0]]
    time = table.columns[known["time"][0]] * unit_size("time", known["time"][1])[0]
    there = np.isfinite(x) & np.isfinite(time)
    turns = upward_crossings(smoothed_record(x[there])) if there.any() else np.zeros(0)
    at = np.interp(turns, np.arange(there.sum()), time[there]) if turns.size else turns
    if len(at) < 3 or not at[-1] > at[0]:
        return unknown
    return [f"excitation_frequency = {_text(format_quantity((len(at) - 1) / (at[-1] - at[0]), 'Hz', 4))}"
            "  # by which the displacement comes back"]


def _gives_energy(table: Table, displacement: str, force: str) -> bool:
    """Return whether the force works against the motion over the whole record."""
    x, f = table.columns[displacement], table.columns[force]
    known = np.isfinite(x) & np.isfinite(f)
    x, f = x[known], f[known]
    return len(x) > 1 and float(np.sum(0.5 * (f[1:] + f[:-1]) * np.diff(x))) < 0.0


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
