"""Seals that cannot be changed without notice, and a trial that keeps its answers from those who are tried."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fretflow.cli import execute
from fretflow_trial.lifeline import TIED
from fretflow_trial.protocol import DIAGNOSE, Settings, Trial, TrialError, load, save, scrubbed
from fretflow_trial.sealing import BrokenSealError, Seal, canonical, commitment, seal, secret_of, unseal, verify

PATIENCE = 60.0  # s
SECRET = bytes(range(32))
KEY = {"kind": "single", "effects": ["viscous"], "catalogue_laws": True, "hidden": [
    {"id": "viscous", "blocks": ["rig"], "parameters": {"damping": 300.0}, "signal_to_noise": 12.0,
     "total_signal_to_noise": 900.0}], "channels": ["displacement"],
    "baseline": {"friction_coefficient": 0.8, "wear_coefficient": 1e-14, "moving_mass": 10.1}}
NOTHING = {**KEY, "kind": "nothing", "effects": [], "hidden": []}

# Stands in for `fretflow diagnose`: says "viscous" and writes down all that it can see.
STUB = """
import json, os, pathlib, sys
folder, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[3])
seen = {"environment": dict(os.environ), "here": os.listdir(), "beside": sorted(os.listdir(folder.parent)),
        "files": sorted(os.listdir(folder)), "fast": "--fast" in sys.argv, "name": folder.name}
if (folder / "bad.csv").exists():
    sys.exit("fretflow: loops.csv: damaged")
report = pathlib.Path(sys.argv[sys.argv.index("--out") + 1]) / "report.html"
report.parent.mkdir()
report.write_text("page of " + sys.argv[3])
out.write_text(json.dumps({
    "verdict": "named", "effects": ["viscous"], "probability": 0.9, "ranking": [], "parameters": {}, "fit": {},
    "detection": {"p_value": 0.0, "statistic": json.dumps(seen)}, "separating_measurement": "",
    "location": {"block": "rig", "channel": "", "phase": "", "cycles": [0, 1], "zone": ""}}))
