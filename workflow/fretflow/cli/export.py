"""The export command: a run as a recording."""

from __future__ import annotations

from pathlib import Path

from fretflow.cli.terminal import Json, keep_json, say_line, show_files


def export(run: Path, /, *, to: Path | None = None, noise: float = 0.0, json: Json = None) -> None:
    """Write a run's loops and wear as a recording, which `loops` reads and `diagnose` explains.

    Parameters
    ----------
    run
        result folder of a case, for example runs/test1
    to
        folder of the recording; by default RUN/recording
    noise
        of displacement and force, as a share of half their range, such as 0.005; with it each loop is drawn three
        times, which a diagnosis needs
    """
    from fretflow.pipeline.results import RunResults

    folder = run / "recording" if to is None else to
    files = RunResults.of(run).to_recording(folder, noise)
    show_files([*files, *keep_json(json, {"recording": str(folder), "files": list(map(str, files))})], "recording")
    say_line(f"`fretflow loops {folder}` reads it, and `fretflow diagnose {folder}` explains it")
