"""What a stage is, what it is given and what is kept of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fretflow.case.casefile import dump_case
from fretflow.case.config import Case
from fretflow.core.errors import StoreError
from fretflow.core.progress import Progress
from fretflow.core.store import write_whole

MANIFEST = "manifest.json"
RUN_FILE = "run.json"
CASE_FILE = "case.toml"
SUMMARY_FILE = "summary.json"
CHECKPOINTS = "checkpoints"  # of the wear stage, the period at each asked cycle count

Figures = Mapping[str, float | int | str | None]


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
    """What is kept beside a stage's results.

    SHA-256 sums tell results that were changed afterwards, and those of another run, from its own.
    """

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
    sums: dict[str, str] = field(default_factory=dict)  # of each file
    input_sums: dict[str, str] = field(default_factory=dict)  # of all files of each stage that it read

    @property
    def sum(self) -> str:
        """Return one sum over all files, equal for equal results."""
        return _sum(json.dumps(self.sums, sort_keys=True).encode())

    def write(self, folder: Path) -> None:
        """Write the manifest and its own sum into `folder`, whole or not at all."""
        write_json(folder / MANIFEST, asdict(self) | {"manifest_sum": self._own_sum()})

    def _own_sum(self) -> str:
        return _sum(json.dumps(asdict(self), sort_keys=True).encode())

    @classmethod
    def read(cls, folder: Path, name: str | None = None) -> Manifest:
        """Read the manifest of the complete stage in `folder`, made under `name`, and check that all files are its own.

        Raises
        ------
        StoreError
            Naming the file that is missing, truncated, changed or of another stage.
        """
        path = folder / MANIFEST
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            own = content.pop("manifest_sum", None)
            manifest = cls(**content)
            whole = own == manifest._own_sum() and manifest.files.keys() == manifest.sums.keys()
        except (OSError, ValueError, TypeError, AttributeError) as error:
            raise StoreError(f"{path}: missing or damaged; run again") from error
        if not whole:
            raise StoreError(f"{path}: damaged, or of a version without SHA-256 sums; run again")
        if manifest.folder != (name or folder.name):
            raise StoreError(f"{folder}: holds the results of {manifest.folder}; run again")
        for file, size in manifest.files.items():
            _check_file(folder / file, size, manifest.sums[file])
        return manifest

    def check_inputs(self, folder: Path, read: Mapping[str, Manifest]) -> None:
        """Check that the stage in `folder` has read the results that are there now, as `read` has them.

        Raises
        ------
        StoreError
            Naming the stage whose results are others now.
        """
        for name, there in read.items():
            if self.inputs.get(name) != there.folder or self.input_sums.get(name) != there.sum:
                raise StoreError(f"{folder}: was made from other results of the stage {name} than are there; run again")


def sums_of(folder: Path) -> tuple[dict[str, int], dict[str, str]]:
    """Return size in bytes and SHA-256 sum of each file in `folder`, hidden ones left out."""
    files = {str(path.relative_to(folder)): path for path in sorted(folder.rglob("*"))
             if path.is_file() and not path.name.startswith(".")}
    return {name: path.stat().st_size for name, path in files.items()}, {
        name: sum_of(path) for name, path in files.items()}


def case_sum(case: Case) -> str:
    """Return the SHA-256 sum of `case` as it is written into its run's folder."""
    return _sum(dump_case(case).encode())


def _check_file(file: Path, size: int, expected: str) -> None:
    if not file.is_file():
        raise StoreError(f"{file}: missing since its stage ended; run again")
    try:
        same = file.stat().st_size == size and sum_of(file) == expected
    except OSError as error:
        raise StoreError(f"{file}: cannot be read ({error.strerror}); run again") from error
    if not same:
        raise StoreError(f"{file}: truncated or changed since its stage ended; run again")


def sum_of(path: Path) -> str:
    """Return the SHA-256 sum of the file `path`."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def _sum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


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
