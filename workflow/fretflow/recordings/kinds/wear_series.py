"""A series of wear tests: one row a test, with its worn volume, dissipated energy and conditions.

What a column is tells its heading, or a ``recording.toml`` of kind ``wear-series``::

    format = "fretflow-recording/1"
    [test]
    kind = "wear-series"
    [wear_series]
    file = "tests.csv"
    volume = { column = "V", unit = "mm^3" }
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import (
    ConfigError,
    UnreliableRecordingError,
    UnsupportedRecordingError,
    did_you_mean,
)
from fretflow.core.records import Array, quantity, record
from fretflow.core.units import parse_quantity, pretty_quantity
from fretflow.recordings.description import file_at, read_description
from fretflow.recordings.kinds import RecordingKind
from fretflow.recordings.kinds.wear_headings import ROLES, Heading, dimension, roles_of, take_apart
from fretflow.recordings.notes import Note, row_ranges, rows_in_words
from fretflow.recordings.readers.tables import Table, read_table

WEAR_SERIES = RecordingKind(
    "wear-series", "wear series: one wear coefficient and the dissipated energy predict the worn volume of each test",
    "fretflow.experiments.wear_series.run:diagnose_wear_series", f"{__name__}:read_wear_series", tables=True)
KINDS = (WEAR_SERIES,)
STATES = ("pressure", "load", "amplitude", "sliding_distance", "frequency", "power_density", "cycles")
KEYS = ("column", "unit")  # of a column in recording.toml
MOST_TESTS = 10_000
LEAST_TESTS = 5
MOSTLY = 0.5  # of the tests that have to have a condition for it to be used
PLAUSIBLE = (1e-19, 1e-8)  # m^3/J: polymers on steel wear some 1e-12, lubricated steel some 1e-17
CONTRADICTS = 1.5  # ratio of a stated coefficient to volume over energy


@record
class WearSeries:
    """Wear tests, n of them, in SI."""

    kind: ClassVar[RecordingKind] = WEAR_SERIES

    path: Path
    title: str
    rows: NDArray[np.int64] = quantity("1", "(n,), as they count in the file, from 1")
    volume: Array = quantity("m^3", "(n,), worn off")
    energy: Array = quantity("J", "(n,), dissipated; if `relative` up to a factor")
    relative: bool = False  # no energy was measured: pressure times sliding stands for it
    volume_sd: Array | None = quantity("m^3", "(n,), one standard deviation", default=None)
    states: Mapping[str, Array]  # conditions by role, (n,)
    further: Mapping[str, Array]  # columns of no known role, (n,), as they stand in the file
    notes: tuple[Note, ...] = ()


def read_wear_series(path: Path) -> WearSeries:
    """Read a table of wear tests: the file itself, or the recording that names it.

    Raises
    ------
    RecordingError
        If the file is damaged, lacks worn volumes or what they are to follow, or contradicts itself.
    ConfigError
        If ``recording.toml`` has an unknown or impossible value.
    """
    title, file = path.stem, path
    given: dict[str, Any] = {}
    if path.is_dir() or path.suffix.lower() == ".toml":
        title, given, file = _stated(file_at(path))
    table = read_table(file)
    if table.rows > MOST_TESTS:
        raise UnsupportedRecordingError(f"{file}: {table.rows:,} rows are no wear series, which has a row for each "
                                        "test; `fretflow init --recording FILE` describes a record of loops")
    headings = {name: take_apart(name, table.units.get(name, "")) for name in table.columns}
    chosen, notes = _roles(table, headings, given)
    values = {role: table.columns[column] * _size(role, headings[column]) for role, column in chosen.items()}
    further = {name: column for name, column in table.columns.items() if name not in chosen.values()}
    notes = (*table.notes, *notes)
    return _series(file, title, values, further, notes)


def _stated(toml: Path) -> tuple[str, dict[str, Any], Path]:
    """Return title, columns by role, and the file that a ``recording.toml`` names."""
    raw = read_description(toml)
    block = raw.get("wear_series")
    if not isinstance(block, dict) or not isinstance(block.get("file"), str):
        raise ConfigError(f'{toml}: wear_series.file: is required: the table of tests, such as "tests.csv"')
    given = {key: entry for key, entry in block.items() if key != "file"}
    for key, entry in given.items():
        if key not in ROLES:
            raise ConfigError(f"{toml}: wear_series.{key}: unknown key; columns are {', '.join(ROLES)}")
        if not isinstance(entry, dict) or not isinstance(entry.get("column"), str | int):
            raise ConfigError(f'{toml}: wear_series.{key}: must be a table such as {{ column = "a", '
                              f'unit = "{ROLES[key][0]}" }}')
        for own in sorted(set(entry).difference(KEYS)):
            raise ConfigError(f"{toml}: wear_series.{key}.{own}: unknown key; there are {' and '.join(KEYS)}"
                              f"{did_you_mean(own, KEYS)}")
        unit = str(entry.get("unit", ""))
        if ROLES[key][0] != "1" and unit and dimension(unit) != ROLES[key][0]:
            raise ConfigError(f"{toml}: wear_series.{key}.unit: {unit!r} is no unit like {ROLES[key][0]}")
    return str(raw.get("title") or toml.parent.name), given, toml.parent / block["file"]


def _roles(table: Table, headings: dict[str, Heading], given: Mapping[str, Any]
           ) -> tuple[dict[str, str], tuple[Note, ...]]:
    """Return the column of each role; what is given goes before what headings say, and changes their units."""
    chosen: dict[str, str] = {}
    for role, entry in given.items():
        column = table.column(entry["column"])[0]
        if unit := str(entry.get("unit", "")):
            headings[column] = Heading(column, unit)
        elif ROLES[role][0] != "1" and dimension(headings[column].unit) != ROLES[role][0]:
            raise UnsupportedRecordingError(f"{table.path}: column {column} has no unit like {ROLES[role][0]}; give "
                                            f"wear_series.{role}.unit")
        chosen[role] = column
    for role, columns in roles_of(headings).items():
        free = [column for column in columns if column not in chosen.values()]
        if role not in chosen and free:
            chosen[role] = free[0]
    if "volume" not in chosen:
        raise UnsupportedRecordingError(f"{table.path}: none of the columns {', '.join(table.columns)} is a worn "
                                        "volume with its unit; name one V_mm3, or describe loops by `fretflow init "
                                        "--recording FILE`")
    used = set(chosen.values())
    left = [column for column in table.columns if column not in used]
    if not left:
        return chosen, ()
    return chosen, (Note(table.path.name, "no quantity of wear that is known; no law uses it, what is left is compared "
                                          "with it", ", ".join(left)),)


def _size(role: str, heading: Heading) -> float:
    si = ROLES[role][0]
    return heading.factor * (1.0 if si == "1" else parse_quantity(f"1 {heading.unit}", si))


def _series(path: Path, title: str, values: dict[str, Array], further: Mapping[str, Array], notes: Sequence[Note]
            ) -> WearSeries:
    states = {role: values[role] for role in STATES if role in values}
    all_notes = list(notes)
    for role in list(states):
        there = np.isfinite(states[role])
        if there.mean() < MOSTLY:
            all_notes.append(Note(path.name, "lacks most of its numbers and is not used", _word(role),
                                  row_ranges(np.flatnonzero(~there))))
            del states[role]
    energy, relative, more = _energy(path, values, states)
    all_notes += more
    usable = np.ones(len(energy), dtype=bool)
    columns = {"volume": values["volume"], "energy": energy, **states}
    for role, column in columns.items():
        for bad, text in ((~np.isfinite(column), "has no number: the test is left out"),
                          (np.nan_to_num(column, nan=1.0) <= 0.0, "is not above zero: the test is left out")):
            if (own := bad & usable).any():
                all_notes.append(Note(path.name, text, _word(role), row_ranges(np.flatnonzero(own))))
        usable &= np.isfinite(column) & (np.nan_to_num(column) > 0.0)
    if usable.sum() < LEAST_TESTS:
        raise UnreliableRecordingError(f"{path}: {int(usable.sum())} of {len(usable)} tests have all of "
                                       f"{', '.join(map(_word, columns))} above zero, at least {LEAST_TESTS} are needed"
                                       + _first(all_notes))
    sd = values.get("volume_sd")
    if sd is not None and not np.all(sd[usable] > 0.0):
        all_notes.append(Note(path.name, "is not above zero everywhere and is not used", "sd of the worn volume"))
        sd = None
    series = WearSeries(
        path=path, title=title, rows=np.flatnonzero(usable) + 1, volume=values["volume"][usable], energy=energy[usable],
        relative=relative, volume_sd=None if sd is None else sd[usable],
        states={role: column[usable] for role, column in states.items()},
        further={name: column[usable] for name, column in further.items()}, notes=tuple(all_notes))
    _check(series, values.get("coefficient", np.full(len(usable), np.nan))[usable])
    return series


def _first(notes: Sequence[Note]) -> str:
    rows = [note for note in notes if note.rows]
    return f" ({rows[0]})" if rows else ""


def _energy(path: Path, values: Mapping[str, Array], states: Mapping[str, Array]
            ) -> tuple[Array, bool, list[Note]]:
    """Return the dissipated energy, where it lacks from the coefficient, or in proportion to pressure and sliding."""
    notes = []
    energy = values.get("energy", np.full(len(values["volume"]), np.nan)).copy()
    if "coefficient" in values:
        lacks = ~np.isfinite(energy)
        energy[lacks] = values["volume"][lacks] / np.where(values["coefficient"] > 0.0, values["coefficient"],
                                                           np.nan)[lacks]
        if (told := lacks & np.isfinite(energy)).any():
            notes.append(Note(path.name, "is taken as volume over coefficient", "energy",
                              row_ranges(np.flatnonzero(told))))
    lacks, work = ~np.isfinite(energy), _work(states)
    if work is None:
        if lacks.all():
            raise UnsupportedRecordingError(f"{path}: worn volumes need a dissipated energy, or load or pressure with "
                                            "sliding and cycles; add the columns with their units, such as E_J")
        return energy, False, notes
    relative = bool(lacks.all())
    both = np.isfinite(energy) & (np.nan_to_num(work) > 0.0)
    factor = 1.0 if relative or not both.any() else float(np.median(energy[both] / work[both]))
    energy[lacks] = factor * work[lacks]
    if relative:
        notes.append(Note(path.name, "none is given; load or pressure times sliding stands for it", "energy"))
    elif (told := lacks & np.isfinite(energy)).any():
        notes.append(Note(path.name, "is taken in proportion to load or pressure times sliding", "energy",
                          row_ranges(np.flatnonzero(told))))
    return energy, relative, notes


def _work(states: Mapping[str, Array]) -> Array | None:
    """Return what a test's energy is proportional to with one friction coefficient and area, if it is known."""
    load = states.get("load", states.get("pressure"))
    path = states.get("sliding_distance")
    if path is None and {"amplitude", "cycles"} <= set(states):
        path = 4.0 * states["amplitude"] * states["cycles"]
    if path is None:
        path = states.get("amplitude")
    return None if load is None or path is None else load * path


def _check(series: WearSeries, stated: Array) -> None:
    """Refuse volumes and energies that contradict a stated coefficient or are of no known wear."""
    if series.relative:
        return
    ratio = series.volume / series.energy
    off = np.isfinite(stated) & (np.abs(np.log(np.where(stated > 0.0, stated, np.nan) / ratio)) > np.log(CONTRADICTS))
    if off.any():
        where = rows_in_words(row_ranges(series.rows[off] - 1))
        one = int(np.flatnonzero(off)[0])
        raise UnreliableRecordingError(f"{series.path}: {where}: volume over energy is {stated[one] / ratio[one]:.3g} "
                                       "times smaller than the coefficient that is stated; check columns and units")
    typical = float(np.median(ratio))
    if not PLAUSIBLE[0] < typical < PLAUSIBLE[1]:
        volume, energy = (pretty_quantity(float(np.median(v)), unit, 3) for v, unit in (
            (series.volume, "m^3"), (series.energy, "J")))
        raise UnreliableRecordingError(f"{series.path}: a worn volume of {volume} for {energy} is "
                                       f"{typical:.2g} m^3/J, no wear that is known; check columns and units")


def _word(role: str) -> str:
    return {"volume": "worn volume"}.get(role, role.replace("_", " "))
