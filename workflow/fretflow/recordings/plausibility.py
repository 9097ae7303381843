"""What no joint does: a displacement of metres, a friction force of many times the normal load; wrong units or columns.

Limits are wide: a recording that crosses one is refused, because every result of it would be wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.units import format_quantity
from fretflow.recordings.loopset import FORCES, LoopSet, plateau
from fretflow.recordings.notes import Note
from fretflow.recordings.schema import RecordedTest, RecordingFile, TestKind

Array = NDArray[np.float64]

# Peak-to-peak displacement, m.
RANGES = {
    TestKind.FRETTING_RIG: (1e-9, 5e-3),
    TestKind.IMPOSED_DISPLACEMENT: (1e-9, 1.0),
    TestKind.LUMPED: (1e-9, 20.0),
}
LARGEST_FRICTION = 5.0
STATED = 2.0  # factor between what is stated and what is measured that is refused
NOTED = 1.05
SAME_ORDER = 10.0


def check_motion(path: Path, block: str, kind: TestKind, reach: float) -> None:
    """Check a peak-to-peak displacement (m).

    Raises
    ------
    UnreliableRecordingError
        If it is out of the range of its kind of test.
    """
    low, high = RANGES[kind]
    if not low <= reach <= high:
        raise UnreliableRecordingError(
            f"{path}: {block}.displacement: {format_quantity(reach, 'm', 4)} peak to peak is beyond {kind} tests "
            f"({format_quantity(low, 'm')} to {format_quantity(high, 'm')}); check its unit and column")


def check_loops(path: Path, block: str, loops: LoopSet, test: RecordedTest, load: Array,
                amplitude: Array) -> tuple[Note, ...]:
    """Compare loops with what is stated of them; `load` and `amplitude` of the excitation are (K,), N, or nan.

    Raises
    ------
    UnreliableRecordingError
        If they contradict it.
    """
    if "displacement" in loops.channels:
        check_motion(path, block, test.kind, float(np.nanmax(np.ptp(loops.mean("displacement"), axis=1))))
    notes: tuple[Note, ...] = ()
    force = next((name for name in FORCES if name in loops.channels), None)
    if force and test.kind is TestKind.FRETTING_RIG:
        # a wrong unit is in every loop; what hardens as a scar deepens is in some
        ratio = float(np.nanmin(plateau(loops.mean(force)) / load)) if np.isfinite(load).any() else 0.0
        if ratio > LARGEST_FRICTION:
            raise UnreliableRecordingError(f"{path}: {block}.{force}: its amplitude is {ratio:.3g} times the normal "
                                           "load; check its unit and column, and normal_load")
    notes += _against(path, block, loops, "excitation", amplitude, "excitation_amplitude", amplitude_of=True)
    notes += _against(path, block, loops, "normal_force", load, "normal_load", amplitude_of=False)
    return notes


def _against(path: Path, block: str, loops: LoopSet, name: str, stated: Array, key: str,
             amplitude_of: bool) -> tuple[Note, ...]:
    if name not in loops.channels or not np.isfinite(stated).any():
        return ()
    mean = loops.mean(name)
    found = 2.0 / mean.shape[1] * np.abs(np.fft.rfft(mean, axis=1)[:, 1]) if amplitude_of else mean.mean(axis=1)
    with np.errstate(invalid="ignore"):
        ratio = found / stated
    k = int(np.nanargmax(np.abs(np.log(np.maximum(np.abs(ratio), 1e-9)))))
    worst = max(abs(ratio[k]), 1.0 / max(abs(ratio[k]), 1e-9))
    measured, said = (format_quantity(float(values[k]), "N", 4) for values in (found, stated))
    words = f"{measured} was measured where {key} says {said}"
    if worst > STATED or ratio[k] < 0.0:
        raise UnreliableRecordingError(f"{path}: {block}.{name}: {words}; correct the one that is wrong")
    return (Note(block, words, name),) if worst > NOTED else ()


def check_wear(path: Path, volume: float | None, channels: Mapping[str, Array]) -> None:
    """Compare a map of depth with the worn volume (m^3), over the rectangle that the map spans.

    Raises
    ------
    UnreliableRecordingError
        If they are not of one order of magnitude.
    """
    if volume is None or not {"x", "y", "depth"} <= set(channels) or len(channels["x"]) < 4:
        return
    mapped = float(np.ptp(channels["x"]) * np.ptp(channels["y"]) * channels["depth"].mean())
    if not volume / SAME_ORDER < mapped < volume * SAME_ORDER:
        raise UnreliableRecordingError(
            f"{path}: wear_depth: holds {mapped * 1e9:.3g} mm^3 where wear.worn_volume says {volume * 1e9:.3g} mm^3; "
            "check the units of x, y and depth")


def check_file(path: Path, file: RecordingFile, cycles: NDArray[np.int64]) -> None:
    """Compare the cycle counts of the loops with the length of the test.

    Raises
    ------
    UnreliableRecordingError
        If a loop was recorded after the end.
    """
    if file.test.cycles is not None and len(cycles) and int(cycles.max()) > file.test.cycles:
        raise UnreliableRecordingError(f"{path}: loops.cycle goes up to {int(cycles.max())}, but test.cycles is "
                                       f"{file.test.cycles}; correct the one that is wrong")
