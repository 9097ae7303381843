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
from fretflow_trial.world import WORLDS


def make(effects: Sequence[str], seed: int, out: Path, world: int = 1, least: float = 0.0) -> Path:
    """Write a recording that hides `effects` in a world, at a least signal-to-noise; return the recording's folder."""
    kind = (NOTHING if not effects else UNKNOWN if any(name in UNLISTED for name in effects)
            else SINGLE if len(effects) == 1 else PAIR)
    simulated = simulate(kind, effects, SeedSequence(seed), world, least)
    folder = write(simulated, out / "recording", "Fretting rig, flat on flat")
    (out / "key.json").write_text(json.dumps(key(simulated), indent=1) + "\n", encoding="utf-8")
    return folder


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and make a recording."""
    parser = argparse.ArgumentParser(prog="python -m fretflow_trial.make", description=__doc__)
    parser.add_argument("--effect", action="append", default=[], choices=[*LISTED, *UNLISTED])
    parser.add_argument("--world", type=int, default=1, choices=list(WORLDS), help="see fretflow_trial.world")
    parser.add_argument("--least-signal", type=float, default=0.0, help="signal-to-noise below which is drawn again")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    folder = make(options.effect, options.seed, options.out, options.world, options.least_signal)
    sys.stdout.write(f"{folder} written\n")


if __name__ == "__main__":
    main()
