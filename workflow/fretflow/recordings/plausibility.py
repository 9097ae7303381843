"""What no joint does: a displacement of metres, friction of many times or a thousandth of the normal load.

Limits are wide: a recording that crosses one is refused, because every result of it would be wrong. So is a column
whose heading says that it is something else.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.records import Array
from fretflow.core.units import pretty_quantity
from fretflow.recordings.channels import CHANNELS, INDICES
from fretflow.recordings.headings import BRACKETED, known_unit, split_heading
from fretflow.recordings.kinds import RecordingKind
from fretflow.recordings.loopset import FORCES, LoopSet, plateau
from fretflow.recordings.notes import Note
from fretflow.recordings.schema import RecordedTest, RecordingFile

LARGEST_FRICTION = 5.0
# Below it friction is called superlubricity: M. Z. Baykara et al., Appl. Phys. Rev. 5 (2018) 041102.
LEAST_FRICTION = 0.01
SLIDES = 0.5  # of the rectangle around a loop that it encloses: it slides most of its way, and shows its friction limit
STATED = 2.0  # factor between what is stated and what is measured that is refused
NOTED = 1.05
SAME_ORDER = 10.0


def check_heading(path: Path, block: str, channel: str, heading: str) -> None:
    """Check that the `heading` of a column does not name another quantity than `channel`.

    Raises
    ------
    UnreliableRecordingError
        If it names another channel, or states in brackets a unit of another one, of a dimension that `channel` has not.
    """
    base, tail = split_heading(heading)
    own = set(CHANNELS[channel])
    others = [name for name, units in CHANNELS.items() if not own & set(units) and name not in INDICES]
    stated = any(known_unit(name, tail) for name in (channel, *others))
    names = {text.strip().lower().replace(" ", "_") for text in (heading, *([base] if stated else []))}
    other = next((name for name in others if name in names), None)
    if other is None and BRACKETED.fullmatch(heading) and not known_unit(channel, tail):
        other = next((name for name in others if known_unit(name, tail)), None)
    if channel not in INDICES and other is not None:
        raise UnreliableRecordingError(f"{path}: {block}.{channel}: its column {heading!r} says that it is of {other}; "
                                       "name the right column, or correct the heading")


def check_friction(where: str, coefficient: float, load: float) -> None:
    """Check the largest friction `coefficient` of loops under a normal `load` (N); `where` names them.

    Raises
    ------
    UnreliableRecordingError
        If no contact rubs so, naming the load.
    """
    if LEAST_FRICTION <= coefficient <= LARGEST_FRICTION or not np.isfinite(coefficient):
        return
    raise UnreliableRecordingError(
        f"{where}: its amplitude is {coefficient:.3g} times the normal load of {pretty_quantity(load, 'N', 4)}, beyond "
        f"what any contact shows ({LEAST_FRICTION:g} to {LARGEST_FRICTION:g}); check its unit and column, and "
        "normal_load")


def check_motion(path: Path, block: str, kind: RecordingKind, displacement: float) -> None:
    """Check a peak-to-peak displacement (m).

    Raises
    ------
    UnreliableRecordingError
        If it is out of the range of its kind of test.
    """
    low, high = kind.displacement_range
    if not low <= displacement <= high:
        raise UnreliableRecordingError(
            f"{path}: {block}.displacement: {pretty_quantity(displacement, 'm', 4)} peak to peak is beyond {kind} "
            f"tests ({pretty_quantity(low, 'm')} to {pretty_quantity(high, 'm')}); check its unit and column")


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
    if force and test.kind.friction_alone and np.isfinite(load).any():  # a lumped system's holds its inertia
        ratios = plateau(loops.mean(force)) / load
        # a wrong unit is in every loop; what hardens as a scar deepens is in some
        if not np.nanmin(ratios) > LARGEST_FRICTION:
            ratios = np.where(_slides(loops, force), np.minimum(ratios, LARGEST_FRICTION), np.nan)
        if np.isfinite(ratios).any():
            k = int(np.nanargmax(ratios))
            check_friction(f"{path}: {block}.{force}", float(ratios[k]), float(load[k]))
    notes += _against(path, block, loops, "excitation", amplitude, "excitation_amplitude", amplitude_of=True)
    notes += _against(path, block, loops, "normal_force", load, "normal_load", amplitude_of=False)
    return notes


def _slides(loops: LoopSet, force: str) -> NDArray[np.bool_]:
    """Return which loops (K,) enclose so much that they show the friction limit."""
    if "displacement" not in loops.channels:
        return np.zeros(len(loops.cycles), dtype=bool)
    moved, pushed = loops.mean("displacement"), loops.mean(force)
    enclosed = np.abs(np.sum(pushed * (np.roll(moved, -1, axis=1) - np.roll(moved, 1, axis=1)), axis=1)) / 2.0
    return np.asarray(enclosed > SLIDES * np.ptp(moved, axis=1) * np.ptp(pushed, axis=1))


def _against(path: Path, block: str, loops: LoopSet, name: str, stated: Array, key: str,
             amplitude_of: bool) -> tuple[Note, ...]:
    if name not in loops.channels or not np.isfinite(stated).any():
        return ()
    mean = loops.mean(name)
    recorded = 2.0 / mean.shape[1] * np.abs(np.fft.rfft(mean, axis=1)[:, 1]) if amplitude_of else mean.mean(axis=1)
    with np.errstate(invalid="ignore"):
        ratio = recorded / stated
    k = int(np.nanargmax(np.abs(np.log(np.maximum(np.abs(ratio), 1e-9)))))
    worst = max(abs(ratio[k]), 1.0 / max(abs(ratio[k]), 1e-9))
    measured, said = (pretty_quantity(float(values[k]), "N", 4) for values in (recorded, stated))
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
            f"{path}: wear_depth: holds {mapped * 1e9:.3g} mm³ where wear.worn_volume says {volume * 1e9:.3g} mm³; "
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
