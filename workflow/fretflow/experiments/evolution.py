"""What is read off measured and predicted loops as the cycles go on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.inference.verdict import Evolution
from fretflow.recordings.readings import read_noisy_loop

Array = NDArray[np.float64]
Loop = tuple[Array, Array]

READ = ("friction_limit", "tangential_stiffness", "dissipated_energy", "sliding_distance")


def evolution(cycles: Sequence[int], loops: Sequence[Sequence[Loop]]) -> Evolution | None:
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


def _readings(loop: Loop) -> list[float]:
    try:
        found = read_noisy_loop(*loop)
    except InputError:
        return [np.nan] * len(READ)
    return [np.nan if (value := getattr(found, name)) is None else value for name in READ]
