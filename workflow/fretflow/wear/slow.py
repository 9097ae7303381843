"""What changes over cycles, apart from one period to the next: the slow state of the joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from fretflow.core.records import quantity, record


@record
class SlowState:
    """The joint after `cycles` cycles.

    `memory` holds what laws over cycles remember besides wear and energy (a debris layer, for example), each array
    under a name that begins with the law's id and ends in its unit: ``third-body.layer_m``.
    """

    cycles: float = quantity("1")
    depth: NDArray[np.float64] = quantity("m", "(nodes,), worn off both faces together")
    energy: float = quantity("J")  # dissipated since the start
    memory: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    @classmethod
    def unworn(cls, nodes: int) -> SlowState:
        """Return the start of a test with `nodes` nodes and nothing remembered."""
        return cls.worn_by(np.zeros(nodes))

    @classmethod
    def worn_by(cls, depth: NDArray[np.float64]) -> SlowState:
        """Return a joint of which `depth` (nodes,), m, is all that has changed."""
        return cls(cycles=0.0, depth=depth, energy=0.0)

    def after(self, cycles: float, worn: NDArray[np.float64], energy: float,
              memory: Mapping[str, NDArray[np.float64]] | None = None) -> SlowState:
        """Return the state after `cycles` more, which wear `worn` (nodes,), m, and dissipate `energy`, J."""
        return SlowState(cycles=self.cycles + cycles, depth=self.depth + worn, energy=self.energy + energy,
                         memory=self.memory if memory is None else memory)
