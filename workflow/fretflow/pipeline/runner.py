"""The runner: each stage once, kept in a folder named after all that it depends on.

A stage works in ``<name>-<hash>.partial``, which is renamed to ``<name>-<hash>`` when complete. So a folder
without the suffix is always whole, an unchanged stage is reused, and an interrupted one finds its own
checkpoints again.
"""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from fretflow.case.casefile import dump_case
from fretflow.case.config import Case, slice_hash
from fretflow.core.errors import InputError, NonConvergenceError, StoreError, did_you_mean
from fretflow.core.plugins import FIGURES, provided
from fretflow.core.provenance import CostMeter, commit, versions
from fretflow.core.store import write_csv, write_whole
from fretflow.pipeline.estimate import check_memory
from fretflow.pipeline.problem import check_effects
from fretflow.pipeline.ranks import Ranks
from fretflow.pipeline.run_folder import holding
from fretflow.pipeline.stage import (
    CASE_FILE,
    RUN_FILE,
    SUMMARY_FILE,
    Figures,
    Manifest,
    Stage,
    StageContext,
    StageResult,
    case_sum,
    sums_of,
    write_json,
)

PARTIAL = ".partial"
REPLACED = ".replaced"
HISTORY_FILE = "residual_history.csv"


class Watcher(Protocol):
    """Is told how a run goes on."""

    def begin(self, stage: str) -> None:
        """Note that `stage` starts computing."""

    def advance(self, stage: str, share: float, text: str) -> None:
        """Note that `share` (0 to 1) of `stage` is done."""

    def note(self, stage: str, text: str) -> None:
        """Pass on one line about `stage`."""

    def end(self, result: StageResult) -> None:
        """Note that a stage is complete, computed or reused."""


class Silent:
    """Watches a run without a word, but for what its user has to know."""

    def begin(self, stage: str) -> None:
        """Note that `stage` starts computing."""

    def advance(self, stage: str, share: float, text: str) -> None:
        """Note that `share` (0 to 1) of `stage` is done."""

    def note(self, stage: str, text: str) -> None:
        """Pass on one line about `stage` as a warning."""
        warnings.warn(f"{stage}: {text}", stacklevel=2)

    def end(self, result: StageResult) -> None:
        """Note that a stage is complete, computed or reused."""


@dataclass(frozen=True)
class _StageTask:
    """A collective stage as handed to the other ranks."""

    stage: str
    case: Case
    folder: Path
    inputs: dict[str, Path]


