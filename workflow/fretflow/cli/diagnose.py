"""The diagnose command: what a recording shows that the model leaves out, in short on the terminal and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from fretflow.cli.report import Progress, Terminal, new_table, show_files
from fretflow.core.errors import InputError
from fretflow.core.store import write_csv, write_whole
from fretflow.inference import words
from fretflow.inference.verdict import Diagnosis
from fretflow.pipeline.diagnose import diagnose, made_folder
from fretflow.recordings.schema import FILE, name_of

HOME = Path("runs/diagnosis")
MOST_RANKED = 5


def diagnose_recording(recording: Path, fast: bool, out: Path | None, json_file: Path | None,
                       case_file: Path | None) -> list[Path]:
    """Diagnose a recording, print the verdict and return the files that were written.

    Parameters
    ----------
    recording : Path
        Folder of a recording, or its ``recording.toml``.
    fast : bool
        Whether a screening is enough.
    out : Path or None
        Folder of the results; by default one that is named after the recording.
    json_file, case_file : Path or None
        Further copies of the JSON, and of the case with the named effects where there is one.

    Raises
    ------
    RecordingError
        If the recording cannot be used.
    InputError
        If there is no such recording, or the results cannot be written.
    """
    if not recording.exists():
        raise InputError(f"{recording}: there is no such folder or file; give a folder with a {FILE}")
    home = made_folder(HOME / name_of(recording) if out is None else out)
    with Progress() as shown:
        shown.begin("diagnose")
        found = diagnose(recording, fast=fast, home=home,
                         progress=lambda share, text: shown.advance("diagnose", share, text))
    files = _write(found, home, json_file, case_file)
    console = Terminal(highlight=False)
    _show(console, found)
    if case_file is not None and not found.case_file:
        console.print(f"{escape(str(case_file))} was not written: nothing is named that a case could add",
                      soft_wrap=True)
    show_files(files, "report and numbers")
    return files


def _write(found: Diagnosis, home: Path, json_file: Path | None, case_file: Path | None) -> list[Path]:
    places = found.location.places
    columns: dict[str, Sequence[object]] = {
        "cut": [p.cut for p in places], "where": [p.where for p in places],
        "share": [p.share for p in places], "p_value_corrected": [p.p_value for p in places]}
    files = [found.to_html(home / "report.html")]
    for path in _copies(home / "diagnosis.json", json_file):
        found.to_json(path)
        files.append(path)
    files.append(write_csv(home / "places.csv", columns))
    if found.case_file:
        for path in _copies(home / "case.toml", case_file):
            write_whole(path, found.case_file.encode())
            files.append(path)
    return files


def _copies(own: Path, wanted: Path | None) -> list[Path]:
    if wanted is None or wanted.resolve() == own.resolve():
        return [own]
    made_folder(wanted.parent)
    return [own, wanted]


def _show(console: Console, found: Diagnosis) -> None:
    """Print the verdict in short; the page has the rest."""
    console.print(f"[bold]{escape(found.title or found.recording)}[/bold]", soft_wrap=True)
    console.print(f"[bold]{words.VERDICT_WORDS[found.verdict]}.[/bold] {escape(found.sentence)}", soft_wrap=True)
    console.print(f"by chance: p = {words.p_value(found.detection.p_value)}".replace("= <", "<"))
    if found.ranking:
        view = new_table("explanations, most probable first", "effects", "probability", "explained")
        for one in found.ranking[:MOST_RANKED]:
            view.add_row(escape(words.together(one.effects)), words.percent(one.probability),
                         words.percent(one.explained))
        console.print(view)
    if found.location.text:
        console.print(f"where: {escape(found.location.text)}", soft_wrap=True)
    if found.parameters:
        view = new_table("parameters", "parameter", "value", "90 % interval", "unit")
        for estimate in found.parameters:
            shown = words.interval(estimate)
            view.add_row(escape(estimate.name), shown.value, f"{shown.low} to {shown.high}", shown.unit)
        console.print(view)
    fit = found.held_out
    if fit is not None:
        console.print(f"held out ({escape(fit.what)}): error {words.number(fit.before)} before, "
                      f"{words.number(fit.after)} after, {words.number(fit.floor)} among repeats", soft_wrap=True)
    if found.separating_measurement:
        console.print(f"measure next: {escape(found.separating_measurement)}", soft_wrap=True)
    for note in found.notes:
        console.print(f"warning: {escape(note)}", soft_wrap=True)
