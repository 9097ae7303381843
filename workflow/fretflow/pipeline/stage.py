"""What a stage is, what it is given and what is kept of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fretflow.case.config import Case
from fretflow.core.errors import StoreError
from fretflow.core.store import write_whole

MANIFEST = "manifest.json"
RUN_FILE = "run.json"
CASE_FILE = "case.toml"

Figures = Mapping[str, float | int | str | None]
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class StageContext:
    """What a stage works with.

    Attributes
    ----------
    case : Case
        The whole case; a stage reads only what its configuration slice names.
    folder : Path
        Where results go. It may hold checkpoints of an interrupted run of the same stage with equal inputs.
    inputs : mapping of str to Path
        The complete folder of every stage that this one needs.
    progress : callable
        ``progress(share done, what is going on)``.
    comm : MPI communicator or None
        Given to a collective stage under mpirun, else None.
    """

    case: Case
    folder: Path
    inputs: Mapping[str, Path]
    progress: Progress
    comm: Any = None


@dataclass(frozen=True)
class Stage:
    """A step of the pipeline.

    Attributes
    ----------
    name : str
        Names the stage and its folder.
    version : int
        Schema version of its results; a new one makes old results unused.
    config_slice : callable
        Returns the part of the case that the results depend on.
    needs : tuple of str
        Stages whose results it reads.
    run : callable
        Fills ``context.folder`` and returns figures of convergence for the manifest.
    collective : bool
        Whether every MPI rank takes part.
    """

    name: str
    version: int
    config_slice: Callable[[Case], Any]
    needs: tuple[str, ...]
    run: Callable[[StageContext], Figures]
    collective: bool = False


@dataclass(frozen=True)
class Manifest:
    """What is kept beside a stage's results."""

    stage: str
    version: int
    folder: str  # the stage and the hash over all that it depends on
    inputs: dict[str, str]  # folders of the stages that it read
    figures: dict[str, Any]
    versions: dict[str, str]
    commit: str | None
    ranks: int
    seconds: float
    peak_memory: int  # bytes, all ranks of a collective stage together
    resumed: bool  # whether an interrupted run was continued; `seconds` is then that of the last part
    finished: str  # UTC, ISO 8601
    files: dict[str, int] = field(default_factory=dict)  # sizes in bytes

    def write(self, folder: Path) -> None:
        """Write the manifest into `folder`, whole or not at all."""
        write_json(folder / MANIFEST, asdict(self))

    @classmethod
    def read(cls, folder: Path) -> Manifest:
        """Read the manifest of a complete stage and check that its files are all there, with their sizes.

        Raises
        ------
        StoreError
            Naming the file that is missing or truncated.
        """
        path = folder / MANIFEST
        try:
            manifest = cls(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError) as error:
            raise StoreError(f"{path}: missing or damaged; remove {folder} and run again") from error
        for name, size in manifest.files.items():
            file = folder / name
            if not file.is_file() or file.stat().st_size != size:
                state = "truncated or changed" if file.is_file() else "missing"
                raise StoreError(f"{file}: {state} since its stage ended; remove {folder} and run again")
        return manifest


@dataclass(frozen=True)
class StageResult:
    """A complete stage of a run."""

    name: str
    folder: Path
    manifest: Manifest
    reused: bool


def write_json(path: Path, content: object) -> None:
    """Write `content` as JSON to `path`, whole or not at all."""
    write_whole(path, (json.dumps(content, indent=2) + "\n").encode())
