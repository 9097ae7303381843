"""What recordings are made on: the kinds in ``KINDS`` of each file of this room, and those of other packages.

The latter are found by entry points of the group ``fretflow.recordings``, each of which names a `RecordingKind`.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from types import MappingProxyType
from typing import Any, Protocol

from fretflow.core.errors import InputError, did_you_mean
from fretflow.recordings.description import FILE as FILE
from fretflow.recordings.description import file_at, read_description

GROUP = "fretflow.recordings"


@dataclass(frozen=True, order=True)
class RecordingKind:
    """What a recording was made on, hence who reads it and which experiment explains it.

    `reader` is the ``module:function`` that makes of a path what ``experiment`` explains:
    ``(data, fast, progress, tools) -> Diagnosis``.
    """

    id: str
    words: str  # one line for people: what it is and what predicts it
    experiment: str = ""  # none where loops are read and not explained
    reader: str = "fretflow.recordings.recording:read_joint_recording"
    tables: bool = False  # takes a bare table without a recording.toml as well
    displacement_range: tuple[float, float] = (1e-9, 1.0)  # m, peak-to-peak displacements of such tests
    full_model: bool = False  # the model predicts motion and force, from a stated load and point of measurement
    friction_alone: bool = True  # the force is that of friction, without inertia

    def __str__(self) -> str:
        return self.id

    def __reduce__(self) -> tuple[Callable[[str], RecordingKind], tuple[str]]:
        return kind_called, (self.id,)  # one object also in another process

    def read(self, path: Path) -> Any:
        """Return the recording at `path` as the experiment takes it.

        Raises
        ------
        RecordingError
            If it cannot be used.
        """
        return resolve_name(self.reader)(path)


class Recorded(Protocol):
    """What was read of a recording."""

    @property
    def path(self) -> Path:
        """Return where it was."""
        ...

    @property
    def kind(self) -> RecordingKind:
        """Return what it was made on."""
        ...


@cache
def kinds() -> Mapping[str, RecordingKind]:
    """Return all kinds by their id.

    Raises
    ------
    InputError
        If two share an id.
    """
    registered = [kind for info in pkgutil.iter_modules(__path__)
                  for kind in getattr(importlib.import_module(f"{__name__}.{info.name}"), "KINDS", ())]
    registered += [point.load() for point in entry_points(group=GROUP)]
    for kind in registered:
        if [one.id for one in registered].count(kind.id) > 1:
            raise InputError(f"kind {kind.id!r} of recordings is registered twice; give one another id")
    return MappingProxyType({kind.id: kind for kind in registered})


def kind_called(name: object) -> RecordingKind:
    """Return the kind of an id.

    Raises
    ------
    ValueError
        If there is none, naming those that there are.
    """
    if isinstance(name, RecordingKind):
        return name
    if isinstance(name, str) and name in kinds():
        return kinds()[name]
    raise ValueError(f"must be one of {', '.join(kinds())}, got {name!r}{did_you_mean(str(name), kinds())}")


def kind_at(path: Path) -> RecordingKind:
    """Return the kind of the recording at `path`; of one whose file cannot be read, that whose reader says why."""
    toml = file_at(path)
    if toml.is_file() and toml.suffix.lower() != ".toml":
        return next(kind for kind in kinds().values() if kind.tables)
    try:
        test = read_description(toml).get("test")
        return kind_called(test["kind"] if isinstance(test, dict) else None)
    except (InputError, ValueError, KeyError):
        return next(kind for kind in kinds().values() if kind.full_model)  # the rig's


def read_recording(path: Path | str) -> Any:
    """Read a recording: its folder, its ``recording.toml``, or a table of wear tests.

    Parameters
    ----------
    path : Path or str
        See ``docs/recordings.md`` for what stands in the file.

    Returns
    -------
    Recording, WearSeries or StructureRecording
        In SI and cleaned, of its kind; ``notes`` says what had to be left out or mended. Of a joint ``loops``,
        ``series``, ``sweep``, ``frf`` and ``wear_depth`` are None where there is no such block, and ``loops.arrays`` is
        an `xarray.Dataset`.

    Raises
    ------
    RecordingError
        If a file is damaged, contradicts another or too little of it is usable.
    ConfigError
        If ``recording.toml`` has a missing, unknown or impossible value.

    Examples
    --------
    >>> import fretflow as ff
    >>> recording = ff.read_recording("my recording")  # doctest: +SKIP
    >>> recording.loops.arrays.friction_force.mean("repeat")  # N, by cycles and phase  # doctest: +SKIP
    """
    return kind_at(Path(path)).read(Path(path))