"""


@pytest.fixture
def trial(tmp_path: Path) -> Trial:
    """Return a trial whose three recordings are made, the last one damaged."""
    stub = tmp_path / "stub.py"
    stub.write_text(STUB)
    lines: list[str] = []
    made = Trial(Settings(3, 77, True), tmp_path / "trial", 2, (sys.executable, str(stub)), lines.append)
    for k, key in enumerate((KEY, NOTHING, KEY)):
        name = f"case-{k:03d}"
        folder = made.out / "recordings" / name
        folder.mkdir(parents=True)
        (folder / ("bad.csv" if k == 2 else "loops.csv")).write_text("")
        closed = seal(key, made._secret, name)
        save(made.out / "sealed" / f"{name}.json", {"commitment": closed.commitment, "box": closed.box.hex()})
    return made


def test_seal_opens_with_its_secret_only() -> None:
    closed = seal(KEY, SECRET, "case-000")
    salt, key = unseal(closed, SECRET, "case-000")
    assert key == KEY
    assert closed.commitment == commitment(bytes.fromhex(salt), canonical(KEY))
    verify(salt, key, closed.commitment)
    for secret, name in ((bytes(32), "case-000"), (SECRET, "case-001")):
        with pytest.raises(BrokenSealError, match="not the one that was sealed"):
            unseal(closed, secret, name)


def test_seal_hides_its_key_and_differs_each_time() -> None:
    first, second = (seal(KEY, SECRET, "case-000") for _ in range(2))
    assert first.commitment != second.commitment
    assert b"viscous" not in first.box


@pytest.mark.parametrize("place", [0, 20, -1])
def test_changed_seal_is_noticed(place: int) -> None:
    closed = seal(KEY, SECRET, "case-000")
    box = bytearray(closed.box)
    box[place] ^= 1
    with pytest.raises(BrokenSealError):
        unseal(Seal(closed.commitment, bytes(box)), SECRET, "case-000")


def test_another_key_does_not_fit_the_published_hash() -> None:
    closed = seal(KEY, SECRET, "case-000")
    salt, _ = unseal(closed, SECRET, "case-000")
    with pytest.raises(BrokenSealError, match="published"):
        verify(salt, NOTHING, closed.commitment)


def test_secrets_differ_by_seed() -> None:
    assert secret_of(1, "a") == secret_of(1, "a") != secret_of(2, "a")


def seen_by(trial: Trial, name: str) -> dict[str, Any]:
    diagnosis = load(trial.out / "answers" / f"{name}.json")["diagnosis"]
    statistic: dict[str, Any] = json.loads(diagnosis["detection"]["statistic"])
    return statistic


def test_diagnosis_sees_its_recording_and_nothing_else(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRETFLOW_TRIAL_KEY", "viscous")
    trial.run()
    seen = seen_by(trial, "case-000")
    assert set(seen["environment"]) - {"LC_CTYPE"} == set(scrubbed(Path("/"), Path("/")))
    assert seen["here"] == []
    assert seen["beside"] == ["home", "recording"]
    assert (seen["files"], seen["name"], seen["fast"]) == (["loops.csv"], "recording", True)
    assert str(trial.out) not in json.dumps(seen)
    assert DIAGNOSE[1] == "-I"


def test_trial_publishes_hashes_first_and_keys_last(trial: Trial) -> None:
    scores = trial.run()
    lines = trial.say.__self__  # type: ignore[attr-defined]
    hashes = load(trial.out / "seals.json")
    first = {name: next(k for k, line in enumerate(lines) if published in line) for name, published in hashes.items()}
    diagnosed = [k for k, line in enumerate(lines) if line.startswith("diagnosed")]
    opened = [k for k, line in enumerate(lines) if line.endswith("viscous")]
    told = next(k for k, line in enumerate(lines) if line == "diagnosing 3 of 3, some minutes each")
    assert max(first.values()) < told < min(diagnosed) <= max(diagnosed) < min(opened)
    for name, published in hashes.items():
        stored = load(trial.out / "keys" / f"{name}.json")
        verify(stored["salt"], stored["key"], published)
    assert scores["verdicts"]["single"] == {"none": 0, "named": 1, "ambiguous": 0, "unknown": 0, "failed": 1}
    assert scores["verdicts"]["nothing"]["named"] == 1
    assert "damaged" in scores["cases"][2]["failure"]
    assert load(trial.out / "trial.json")["settings"]["seed"] == 77
    page = (trial.out / "trial.html").read_text()
    assert "case-002" in page
    assert 'href="reports/case-002.html"' not in page  # that diagnosis failed
    assert 'href="reports/case-000.html"' in page
    assert (trial.out / "reports" / "case-000.html").read_text().startswith("page of")


def test_nothing_in_the_clear_before_the_end(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(self: Trial, names: list[str]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Trial, "_score", stopped)
    with pytest.raises(KeyboardInterrupt):
        trial.run()
    for file in trial.out.rglob("*"):
        if file.is_file() and file.parent.name != "answers":
            text = file.read_text()
            assert "viscous" not in text
            assert '"seed": 77' not in text
    monkeypatch.undo()
    (trial.out / "answers" / "case-001.json").unlink()
    before = (trial.out / "answers" / "case-000.json").stat().st_mtime_ns
    trial.run()
    assert (trial.out / "answers" / "case-000.json").stat().st_mtime_ns == before
    assert (trial.out / "trial.html").exists()


def test_trial_notices_a_changed_answer(trial: Trial) -> None:
    other = seal(NOTHING, trial._secret, "case-000")
    trial.run()
    save(trial.out / "sealed" / "case-000.json", {"commitment": load(trial.out / "seals.json")["case-000"],
                                                  "box": other.box.hex()})
    with pytest.raises(BrokenSealError, match="case-000"):
        trial.run()


def test_trial_notices_a_whole_new_seal(trial: Trial) -> None:
    trial.run()
    other = seal(NOTHING, trial._secret, "case-000")
    save(trial.out / "sealed" / "case-000.json", {"commitment": other.commitment, "box": other.box.hex()})
    with pytest.raises(BrokenSealError, match="changed"):
        trial.run()


def test_folder_holds_one_trial(trial: Trial) -> None:
    trial.run()
    with pytest.raises(TrialError, match="--out"):
        Trial(Settings(3, 78, True), trial.out).run()


def test_command_refuses_no_cases(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["trial", "--cases", "0", "--out", str(tmp_path)]) == 2
    assert "--cases" in capsys.readouterr().err


def test_command_carries_out_what_is_left(trial: Trial, capsys: pytest.CaptureFixture[str],
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    trial.run()
    monkeypatch.setattr("fretflow_trial.protocol.tied_processes", lambda *_: pytest.fail("made again"))
    assert execute(["trial", "--cases", "3", "--seed", "77", "--fast", "--out", str(trial.out)]) == 0
    out = capsys.readouterr().out
    assert "right name" in out
    assert "trial.html" in out


# A trial whose recordings are there and whose diagnoses, or makers, tell their ids and then work for ever.
LASTING = """
import os, pathlib, sys, time
from fretflow.cli import app, main
from fretflow_trial import protocol
from fretflow_trial.lifeline import tied_processes

