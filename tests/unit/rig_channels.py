"""Recordings of a rig with one channel altered, and what is said of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from fretflow.experiments.rig.instruments import doubts, faults
from fretflow.experiments.rig.setup import case_of
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.recording import Recording


def altered(recording: Recording, name: str, change: Callable[[LoopSet, np.ndarray], np.ndarray]) -> Recording:
    """Return a recording one of whose channels is `change` of its loops and itself (K, R, N)."""
    own, swept = (replace(loops, channels={**loops.channels, name: change(loops, np.array(loops.channels[name]))})
                  for loops in (recording.loops, recording.sweep.loops))
    return replace(recording, loops=own, sweep=replace(recording.sweep, loops=swept))


def said(recording: Recording) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return faults and doubts of a recording."""
    case = case_of(recording)
    return faults(recording, case), doubts(recording, case)
