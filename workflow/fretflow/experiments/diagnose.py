"""A recording's diagnosis, by the experiment of its kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name

from fretflow.core.errors import UnsupportedRecordingError
from fretflow.experiments.rig.run import RigTools
from fretflow.inference.verdict import Diagnosis
from fretflow.recordings.kinds import Recorded, kinds, read_recording

Progress = Callable[[float, str], None]


def diagnose(recording: Path | Recorded, fast: bool, progress: Progress,
             tools: RigTools) -> Diagnosis:
    """Return what a recording shows that the model leaves out.

    Parameters
    ----------
    recording : Path or Recorded
        Folder of the recording, its ``recording.toml``, or a table of wear tests; or what its kind reads of it.
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
    found = read_recording(recording) if isinstance(recording, Path) else recording
    if not found.kind.experiment:
        raise UnsupportedRecordingError(f"{found.path}: test.kind {found.kind.id!r} has no diagnosis; there is one of "
                                        f"{', '.join(sorted(kind.id for kind in kinds().values() if kind.experiment))}")
    diagnosis: Diagnosis = resolve_name(found.kind.experiment)(found, fast, progress, tools)
    return diagnosis
