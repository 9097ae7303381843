"""The trial command: concealed recordings made, diagnosed and scored.

Here are what is asked for, the lines of progress, and how errors reach the user.

The trial's package shares nothing with the rest and diagnoses through the command line alone; it is imported here and
nowhere else.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from fretflow.cli.terminal import Flag, Json, Terminal, keep_json, new_table, say_line, show_files
from fretflow.core.errors import FretflowError, InputError
from fretflow.core.provenance import commit, versions


def trial(
    *, cases: int = 20, seed: int = 0, fast: Flag = False, jobs: int = 1, world: Literal[1, 2, 3, 4] | None = None,
    out: Path = Path("runs/trial"), json: Json = None,
) -> None:
    """Try `diagnose` on recordings whose hidden physics it cannot know, and write the scoreboard.

    The recordings come from a second simulator that shares nothing with the rest. Their answers are sealed (a salted
    hash is printed first, salt and key in the end), every diagnosis is a process of its own that sees one recording
    only, and OUT holds trial.html, trial.json and all answers. A trial that is stopped goes on with the same command.

    Parameters
    ----------
    cases
        number of recordings: a fifth with nothing hidden, a fifth with physics beyond the catalogue, a fifth with two
        effects, the rest with one
    seed
        which recordings
    fast
        diagnose with `--fast`
    jobs
        recordings made or diagnosed at a time
    world
        where all recordings are from: 1, one rig and the catalogue's laws; 2, that rig, laws of other published forms;
        3, specimens, mesh, integrator, rig, channels and noise drawn anew for each, the catalogue's laws; 4, all drawn
        anew. By default each recording is from any
    out
        folder of the trial
    """
    from fretflow_trial.protocol import Settings, Trial, TrialError
    from fretflow_trial.sealing import BrokenSealError

    for name, value, least in (("cases", cases, 1), ("jobs", jobs, 1), ("seed", seed, 0)):
        if value < least:
            raise InputError(f"--{name}: must be at least {least}, got {value}")
    facts = {"fretflow": versions().get("fretflow", ""), "commit": commit() or "not known",
             "begun": time.strftime("%Y-%m-%d %H:%M")}
    try:
        scores = Trial(Settings(cases, seed, fast, world), out.absolute(), jobs, say=say_line, facts=facts).run()
    except TrialError as error:
        raise InputError(str(error)) from error
    except BrokenSealError as error:
        raise FretflowError(str(error)) from error
    _show_targets(scores)
    show_files([out / "trial.html", out / "trial.json", *keep_json(json, scores)], "scoreboard")


def _show_targets(scores: Mapping[str, Any]) -> None:
    table = new_table("targets, effects at signal-to-noise 10 or more", "score", "reached",
                      "95 % interval", "of", "target", "met")
    for one in scores["targets"]:
        reached = "-" if one["value"] is None else f"{one['value']:.3g}"
        met = {None: "too few cases" if one["cases"] else "no case", True: "yes", False: "no"}[one["met"]]
        interval = "-" if one["interval_95"] is None else "{:.3g} to {:.3g}".format(*one["interval_95"])
        table.add_row(one["name"], reached, interval, str(one["cases"]), one["target"], met)
    Terminal(highlight=False).print(table)
