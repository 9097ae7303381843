"""Make one recording with a chosen effect, its answer beside it.

``python -m fretflow_trial.make --effect friction-run-in --seed 3 --out DIR`` writes ``DIR/recording`` and
``DIR/key.json``; several ``--effect`` are hidden together, none hides nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from numpy.random import SeedSequence

from fretflow_trial.case import LISTED, NOTHING, PAIR, SINGLE, UNKNOWN, UNLISTED, key, simulate
from fretflow_trial.record import write


def make(effects: Sequence[str], seed: int, out: Path) -> Path:
    """Write a recording that hides `effects` and its answer; return the recording's folder."""
    kind = (NOTHING if not effects else UNKNOWN if any(name in UNLISTED for name in effects)
            else SINGLE if len(effects) == 1 else PAIR)
    simulated = simulate(kind, effects, SeedSequence(seed))
    folder = write(simulated, out / "recording", "Fretting rig, flat on flat")
    (out / "key.json").write_text(json.dumps(key(simulated), indent=1) + "\n", encoding="utf-8")
    return folder


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and make a recording."""
    parser = argparse.ArgumentParser(prog="python -m fretflow_trial.make", description=__doc__)
    parser.add_argument("--effect", action="append", default=[], choices=[*LISTED, *UNLISTED])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    sys.stdout.write(f"{make(options.effect, options.seed, options.out)} written\n")


if __name__ == "__main__":
    main()
