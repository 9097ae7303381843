"""A trial: make concealed recordings, seal the answers, have them diagnosed, open the seals, score.

In the trial's folder ``recordings/case-000`` holds what is diagnosed and ``sealed/case-000.json`` hash and box of its
answer. ``reports`` (the page of each diagnosis), ``answers`` and, in the end, ``keys`` (salt and key in the clear),
``trial.json`` and ``trial.html`` follow. Whatever is there is not done again, so that an interrupted trial goes on.
Each diagnosis is a process of its own, with a copy of its recording, an empty home and working directory, and an
environment of four variables.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import IO, Any

from fretflow_trial.answers import Answer, Key
from fretflow_trial.case import compose, key, simulate
from fretflow_trial.lifeline import INTERRUPTED, TIED, tied_processes
from fretflow_trial.page import page
from fretflow_trial.record import write
from fretflow_trial.scoring import Result, scoreboard
from fretflow_trial.sealing import BrokenSealError, Seal, seal, secret_of, unseal, verify

FORMAT = "fretflow-trial/1"
# In isolated mode Python reads no variables and nothing from the working directory.
DIAGNOSE = (sys.executable, "-I", "-c", f"{TIED}from fretflow.cli import main; main()", "diagnose")
TITLE = "Fretting rig, flat on flat"
LONGEST = 3 * 3600.0  # s, of one diagnosis
EACH = {True: "some minutes", False: "up to half an hour"}  # by --fast: what a diagnosis takes of two cores

Say = Callable[[str], None]


class TrialError(RuntimeError):
    """A trial cannot go on; the message says why and what to do."""


@dataclass(frozen=True)
class Settings:
    """What a trial is; a folder holds one."""

    cases: int
    seed: int
    fast: bool
    world: int | None = None  # of all cases; None: drawn for each
    format: str = FORMAT


@dataclass(frozen=True)
class Trial:
    """A trial in a folder, and how it is carried out."""

    settings: Settings
    out: Path
    jobs: int = 1
    command: Sequence[str] = DIAGNOSE
    say: Say = field(default=lambda line: None)
    facts: dict[str, str] = field(default_factory=dict)  # versions, commit: kept with the scores

    def run(self) -> dict[str, Any]:
        """Carry out whatever is left of the trial and return its scores.

        Raises
        ------
        TrialError
            If the folder holds another trial.
        BrokenSealError
            If an answer is not the one that was sealed.
        """
        self._claim()
        names = [f"case-{k:03d}" for k in range(self.settings.cases)]
        self._make(names)
        hashes = self._publish({name: self._sealed(name).commitment for name in names})
        self.say("sealed answers, SHA-256 of salt and key:")
        for name, published in hashes.items():
            self.say(f"  {name}  {published}")
        self._diagnose(names)
        return self._score(names)

    def _publish(self, hashes: dict[str, str]) -> dict[str, str]:
        """Keep the hashes, which no later run may change."""
        file = self.out / "seals.json"
        if file.exists() and load(file) != hashes:
            raise BrokenSealError(f"{file}: has other hashes than the sealed answers; one of them was changed")
        save(file, hashes)
        return hashes

    def _claim(self) -> None:
        self.out.mkdir(parents=True, exist_ok=True)
        file, mine = self.out / "settings.json", {**asdict(self.settings), "seed": self._secret.hex()[:16]}
        if file.exists():
            there = load(file)
            if there != mine:
                raise TrialError(f"{self.out}: holds a trial with other cases, seed or settings; give this one its own "
                                 "folder with --out")
        else:
            save(file, mine)

    @cached_property
    def _secret(self) -> bytes:
        return secret_of(self.settings.seed, f"{FORMAT} {self.settings.cases}")

    def _sealed(self, name: str) -> Seal:
        stored = load(self.out / "sealed" / f"{name}.json")
        return Seal(stored["commitment"], bytes.fromhex(stored["box"]))

    def _make(self, names: Sequence[str]) -> None:
        left = [k for k, name in enumerate(names) if not (self.out / "sealed" / f"{name}.json").exists()]
        done = len(names) - len(left)
        if not left:
            return
        with tied_processes(self.jobs) as workers:
            tasks = [(self.out, names[k], self.settings, k, self._secret) for k in left]
            for name, _ in each(workers, make_one, tasks):
                done += 1
                self.say(f"made {name} ({done}/{len(names)})")

    def _diagnose(self, names: Sequence[str]) -> None:
        left = [name for name in names if not (self.out / "answers" / f"{name}.json").exists()]
        done, started = len(names) - len(left), time.monotonic()
        if left:
            self.say(f"diagnosing {len(left)} of {len(names)}, {EACH[self.settings.fast]} each")
        reading, writing = os.pipe()
        with (tempfile.TemporaryDirectory(prefix="cache-") as cache, open(reading, "rb") as line,
              ThreadPoolExecutor(self.jobs) as workers, open(writing, "wb")):  # closed before workers are waited for
            tasks = [(self.out, name, tuple(self.command), self.settings.fast, Path(cache), line) for name in left]
            for k, (name, seconds) in enumerate(each(workers, diagnose_one, tasks), 1):
                ahead = (time.monotonic() - started) / k * (len(left) - k)
                self.say(f"diagnosed {name} in {seconds:.0f} s ({done + k}/{len(names)}, {ahead / 60.0:.0f} min left)")

    def _score(self, names: Sequence[str]) -> dict[str, Any]:
        self.say("opened seals, salt and hidden effects; whole keys in keys/:")
        results = []
        for name in names:
            closed = self._sealed(name)
            salt, opened = unseal(closed, self._secret, name)
            published = load(self.out / "seals.json")[name]
            verify(salt, opened, published)
            save(self.out / "keys" / f"{name}.json", {"salt": salt, "commitment": published, "key": opened})
            hidden = ", ".join(one["id"] for one in opened["hidden"]) or "nothing"
            self.say(f"  {name}  {salt}  {hidden}")
            results.append(Result(name, Key.read(opened), self._answer(name)))
        scores = {"format": FORMAT, "settings": asdict(self.settings), "facts": self.facts, **scoreboard(results)}
        save(self.out / "trial.json", scores)
        write_whole(self.out / "trial.html", page(scores))
        return scores

    def _answer(self, name: str) -> Answer:
        stored = load(self.out / "answers" / f"{name}.json")
        if stored["diagnosis"] is None:
            return Answer.failed(stored["failure"], stored["seconds"])
        try:
            return Answer.read(stored["diagnosis"], stored["seconds"])
        except ValueError as error:
            return Answer.failed(str(error), stored["seconds"])


def make_one(out: Path, name: str, settings: Settings, place: int, secret: bytes) -> str:
    """Make the recording of one case and seal its answer; return its name."""
    kind, effects, own, world = compose(settings.cases, settings.seed, settings.world)[place]
    simulated = simulate(kind, effects, own, world)
    folder = out / "recordings" / name
    with tempfile.TemporaryDirectory(dir=out) as scratch:
        written = write(simulated, Path(scratch) / name, TITLE)
        folder.parent.mkdir(exist_ok=True)
        shutil.rmtree(folder, ignore_errors=True)
        written.rename(folder)
    closed = seal(key(simulated), secret, name)
    save(out / "sealed" / f"{name}.json", {"commitment": closed.commitment, "box": closed.box.hex()})
    return name


def diagnose_one(out: Path, name: str, command: Sequence[str], fast: bool, cache: Path, line: IO[bytes]) -> float:
    """Diagnose one recording in a process that sees nothing but a copy of it; return the seconds it took.

    The folder `cache` keeps what does not depend on the recording; the process ends where its stdin, `line`, does.

    Raises
    ------
    TrialError
        If it was interrupted, which says nothing about the recording.
    """
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="recording-") as scratch:
        home = Path(scratch) / "home"
        home.mkdir()
        shutil.copytree(out / "recordings" / name, Path(scratch) / "recording")
        json_file, failure = Path(scratch) / "diagnosis.json", ""
        full = [*command, str(Path(scratch) / "recording"), "--json", str(json_file), "--out",
                str(Path(scratch) / "results"), *(["--fast"] if fast else [])]
        try:
            run = subprocess.run(full, cwd=home, env=scrubbed(home, cache), capture_output=True, text=True,
                                 check=False, timeout=LONGEST, stdin=line)
            if run.returncode == INTERRUPTED:
                raise TrialError(f"{name}: its diagnosis was interrupted; the same command goes on")
            lines = run.stderr.strip().splitlines()
            failure = "" if run.returncode == 0 else f"exit code {run.returncode}: {lines[-1] if lines else ''}"
        except subprocess.TimeoutExpired:
            failure = f"not done after {LONGEST:.0f} s"
        diagnosis = None
        if not failure:
            try:
                diagnosis = load(json_file)
            except (OSError, ValueError) as error:
                failure = f"wrote no JSON: {error}"
        report = Path(scratch) / "results" / "report.html"
        if report.exists():
            write_whole(out / "reports" / f"{name}.html", report.read_text(encoding="utf-8"))
    seconds = time.monotonic() - started
    save(out / "answers" / f"{name}.json", {"seconds": seconds, "failure": failure, "diagnosis": diagnosis})
    return seconds


def scrubbed(home: Path, cache: Path) -> dict[str, str]:
    """Return the whole environment of a diagnosing process."""
    return {"PATH": os.defpath, "HOME": str(home), "XDG_CACHE_HOME": str(cache), "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1"}


def each(workers: Executor, work: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Iterator[tuple[str, Any]]:
    """Yield name (a task's second argument) and result of each task as it ends; an error stops what has not begun."""
    running = {workers.submit(work, *task): str(task[1]) for task in tasks}
    try:
        while running:
            for ended in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(ended), ended.result()
    except BaseException:  # also where the user interrupts
        workers.shutdown(wait=False, cancel_futures=True)
        raise


def save(file: Path, content: Any) -> None:
    """Write JSON to `file` at once."""
    write_whole(file, json.dumps(content, indent=1) + "\n")


def write_whole(file: Path, text: str) -> None:
    """Write `text` to `file` so that it is there as a whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f".{file.name}.{os.getpid()}")
    part.write_text(text, encoding="utf-8")
    part.replace(file)


def load(file: Path) -> Any:
    """Read JSON from `file`."""
    return json.loads(file.read_text(encoding="utf-8"))
