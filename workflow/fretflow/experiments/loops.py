"""What any experiment tells of loops: where they turn, stick, begin to slide and slide; parities; readings."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import Array, quantity, record
from fretflow.inference.verdict import Evolution
from fretflow.recordings.readings import read_noisy_loop

HARMONICS = 12  # of a loop that are compared
MOST_SHOWN = 8  # cycle counts, or cycles
READ = ("friction_limit", "tangential_stiffness", "dissipated_energy", "sliding_distance")
PHASES = ("reversal", "stick slope", "knee", "plateau", "plateau end")
PARITIES = ("a constant", "odd in the displacement", "odd in the direction of motion",
            "odd in the displacement and in the direction of motion")


@record
class Strokes:
    """Both strokes of a loop of N samples, a stroke from one extreme of the displacement to the other."""

    way: Array = quantity("1", "(N,), 1 where the displacement rises, -1 where it falls")
    since: Array = quantity("m", "(N,), travel since the reversal")
    share: Array = quantity("1", "(N,), of the stroke's travel")
    phase: NDArray[np.int64] = quantity("1", "(N,), index into PHASES")
    period: Array = quantity("1", "(N,), 0 and 1/2 at the reversals, 1/4 and 3/4 where the plateaus begin")

    @classmethod
    def of(cls, displacement: Array, force: Array) -> Strokes:
        """Return the strokes of a loop (N,); the phases go by how far the force is from reversal to plateau."""
        x, f = smoothed(displacement), smoothed(force)
        n, top, bottom = len(x), int(np.argmax(x)), int(np.argmin(x))
        way, since, share, period = np.ones(n), np.zeros(n), np.zeros(n), np.zeros(n)
        phase = np.zeros(n, dtype=np.int64)
        for begin, end, sign in ((bottom, top, 1.0), (top, bottom, -1.0)):
            own = (begin + np.arange((end - begin) % n or n)) % n
            travel = np.maximum.accumulate(sign * (x[own] - x[begin]))
            gone = travel / max(abs(x[end] - x[begin]), 1e-300)
            way[own], since[own], share[own] = sign, travel, gone
            built = _built(sign * f[own], gone)
            phase[own] = _phases(built, gone)
            period[own] = 0.25 * (np.clip(built, 0.0, 1.0) + gone) + (0.0 if sign > 0.0 else 0.5)
        return cls(way=way, since=since, share=share, phase=phase, period=period)


def _built(force: Array, gone: Array) -> Array:
    """Return how far the force of one stroke, positive against the motion, is from the reversal to the plateau."""
    half = gone >= 0.5  # of the travel: the median force from there is the plateau's
    plateau = float(np.median(force[half])) if half.any() else float(force.max())
    return np.asarray(np.maximum.accumulate((force - force[0]) / max(plateau - force[0], 1e-300)))


def _phases(built: Array, gone: Array) -> NDArray[np.int64]:
    """Return the phases along one stroke from its force and share of the travel."""
    phase = np.digitize(built, (0.1, 0.7, 0.95))  # of the force's way from the reversal to the plateau
    phase[(phase == PHASES.index("plateau")) & (gone > 0.9)] = PHASES.index("plateau end")
    return phase


def smoothed(loop: Array) -> Array:
    """Return a loop (N,) of the harmonics that are compared: above, a measured one is mostly noise."""
    spectrum = np.fft.rfft(loop)
    spectrum[HARMONICS + 1:] = 0.0
    return np.fft.irfft(spectrum, len(loop))


def parity_parts(table: Array) -> dict[str, Array]:
    """Return the parts of a table (2, bins), directions by displacement, by their parity in each."""
    parts = []
    for turn, mirror in product((1.0, -1.0), repeat=2):
        turned = table + turn * table[::-1]
        parts.append(0.25 * (turned + mirror * turned[:, ::-1]))
    return dict(zip(PARITIES, parts, strict=True))


def evolution(cycles: Sequence[int], loops: Sequence[Sequence[tuple[Array, Array]]]) -> Evolution | None:
    """Return the readings of loops at their cycle counts; None where there are fewer than two.

    Parameters
    ----------
    cycles
        Count of each loop.
    loops
        Displacement in m and force in N, (N,) each: measured, before and after.
    """
    if len(cycles) < 2:
        return None
    read = np.array([[_readings(loop) for loop in three] for three in loops])
    return Evolution(cycles=np.asarray(cycles, dtype=float), **{name: read[:, :, k].T for k, name in enumerate(READ)})


def _readings(loop: tuple[Array, Array]) -> list[float]:
    try:
        reading = read_noisy_loop(*loop)
    except InputError:
        return [np.nan] * len(READ)
    return [np.nan if (value := getattr(reading, name)) is None else value for name in READ]
