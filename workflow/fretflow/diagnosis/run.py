"""A recording's diagnosis, by what it was made on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fretflow.core.errors import InputError
from fretflow.diagnosis.driven_run import diagnose_driven
from fretflow.diagnosis.verdict import Diagnosis
from fretflow.diagnosis.wear_series import diagnose_wear_series
from fretflow.recordings.recording import read_recording
from fretflow.recordings.schema import TestKind
from fretflow.recordings.wear_series import is_wear_series, read_wear_series


def diagnose(path: Path, fast: bool, out: Path, progress: Callable[[float, str], None]) -> Diagnosis:
    """Return what a recording shows that the model leaves out.

    Parameters
    ----------
    path : Path
        Folder of the recording, or its ``recording.toml``.
    fast : bool
        Whether a screening is enough.
    out : Path
        Folder of the results.
    progress : callable
        Takes the share that is done, 0 to 1, and what is being done.

    Raises
    ------
    RecordingError
        If the recording cannot be used.
    InputError
        If recordings of its kind cannot be diagnosed.
    """
    progress(0.0, "reading")
    if is_wear_series(path):
        return diagnose_wear_series(read_wear_series(path), fast, progress)
    recording = read_recording(path)
    if recording.kind is not TestKind.FRETTING_RIG:
        return diagnose_driven(recording, fast, progress)
    raise InputError(f"{path}: recordings of the rig are not diagnosed yet; `fretflow loops` reads them")
