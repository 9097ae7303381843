"""How each contact node spends the period: stick, slip, open."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from fretflow.contact.law import ContactState
from fretflow.core.records import quantity, record
from fretflow.solvers.periodic import PeriodicSolution
from numpy.typing import NDArray


class Regime(IntEnum):
    """What a node does over a whole period."""

    STICKS = 0
    STICKS_AND_SLIPS = 1
    SLIPS = 2
    LIFTS_OFF = 3
    STAYS_OPEN = 4


REGIME_WORDS = {
    Regime.STICKS: "sticks all the time",
    Regime.STICKS_AND_SLIPS: "sticks and slips in turn",
    Regime.SLIPS: "slips all the time",
    Regime.LIFTS_OFF: "lifts off at times",
    Regime.STAYS_OPEN: "open all the time",
}


@record
class StateShares:
    """Share of the period that each node sticks, slips and is open; they sum to one."""

    stick: NDArray[np.float64] = quantity("1", "(nodes,)")
    slip: NDArray[np.float64] = quantity("1", "(nodes,)")
    open: NDArray[np.float64] = quantity("1", "(nodes,)")
    regime: NDArray[np.int8] = quantity("1", "(nodes,), see Regime")


def state_shares(period: PeriodicSolution) -> StateShares:
    """Return how the nodes spend `period`."""
    stick, slip, opened = (np.mean(period.state == s, axis=0)
                           for s in (ContactState.STICK, ContactState.SLIP, ContactState.SEPARATION))
    regime = np.select(
        [opened == 1.0, opened > 0.0, slip == 1.0, slip > 0.0],
        [Regime.STAYS_OPEN, Regime.LIFTS_OFF, Regime.SLIPS, Regime.STICKS_AND_SLIPS], Regime.STICKS)
    return StateShares(stick=stick, slip=slip, open=opened, regime=regime.astype(np.int8))
