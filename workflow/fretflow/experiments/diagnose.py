"""A recording's diagnosis, by what it was made on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fretflow.experiments.driven.run import diagnose_driven
from fretflow.experiments.rig.run import RigTools, diagnose_rig
from fretflow.experiments.wear_series.run import diagnose_wear_series
from fretflow.inference.verdict import Diagnosis
from fretflow.recordings.recording import read_recording
from fretflow.recordings.schema import TestKind
from fretflow.recordings.wear_series import is_wear_series, read_wear_series


def diagnose(path: Path, fast: bool, progress: Callable[[float, str], None], tools: RigTools) -> Diagnosis:
    """Return what a recording shows that the model leaves out.

    Parameters
    ----------
    path : Path
        Folder of the recording, its ``recording.toml``, or a table of wear tests.
    fast : bool
        Whether a screening is enough.
    progress : callable
        Takes the share that is done, 0 to 1, and what is being done.
    tools : RigTools
        Meshes and processes, for recordings of the rig.

    Raises
    ------
    RecordingError
        If the recording cannot be used.
    NonConvergenceError
        If the baseline cannot be simulated.
    """
    progress(0.0, "reading")
    if is_wear_series(path):
        return diagnose_wear_series(read_wear_series(path), fast, progress)
    recording = read_recording(path)
    if recording.kind is not TestKind.FRETTING_RIG:
        return diagnose_driven(recording, fast, progress)
    return diagnose_rig(recording, fast, progress, tools)
