"""The commands init and show: a case file to start from, and one as it is read."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape

from fretflow.cli.terminal import Json, Terminal, keep_json, load, new_table, say_line
from fretflow.core.errors import InputError

if TYPE_CHECKING:
    from fretflow.case.casefile import Entry
    from fretflow.case.config import Case


def init(path: Path | None = None, /, *, recording: Path | None = None, json: Json = None) -> None:
    """Write a commented case file to start from, or a recording.toml that describes a file of loops.

    Parameters
    ----------
    path
        file to write, by default case.toml, or recording.toml beside the loops; an existing one is left alone
    recording
        file of loops, CSV, HDF5 or MATLAB: a recording.toml is written with what its headings tell
    """
    from fretflow.case.casefile import starting_case

    if recording is None:
        path = path or Path("case.toml")
        _write_new(path, starting_case())
        keep_json(json, {"file": str(path), "lacks": []})
        say_line(f"{path} written; `fretflow run {path}` runs it")
        return
    from fretflow.recordings.described import describe_file
    from fretflow.recordings.headings import taken_in_words
    from fretflow.recordings.schema import FILE

    path = path or recording.parent / FILE
    described = describe_file(recording, path.parent)
    _write_new(path, described.text)
    keep_json(json, {"file": str(path), "taken": described.taken, "lacks": described.lacks})
    said = f"{path} written; "
    if described.taken:
        said += f"{taken_in_words(described.taken)}; "
    if described.lacks:
        said += f"tell the column and unit of {' and '.join(described.lacks)} in it; then "
    say_line(f"{said}`fretflow loops {path}` reads it, and `fretflow diagnose {path}` explains it")


def _write_new(path: Path, text: str) -> None:
    """Write a file that does not exist yet."""
    try:
        with path.open("x", encoding="utf-8") as handle:
            handle.write(text)
    except FileExistsError as error:
        raise InputError(f"{path}: exists and is left as it is; name another file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); name another file") from error


def show(case: Path, /, *, json: Json = None) -> None:
    """Show the parsed case: every value with its unit, and which ones are defaults.

    Parameters
    ----------
    case
        case file
    """
    from fretflow.case.plausibility import warnings

    parsed = load(case)
    shown = _entries(parsed)
    _show(shown)
    keep_json(json, {"name": parsed.name, "warnings": warnings(parsed), "values": [
        {"table": ".".join(entry.table), "key": entry.key, "value": entry.value, "unit": entry.unit,
         "default": entry.is_default, "meaning": entry.meaning} for entry in shown]})


def _entries(case: Case) -> list[Entry]:
    """Return every value of `case`, its effects included."""
    from fretflow.case.casefile import entries

    shown = list(entries(case))
    if case.effects:
        from fretflow.effects.catalogue import parse_effects

        for effect in parse_effects(case.effects):
            shown += entries(effect, ("effects", effect.id))
    return shown


def _show(shown: Sequence[Entry]) -> None:
    """Print values in the units that engineers use."""
    console = Terminal()
    for table, group in groupby(shown, key=lambda entry: entry.table):
        view = new_table(".".join(table) or "case", "key", "value", "", "meaning")
        for entry in group:
            view.add_row(
                entry.key, escape(entry.readable), "default" if entry.is_default else "", entry.meaning
            )
        console.print(view)
