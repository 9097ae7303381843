"""A diagnosis with all that it takes: meshes and reduction of specimens, kept from one to the next, and processes."""

from __future__ import annotations

import os
import re
import resource
import shutil
import tempfile
import tomllib
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from time import monotonic
from typing import TYPE_CHECKING

from fretflow.case.casefile import dump_case
from fretflow.case.config import validate_case
from fretflow.core.errors import ConfigError, InputError, StoreError, UnsupportedRecordingError
from fretflow.core.progress import Progress
from fretflow.recordings.kinds import Recorded
from fretflow.recordings.schema import FILE, name_of

if TYPE_CHECKING:
    from fretflow.case.config import Case
    from fretflow.inference.verdict import Diagnosis
    from fretflow.solvers.periodic import PeriodicProblem

MOST_LETTERS = 100  # of a case's name
MODELS = "models"  # folder of the reduced specimens, in the user's cache


def diagnose(recording: Recorded | Path | str, *, fast: bool = False,
             progress: Progress | None = None, home: Path | None = None) -> Diagnosis:
    """Say whether the model explains a recording and, if not, where they part and which physics is left out.

    Specimens are meshed and reduced for the recordings of a rig; what was reduced once is kept in the user's cache.

    Parameters
    ----------
    recording : Recorded, Path or str
        As `read_recording` returns it, or what that takes.
    fast : bool
        Fit in fewer steps and look at fewer pairs: a recording of a rig in some minutes.
    progress : callable, optional
        Takes the share that is done, 0 to 1, and what is being done.
    home : Path, optional
        Folder that the reduced specimens are kept in where the user has no cache; else a temporary one.

    Returns
    -------
    Diagnosis
        With ``verdict``, ``effects``, ``probability``, ``parameters`` (SI, 90 % intervals), ``location`` and more;
        ``to_json``, ``to_html`` and ``plot`` show it.

    Raises
    ------
    RecordingError
        If the recording cannot be used.
    NonConvergenceError
        If the baseline cannot be simulated.

    Examples
    --------
    >>> import fretflow as ff
    >>> diagnosis = ff.diagnose("my recording", fast=True)  # doctest: +SKIP
    >>> diagnosis.verdict, diagnosis.effects, diagnosis.probability  # doctest: +SKIP
    >>> diagnosis.to_html("report.html")  # doctest: +SKIP
    """
    from fretflow.experiments.tools import DiagnosisTools
    from fretflow.pipeline.ensemble import LocalPool, own_processes
    from fretflow.recordings.kinds import kinds, read_recording

    given = Path(recording) if isinstance(recording, str) else recording
    if isinstance(given, Path) and not given.exists():
        raise InputError(f"{given}: there is no such folder or file; give a folder with a {FILE}")
    began, tell = monotonic(), Stages(progress or (lambda share, text: None))
    with tempfile.TemporaryDirectory() as scratch, LocalPool(own_processes()) as pool:
        models = kept_models(Path(scratch) if home is None else home)
        tell(0.0, "reading")
        recorded = read_recording(given) if isinstance(given, Path) else given
        if not recorded.kind.experiment:
            known = sorted(kind.id for kind in kinds().values() if kind.experiment)
            raise UnsupportedRecordingError(f"{recorded.path}: test.kind {recorded.kind.id!r} has no diagnosis; there "
                                            f"is one of {', '.join(known)}")
        diagnosis: Diagnosis = resolve_name(recorded.kind.experiment)(
            recorded, fast, tell, DiagnosisTools(partial(reduced_problem, models=models), pool))
    name = name_of(given) if isinstance(given, Path) else getattr(given, "title", "")
    return replace(diagnosis, case_file=runnable(diagnosis, name), seconds=monotonic() - began, fast=fast,
                   stages=tell.ended(), memory=memory())


@dataclass
class Stages:
    """The wall time of what is told as it begins: its name, and after a colon what else there is to say."""

    tell: Progress
    spent: dict[str, float] = field(default_factory=dict)  # s
    now: tuple[str, float] = ("", 0.0)  # what is being done, and since when
    share: float = 0.0  # that is done, and stays so where fits that moved are gone through once more

    def __call__(self, share: float, text: str) -> None:
        """End what was done and tell what begins."""
        self.ended()
        self.now = (text.partition(":")[0], monotonic())
        self.share = max(self.share, share)
        self.tell(self.share, text)

    def ended(self) -> dict[str, float]:
        """Return the seconds of each stage, the last one ended."""
        text, since = self.now
        if text:
            self.spent[text] = self.spent.get(text, 0.0) + monotonic() - since
        self.now = ("", 0.0)
        return self.spent


def memory() -> tuple[float, float]:
    """Return the most memory that this process and one of its ended children had, bytes."""
    own, other = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return 1024.0 * own, 1024.0 * other


def runnable(diagnosis: Diagnosis, name: str) -> str:
    """Return the case of a diagnosis under the recording's `name`, its parameters told; none where `run` refuses it."""
    from fretflow.effects.catalogue import parse_effects, tables
    from fretflow.inference import words

    own = re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("._-")[:MOST_LETTERS] or "recorded"
    try:
        case = validate_case(tomllib.loads(diagnosis.case_file))
        effects = tables(parse_effects(case.effects))
    except (ConfigError, tomllib.TOMLDecodeError):
        return ""
    lines = ["# Fitted, with 90 % intervals:"]
    for one in diagnosis.parameters:
        shown = words.interval(one)
        lines.append(f"# {one.name} = {shown.value} ({shown.ends}) {shown.unit}".rstrip())
    return "\n".join([*lines, dump_case(case.model_copy(update={"name": own, "effects": effects}))])


def kept_models(home: Path) -> Path:
    """Return the folder where reduced specimens are kept from one diagnosis to the next: in `home` without a cache."""
    try:
        kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fretflow" / MODELS
        kept.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # the latter where the user has no home
        return made_folder(home / MODELS)
    return kept if os.access(kept, os.W_OK) else made_folder(home / MODELS)


def reduced_problem(case: Case, models: Path) -> PeriodicProblem:
    """Return the unworn problem of a case, its specimens meshed and reduced unless `models` has them."""
    from fretflow.pipeline.problem import make_problem
    from fretflow.pipeline.ranks import Ranks
    from fretflow.pipeline.runner import Runner, Silent
    from fretflow.pipeline.stage import Manifest
    from fretflow.pipeline.stages import pipeline

    with tempfile.TemporaryDirectory(dir=models) as scratch:
        runner = Runner(pipeline(), Path(scratch), Ranks(together=False), Silent())
        key = runner.keys(case)["reduce"]
        kept = models / key
        if kept.is_dir():
            try:
                Manifest.read(kept, f"reduce-{key}")
            except StoreError:  # made again, which takes seconds
                shutil.rmtree(kept, ignore_errors=True)
        if not kept.is_dir():
            try:
                made = runner.run(case, "reduce")["reduce"].folder
            except StoreError as error:
                raise StoreError(f"{models}: the reduced specimens cannot be kept there; free some space, or name "
                                 "another folder by XDG_CACHE_HOME") from error
            try:
                made.rename(kept)
            except OSError:
                if not kept.is_dir():  # else another process was first
                    raise
        return make_problem(case, kept)


def made_folder(path: Path) -> Path:
    """Make the folder `path` where there is none, and return it.

    Raises
    ------
    InputError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror}); name another folder") from error
    return path