def last(pids):
    pathlib.Path(pids, str(os.getpid())).touch()
    time.sleep(600.0)

def carry_out(out, stub, pids):
    if stub == "makers":
        with tied_processes(2) as workers:
            list(workers.map(last, [pids] * 2))
    protocol.Trial(protocol.Settings(3, 77, True), pathlib.Path(out), 2, (sys.executable, "-I", "-c", stub, pids)).run()

if __name__ == "__main__":
    app.command(carry_out)
    sys.argv.insert(1, "carry-out")
    main()
"""
WORKER = TIED + """
import pathlib, sys, time
pathlib.Path(sys.argv[1], str(os.getpid())).touch()
time.sleep(600.0)
"""


@pytest.mark.parametrize(("work", "how"), [
    ("diagnoses", signal.SIGKILL), ("diagnoses", signal.SIGTERM), ("makers", signal.SIGKILL)])
def test_a_trial_that_ends_leaves_no_workers(trial: Trial, tmp_path: Path, work: str, how: signal.Signals) -> None:
    (tmp_path / "lasting.py").write_text(LASTING)
    pids = tmp_path / "pids"
    pids.mkdir()
    command = [sys.executable, tmp_path / "lasting.py", trial.out, WORKER if work == "diagnoses" else "makers", pids]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            assert in_time(lambda: len(list(pids.iterdir())) == 2)
            process.send_signal(how)
            assert process.wait(PATIENCE) != 0
            assert in_time(lambda: not any(alive(file.name) for file in pids.iterdir()))
        finally:
            process.kill()
    assert not list(trial.out.glob("answers/*"))  # so that the same command goes on with them


def in_time(condition: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + PATIENCE
    while not (met := condition()) and time.monotonic() < deadline:
        time.sleep(0.05)
    return met


def alive(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


STARTING = """
import os, signal, time
from fretflow_trial.lifeline import tied_processes

if __name__ == "__mp_main__":
    print("starts", flush=True)
    time.sleep(2.0)  # what it imports
if __name__ == "__main__":
    try:
        with tied_processes(2) as workers:
            list(workers.map(abs, [1, 2]))
    except BaseException:
        pass
"""


def test_makers_interrupted_while_they_start_say_nothing(tmp_path: Path) -> None:
    (tmp_path / "starting.py").write_text(STARTING)
    with subprocess.Popen([sys.executable, tmp_path / "starting.py"], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True, start_new_session=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        os.killpg(process.pid, signal.SIGINT)
        _, error = process.communicate(timeout=PATIENCE)
    assert error == ""
