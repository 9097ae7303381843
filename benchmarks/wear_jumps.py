"""Periods that a worn crowned face takes, and its error, by the tolerance of implicit jumps.

Run ``python benchmarks/wear_jumps.py`` with the packages on the path. A crown of 40 mm radius on a half-space, 11 x 11
nodes over 1 mm, slides by 40 um a cycle under 60 N, until its scar is 23 times as deep as the crown is high. The
contact is solved exactly at each depth, so that what jumps miss is all that is seen.
"""

from __future__ import annotations

import numpy as np
from fretflow.core.records import quantity, record
from fretflow.wear.cycle import CycleResponse, WearAlone
from fretflow.wear.history import WearSettings
from fretflow.wear.march import run_history

NODES, SIDE, RADIUS = 11, 1e-3, 40e-3  # a row; m
LOAD, PATH, MODULUS, COEFFICIENT, CYCLES = 60.0, 40e-6, 105e9, 3e-14, 2_000_000
TOLERANCES = (1e-3, 1e-2, 3e-2, 1e-1)
SQUARE = 3.525  # of a square under uniform pressure: its middle sinks by so much of p h / (pi E*)


@record
class Nothing:
    """A state that carries nothing over."""

    flag: float = quantity("1")


class Crown(WearAlone):
    """The crown, every closed node of which slides alike."""

    state_type = Nothing

    def __init__(self) -> None:
        row, pitch = np.linspace(-0.5 * SIDE, 0.5 * SIDE, NODES), SIDE / (NODES - 1)
        x, y = (one.ravel() for one in np.meshgrid(row, row))
        share = np.where(np.abs(row) < 0.49 * SIDE, 1.0, 0.5)
        self.areas = np.outer(share, share).ravel() * pitch**2
        apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y))
        self.flexibility = 1.0 / (np.pi * MODULUS * np.where(apart > 0.0, apart, pitch / SQUARE))
        self.crown = (x**2 + y**2) / (2.0 * RADIUS)

    def normal_flexibility(self, slow):
        """Return the flexibility of the half-space."""
        return self.flexibility

    def cycle(self, slow, start):
        """Return a cycle: active sets until forces press and gaps are open."""
        gap, closed, force = self.crown + slow.depth, np.ones(len(self.areas), dtype=bool), np.zeros(len(self.areas))
        while True:
            at = np.flatnonzero(closed)
            by_gap, by_motion = np.linalg.solve(self.flexibility[np.ix_(at, at)], np.c_[-gap[at], np.ones(at.size)]).T
            approach = (by_gap.sum() - LOAD) / by_motion.sum()
            force[:], force[at] = 0.0, by_gap - approach * by_motion
            opening = gap + approach + self.flexibility @ force
            following = np.where(closed, force > 0.0, opening < -np.finfo(float).eps)
            if np.array_equal(following, closed):
                break
            closed = following
        pressure = force / self.areas
        return CycleResponse(
            pressure_sliding=PATH * pressure, mean_pressure=pressure, mean_opening=np.where(closed, 0.0, opening),
            slip_path=np.where(closed, PATH, 0.0), contact_share=closed.astype(float), dissipated_energy=LOAD * PATH,
            sliding_distance=0.5 * PATH), Nothing(flag=0.0)


def main() -> None:
    """Print the table; errors are those against the smallest tolerance, over the largest depth."""
    right = None
    for tolerance in TOLERANCES:
        worn = run_history(Crown(), WearSettings(coefficient=COEFFICIENT, upper_share=0.5, cycles=CYCLES,
                                                 scheme="implicit", tolerance=tolerance), None, None)
        depth = worn.depth[-1]
        right = depth if right is None else right
        print(f"tolerance {tolerance:g}: {worn.solves} periods, depth {1e6 * depth.max():.2f} um, "
              f"error {np.abs(depth - right).max() / right.max():.1e}")


if __name__ == "__main__":
    main()
