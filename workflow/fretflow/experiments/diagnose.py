"""A recording's diagnosis, by what it was made on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fretflow.core.errors import UnsupportedRecordingError
from fretflow.experiments.driven.run import diagnose_driven
from fretflow.experiments.rig.run import RigTools, diagnose_rig
from fretflow.experiments.wear_series.run import diagnose_wear_series
from fretflow.inference.verdict import Diagnosis
from fretflow.recordings.recording import Recording, read_recording
from fretflow.recordings.schema import TestKind
from fretflow.recordings.wear_series import KIND, WearSeries, is_wear_series, read_wear_series

Progress = Callable[[float, str], None]
# The diagnosis of each kind of recording: of what was read of it, whether fast, by whom progress is heard, and tools.
EXPERIMENTS: Mapping[str, Callable[[Any, bool, Progress, RigTools], Diagnosis]] = {
    TestKind.FRETTING_RIG.value: diagnose_rig, TestKind.IMPOSED_DISPLACEMENT.value: diagnose_driven,
    TestKind.LUMPED.value: diagnose_driven, KIND: diagnose_wear_series}


def diagnose(recording: Path | Recording | WearSeries, fast: bool, progress: Progress, tools: RigTools) -> Diagnosis:
    """Return what a recording shows that the model leaves out.

    Parameters
    ----------
    recording : Path, Recording or WearSeries
        Folder of the recording, its ``recording.toml``, or a table of wear tests; or what was read of it.
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
    if isinstance(recording, Path):
        recording = read_wear_series(recording) if is_wear_series(recording) else read_recording(recording)
    kind = KIND if isinstance(recording, WearSeries) else recording.kind.value
    if kind not in EXPERIMENTS:
        raise UnsupportedRecordingError(f"{recording.path}: test.kind {kind!r} has no diagnosis; there is one of "
                                        f"{', '.join(sorted(EXPERIMENTS))}")
    return EXPERIMENTS[kind](recording, fast, progress, tools)
