"""Time per point of a backbone against contact points, by static loads and by periodic motion; prints a table.

Run ``python benchmarks/structures.py`` with `workflow` on the path. The structure is the lapped beam of the tests, free
in space, whose faces carry asperity springs, or are rigid; 23 amplitudes, 4 harmonics, 128 samples a period.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import fretflow as ff
import numpy as np

POINTS = 23
SIZES = (25, 61, 122, 241)


def main() -> None:
    """Print the table."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "analytic"))
    from lap_structures import lap_beam

    print("| contact points | faces | reduction, s | static, ms a point | periodic, ms a point | largest difference of "
          "frequency | of damping ratio |\n|---|---|---|---|---|---|---|")
    asked = np.geomspace(2e-6, 1e-4, POINTS)
    for size in SIZES:
        start = time.process_time()
        structure = ff.reduce_structure(lap_beam(size))
        reduced = time.process_time() - start
        for words, springs in (("rigid", None), ("springs", np.full(3 * size, 2e-9 * size / 25.0))):
            joint = ff.BoltedJoint(structure=structure, law=ff.Coulomb(0.45), bolt_load=6e3, springs=springs)
            mode = joint.linear_modes(1)[0]
            ff.quasi_static_backbone(joint, mode, asked[:1])  # compiled
            start = time.process_time()
            static = ff.quasi_static_backbone(joint, mode, asked)
            middle = time.process_time()
            periodic = ff.follow_mode(joint, mode, np.sort(static.amplitude), tolerance=1e-4)
            end = time.process_time()
            order = np.argsort(static.amplitude)
            frequency = np.max(np.abs([one.frequency for one in periodic] / static.frequency[order] - 1.0))
            damping = np.max(np.abs([one.damping for one in periodic] - static.damping[order]))
            print(f"| {size} | {words} | {reduced:.2f} | {1e3 * (middle - start) / POINTS:.1f} | "
                  f"{1e3 * (end - middle) / POINTS:.0f} | {100.0 * frequency:.2f} % | {damping:.1e} |")


if __name__ == "__main__":
    main()
