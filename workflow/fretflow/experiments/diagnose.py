"""A recording's diagnosis, by what it was made on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fretflow.core.errors import UnsupportedRecordingError
from fretflow.experiments.driven.run import diagnose_driven
from fretflow.experiments.rig.run import RigTools, diagnose_rig
from fretflow.experiments.structure.run import diagnose_structure
from fretflow.experiments.wear_series.run import diagnose_wear_series
from fretflow.inference.verdict import Diagnosis
from fretflow.recordings.kinds.structures import KIND as STRUCTURE
from fretflow.recordings.kinds.structures import StructureRecording, is_structure, read_structure_recording
from fretflow.recordings.recording import Recording, read_recording
from fretflow.recordings.schema import TestKind
from fretflow.recordings.wear_series import KIND, WearSeries, is_wear_series, read_wear_series

Progress = Callable[[float, str], None]
# The diagnosis of each kind of recording: of what was read of it, whether fast, by whom progress is heard, and tools.
EXPERIMENTS: Mapping[str, Callable[[Any, bool, Progress, RigTools], Diagnosis]] = {
    TestKind.FRETTING_RIG.value: diagnose_rig, TestKind.IMPOSED_DISPLACEMENT.value: diagnose_driven,
    TestKind.LUMPED.value: diagnose_driven, KIND: diagnose_wear_series, STRUCTURE: diagnose_structure}

READERS: tuple[tuple[Callable[[Path], bool], Callable[[Path], Recording | StructureRecording | WearSeries]], ...] = (
    (is_structure, read_structure_recording), (is_wear_series, read_wear_series))


def diagnose(recording: Path | Recording | StructureRecording | WearSeries, fast: bool, progress: Progress,
             tools: RigTools) -> Diagnosis:
    """Return what a recording shows that the model leaves out.

    Parameters
    ----------
    recording : Path, Recording, StructureRecording or WearSeries
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
        read = next((own for tells, own in READERS if tells(recording)), read_recording)
        recording = read(recording)
    kind = _kind(recording)
    if kind not in EXPERIMENTS:
        raise UnsupportedRecordingError(f"{recording.path}: test.kind {kind!r} has no diagnosis; there is one of "
                                        f"{', '.join(sorted(EXPERIMENTS))}")
    return EXPERIMENTS[kind](recording, fast, progress, tools)


def _kind(recording: Recording | StructureRecording | WearSeries) -> str:
    if isinstance(recording, Recording):
        return recording.kind.value
    return KIND if isinstance(recording, WearSeries) else STRUCTURE
