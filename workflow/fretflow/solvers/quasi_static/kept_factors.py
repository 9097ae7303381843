"""Factors that are kept from period to period, for joints whose factors cost more than all else.

Where slip spreads, each sample has a contact state of its own and needs factors of its own. The states of a period that
is nearly another hardly differ from that one's, and as long as a sample's state is the same its factors serve again.
"""

from __future__ import annotations

from fretflow.contact.kernels.march import Forcing, as_before, guess_sample
from fretflow.contact.kernels.sample import (
    Contact,
    Factor,
    PeriodHistory,
    States,
    alike,
    copy_sample,
    empty_factor,
    find_in_parts,
)

WORTH_KEEPING = 300  # nodes from which a sample's factors take longer than what is compiled takes to call
MOST_BYTES = 2**31  # of factors kept; further samples share one


class KeptFactors:
    """The last factors of each sample that needed its own."""

    def __init__(self, nodes: int, shared: Factor) -> None:
        """Take the joint's nodes, and the factors that all samples share which have none of their own."""
        self.nodes = nodes
        self.shared = self.latest = shared
        self.of_sample: dict[int, Factor] = {}

    def choose(self, j: int, state: States) -> Factor:
        """Return factors for sample j that begins in `state`: its own, the latest, or room for new ones."""
        own = self.of_sample.get(j)
        if own is not None and alike(own.state, state):
            return own
        if alike(self.latest.state, state):
            return self.latest
        if own is None and self._bytes() < MOST_BYTES:
            own = self.of_sample[j] = empty_factor(self.nodes, single=True)  # memory is taken as it is written to
        return self.shared if own is None else own

    def _bytes(self) -> int:
        """Return what is written of the factors kept."""
        return sum(max(0, int(one.size[0]))**2 * one.matrix.itemsize for one in self.of_sample.values())

    def march(self, c: Contact, forcing: Forcing, start: PeriodHistory, guess: PeriodHistory, last: PeriodHistory,
              limits: tuple[float, float], history: PeriodHistory) -> int:
        """March one period as `contact.kernels.march.march`, without derivatives; arguments and result are those."""
        before, b, earlier, e = start, 0, start, 0
        for j in range(len(history.state)):
            guess_sample(guess, history, j, forcing.pull, before, b, earlier, e)
            self.latest = self.choose(j, history.state[j])
            if not find_in_parts(c, self.latest, (forcing.pull[j - 1], forcing.pull[j]), forcing.friction_factor[j],
                                 before.displacement[b], history, j, limits[0]):
                return -1 - j
            earlier, e, before, b = before, b, history, j
            if len(last.state) and as_before(history, last, j, limits[1]):
                for rest in range(j + 1, len(history.state)):
                    copy_sample(last, rest, history, rest)
                return j
        return len(history.state)