class Runner:
    """Runs the stages of a pipeline, in order, for one case after the other.

    Parameters
    ----------
    stages : sequence of Stage
        Ordered so that each comes after those that it needs.
    root : Path
        Results go to ``root/<case name>``.
    ranks : Ranks
        The processes of the run.
    watcher : Watcher
        Told about the progress.
    """

    def __init__(self, stages: Sequence[Stage], root: Path, ranks: Ranks, watcher: Watcher) -> None:
        self._stages = tuple(stages)
        self._root = root
        self._ranks = ranks
        self._watcher = watcher

    def select(self, until: str | None) -> tuple[Stage, ...]:
        """Return the stages up to and including `until`, or all.

        Raises
        ------
        InputError
            If there is no such stage.
        """
        if until is None:
            return self._stages
        names = [stage.name for stage in self._stages]
        if until not in names:
            raise InputError(f"--until {until}: no such stage; choose one of {', '.join(names)}"
                             f"{did_you_mean(until, names)}")
        return self._stages[:names.index(until) + 1]

    def run(self, case: Case, until: str | None = None, force: bool = False) -> dict[str, StageResult]:
        """Run `case` up to and including `until`, and return the result of each stage.

        Raises
        ------
        InputError
            If the input or the output folder cannot be used.
        NonConvergenceError
            With the residual history, also kept in the stage's partial folder.
        """
        stages = self.select(until)
        check_memory(case, [stage.name for stage in stages])
        check_effects(case)
        if case.output.figures:
            provided(FIGURES, "names")(case.output)
        home = self._root / case.name
        results: dict[str, StageResult] = {}
        with holding(home):
            keys = self.keys(case)
            _drop_summary(home, case)
            for stage in stages:
                folder = home / f"{stage.name}-{keys[stage.name]}"
                results[stage.name] = self._obtain(stage, case, folder, results, force)
                self._watcher.end(results[stage.name])
                _note_run(home, case, keys)
        return results

    def keys(self, case: Case) -> dict[str, str]:
        """Return the hash of each stage: over its version, its slice of the case and its inputs' hashes."""
        keys: dict[str, str] = {}
        for stage in self._stages:
            inputs = {name: keys[name] for name in stage.needs}
            keys[stage.name] = slice_hash(stage.name, stage.version, stage.config_slice(case), inputs)
        return keys

    def serve(self) -> None:
        """On ranks other than 0: take part in collective stages until rank 0 has finished."""
        by_name = {stage.name: stage for stage in self._stages}

        def work(task: _StageTask) -> int:
            context = StageContext(task.case, task.folder, task.inputs, lambda share, text: None,
                                   self._ranks.comm)
            with CostMeter() as cost:
                by_name[task.stage].run(context)
            return cost.peak_memory

        self._ranks.serve(work)

    def _obtain(self, stage: Stage, case: Case, folder: Path, results: dict[str, StageResult],
                force: bool) -> StageResult:
        partial = folder.with_name(folder.name + PARTIAL)
        if force:
            shutil.rmtree(partial, ignore_errors=True)
        elif folder.exists():
            try:
                manifest = Manifest.read(folder)
                manifest.check_inputs(folder, {name: results[name].manifest for name in stage.needs})
            except StoreError as error:
                self._watcher.note(stage.name, f"{str(error).removesuffix('; run again')}; it is computed again")
            else:
                return StageResult(stage.name, folder, manifest, reused=True)
        resumed = partial.exists()
        partial.mkdir(exist_ok=True)
        (partial / HISTORY_FILE).unlink(missing_ok=True)
        self._watcher.begin(stage.name)
        folders = {name: results[name].folder for name in stage.needs}
        try:
            figures, cost, memory = self._compute(stage, case, partial, folders)
        except NonConvergenceError as error:
            _keep_history(partial, error, list(results.values()))
            raise
        sizes, sums = sums_of(partial)
        manifest = Manifest(
            stage=stage.name, version=stage.version, folder=folder.name,
            inputs={name: path.name for name, path in folders.items()}, figures=dict(figures),
            versions=versions(), commit=commit(), ranks=self._ranks.size if stage.collective else 1,
            seconds=round(cost.seconds, 3), peak_memory=memory, resumed=resumed,
            finished=datetime.now(UTC).isoformat(timespec="seconds"), files=sizes, sums=sums,
            input_sums={name: results[name].manifest.sum for name in stage.needs})
        manifest.write(partial)
        _promote(partial, folder)
        return StageResult(stage.name, folder, manifest, reused=False)

    def _compute(self, stage: Stage, case: Case, partial: Path,
                 inputs: dict[str, Path]) -> tuple[Figures, CostMeter, int]:
        together = stage.collective and self._ranks.size > 1
        figures: Figures = {}

        def work() -> int:
            nonlocal figures
            with cost:
                figures = stage.run(context)
            return cost.peak_memory

        cost = CostMeter()
        context = StageContext(
            case, partial, inputs, lambda share, text: self._watcher.advance(stage.name, share, text),
            self._ranks.comm if together else None)
        if together:
            memory = self._ranks.lead(_StageTask(stage.name, case, partial, inputs), work)
        else:
            memory = work()
        return figures, cost, memory


def _promote(partial: Path, folder: Path) -> None:
    """Rename `partial` to `folder`, putting a former `folder` aside until that is done."""
    replaced = folder.with_name(folder.name + REPLACED)
    shutil.rmtree(replaced, ignore_errors=True)
    if folder.exists():
        folder.rename(replaced)
    partial.rename(folder)
    shutil.rmtree(replaced, ignore_errors=True)


def _keep_history(partial: Path, error: NonConvergenceError, complete: Sequence[StageResult]) -> None:
    """Write the history, if there is one, and name what the stage left, or the stage before where it left nothing."""
    if error.last_good is None and any(partial.iterdir()):
        error.last_good = partial
    elif error.last_good is None and complete:
        error.last_good = complete[-1].folder
    if not error.history:  # not even the first residual was found
        return
    history = {"iteration": range(len(error.history)), "relative_residual": error.history}
    write_csv(partial / HISTORY_FILE, history)
    error.history_file = partial / HISTORY_FILE


def _note_run(home: Path, case: Case, keys: dict[str, str]) -> None:
    """Write which folders are complete for this case, and the case itself."""
    complete = {name: f"{name}-{key}" for name, key in keys.items() if (home / f"{name}-{key}").is_dir()}
    write_whole(home / CASE_FILE, dump_case(case).encode())
    write_json(home / RUN_FILE, {"case": case.name, "case_sum": case_sum(case), "stages": complete})


def _drop_summary(home: Path, case: Case) -> None:
    """Remove a summary that is not of `case`: a run that fails would leave it beside what it does not describe."""
    path = home / SUMMARY_FILE
    try:
        same = json.loads(path.read_text(encoding="utf-8"))["case_sum"] == case_sum(case)
    except FileNotFoundError:
        return
    except (OSError, ValueError, KeyError, TypeError):
        same = False
    if not same:
        path.unlink()
