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
    under a name that begins with the law's id.
    """

    cycles: float = quantity("1")
    depth: NDArray[np.float64] = quantity("m", "(nodes,), worn off both faces together")
    energy: float = quantity("J")  # dissipated since the start
    memory: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    @classmethod
    def unworn(cls, nodes: int) -> SlowState:
        """Return the start of a test with `nodes` nodes and nothing remembered."""
        return cls(cycles=0.0, depth=np.zeros(nodes), energy=0.0)
