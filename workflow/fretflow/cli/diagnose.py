"""The diagnose command: what a recording shows that the model leaves out, in short on the terminal and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.markup import escape

from fretflow.cli.terminal import Flag, NewFile, Progress, Terminal, new_table, show_files
from fretflow.core.errors import InputError

if TYPE_CHECKING:
    from fretflow.inference.verdict import Diagnosis

HOME = Path("runs/diagnosis")
MOST_RANKED = 5


def diagnose(
    recording: Path, /, *, fast: Flag = False, json: NewFile = None, out: Path | None = None, case: NewFile = None,
) -> None:
    """Say whether the model explains a recording and, if not, where they part and which physics is left out.

    Writes report.html, the verdict as JSON, the places of the difference as CSV and, where effects are named, a case
    with them for `fretflow run`. Every verdict has exit code 0.

    Parameters
    ----------
    recording
        folder with a recording.toml, or a table of wear tests
    fast
        fits in fewer steps and looks at fewer pairs: a recording of a rig in some minutes
    json
        file for a copy of the JSON
    out
        folder of the results; by default runs/diagnosis/RECORDING
    case
        file for a copy of the case
    """
    from fretflow.pipeline.diagnose import diagnose as judge
    from fretflow.pipeline.diagnose import made_folder
    from fretflow.recordings.schema import FILE, name_of

    if not recording.exists():
        raise InputError(f"{recording}: there is no such folder or file; give a folder with a {FILE}")
    home = made_folder(HOME / name_of(recording) if out is None else out)
    with Progress() as shown:
        shown.begin("diagnose")
        diagnosis = judge(recording, fast=fast, home=home,
                         progress=lambda share, text: shown.advance("diagnose", share, text))
    files = _write(diagnosis, home, json, case)
    console = Terminal(highlight=False)
    _show(console, diagnosis)
    if case is not None and not diagnosis.case_file:
        console.print(f"{escape(str(case))} was not written: nothing is named that a case could add",
                      soft_wrap=True)
    show_files(files, "report and numbers")


def _write(diagnosis: Diagnosis, home: Path, json_file: Path | None, case_file: Path | None) -> list[Path]:
    from fretflow.core.store import write_csv, write_whole

    places = diagnosis.location.places
    columns: dict[str, Sequence[object]] = {
        "cut": [p.cut for p in places], "where": [p.where for p in places],
        "share": [p.share for p in places], "p_value_corrected": [p.p_value for p in places]}
    files = [diagnosis.to_html(home / "report.html")]
    for path in _copies(home / "diagnosis.json", json_file):
        diagnosis.to_json(path)
        files.append(path)
    files.append(write_csv(home / "places.csv", columns))
    if diagnosis.case_file:
        for path in _copies(home / "case.toml", case_file):
            write_whole(path, diagnosis.case_file.encode())
            files.append(path)
    return files


def _copies(own: Path, wanted: Path | None) -> list[Path]:
    from fretflow.pipeline.diagnose import made_folder

    if wanted is None or wanted.resolve() == own.resolve():
        return [own]
    made_folder(wanted.parent)
    return [own, wanted]


def _show(console: Terminal, diagnosis: Diagnosis) -> None:
    """Print the verdict in short; the page has the rest."""
    from fretflow.inference import words

    console.print(f"[bold]{escape(diagnosis.title or diagnosis.recording)}[/bold]", soft_wrap=True)
    console.print(f"[bold]{words.headline(diagnosis)}.[/bold] {escape(diagnosis.sentence)}", soft_wrap=True)
    console.print(f"probability: {words.probability(diagnosis.probability)} {words.probability_of(diagnosis)}")
    if diagnosis.detection.tests:
        chance = f"p = {words.p_value(diagnosis.detection.p_value)}".replace("= <", "<")
        console.print(f"by errors of measurement alone: {chance}")
    if diagnosis.ranking:
        view = new_table("explanations, most probable first", "effects", "probability", "explained", "fitted")
        for one in diagnosis.ranking[:MOST_RANKED]:
            view.add_row(escape(words.together(one.effects)), words.probability(one.probability),
                         words.explained(diagnosis, one), words.fitted(one))
        view.add_row(words.UNLISTED, words.probability(words.unlisted(diagnosis)), "", "")
        console.print(view)
    if diagnosis.location.text:
        console.print(f"where: {escape(diagnosis.location.text)}", soft_wrap=True)
    if diagnosis.parameters:
        view = new_table("parameters", "parameter", "value", "90 % interval", "unit")
        for estimate in diagnosis.parameters:
            shown = words.interval(estimate)
            view.add_row(escape(estimate.name), shown.value, shown.ends, shown.unit)
        console.print(view)
    fit = diagnosis.held_out
    if fit is not None:
        console.print(f"held out ({escape(fit.what)}): error {words.number(fit.before)} before, "
                      f"{words.number(fit.after)} after, {words.number(fit.floor)} among repeats", soft_wrap=True)
    if diagnosis.separating_measurement:
        console.print(f"measure next: {escape(diagnosis.separating_measurement)}", soft_wrap=True)
    for text in (*(f"warning: {one}" for one in diagnosis.warnings), *(f"note: {one}" for one in diagnosis.notes)):
        console.print(escape(text), soft_wrap=True)
    console.print(f"took: {escape(words.cost(diagnosis))}", soft_wrap=True)
