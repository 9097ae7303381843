"""What the explicit and the implicit scheme share: one jump, from a worn contact to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fretflow.wear.archard import wear_rate
from fretflow.wear.cycle import CycleModel, CycleResponse, settle
from fretflow.wear.feedback import Coefficient, Feedback
from fretflow.wear.history import WearSettings, WearStep
from fretflow.wear.slow import SlowState

S = TypeVar("S")
OVERSHOOT_FREE = 0.5  # share of the stability bound
DIFFERENCE = 2.0**-10  # relative, for the slopes of the laws over cycles
SAFETY = 0.9
SHRINK, GROWTH = 0.2, 5.0


class Scheme(Protocol[S]):
    """Makes one jump."""

    def advance(self, now: WearStep, state: S) -> tuple[WearStep, S]:
        """Return the step after `now` and its state; it does not pass the next asked cycle count."""
        ...


@dataclass(frozen=True)
class LinearisedRate:
    """The wear rate over a jump: ``rate + by_depth @ (depth worn) + over_jump * (share of the jump)``."""

    rate: NDArray[np.float64]  # (nodes,), m/cycle; of nodes that come to touch less than nothing at first
    by_depth: NDArray[np.float64]  # (nodes, nodes), 1/cycle
    over_jump: NDArray[np.float64]  # (nodes,), m/cycle, without wear


@dataclass(frozen=True)
class WearingJoint(Generic[S]):
    """A vibrating joint that wears, and how."""

    model: CycleModel[S]
    settings: WearSettings

    def unworn(self) -> tuple[WearStep, S]:
        """Return step 0, the contact before any wear, and its state."""
        return self.settled(self.model.initial(), None, solves=1)

    def settled(self, slow: SlowState, state: S | None, solves: int, proposed_jump: float = math.nan,
                shortened: bool = False, anew: bool = True) -> tuple[WearStep, S]:
        """Return the step in the state `slow` with its period found again, and that period's state."""
        response, settled = settle(self.model, slow, state, anew)
        return WearStep(slow=slow, rate=self.rate(response, slow), response=response, proposed_jump=proposed_jump,
                        shortened=shortened, solves=solves), settled

    def rate(self, response: CycleResponse, slow: SlowState) -> NDArray[np.float64]:
        """Return the depth per cycle (nodes,), m: Archard's, changed by the laws over cycles."""
        return wear_rate(self.settings.coefficient, response) * self.model.wear_factor(response, slow)

    def feedback(self, now: WearStep) -> Feedback:
        """Return how the contact forces answer to wear."""
        return Feedback(self.model.normal_flexibility(now.slow), self.model.areas, self.model.load_held)

    def rate_slope(self, now: WearStep) -> Coefficient:
        """Return the coefficient of Archard's law, () or (nodes,), m^2/N, whose rate changes with pressure as ours."""
        coefficient = self.settings.coefficient
        if not self.model.has_laws:
            return coefficient
        more, less = (self.rate(_pressed(now.response, 1.0 + change), now.slow)
                      for change in (DIFFERENCE, -DIFFERENCE))
        sliding = now.response.pressure_sliding
        return np.divide(more - less, 2.0 * DIFFERENCE * sliding, out=np.zeros_like(sliding), where=sliding > 0.0)

    def self_limiting(self, now: WearStep, jump: float) -> NDArray[np.float64]:
        """Return how fast the wear of a jump lowers each node's rate through the laws alone, (nodes,), 1/cycle.

        A debris layer does so, as it thickens; the pressure is that of `now`. Laws that raise the rate count as zero.
        """
        if not self.model.has_laws:
            return np.zeros_like(now.rate)
        worn, energy = jump * now.rate, jump * now.response.dissipated_energy
        more, less = (self.rate(now.response, self.model.evolve(now.slow, jump, (1.0 + change) * worn, energy,
                                                                now.response))
                      for change in (DIFFERENCE, -DIFFERENCE))
        slope = np.divide(less - more, 2.0 * DIFFERENCE * worn, out=np.zeros_like(worn), where=worn > 0.0)
        return np.asarray(np.maximum(slope, 0.0))

    def linearised(self, now: WearStep, jump: int, ahead: float) -> LinearisedRate:
        """Return how the rate changes over a jump at held slip path, by the nodes that touch `ahead` cycles on.

        The change that the laws over cycles would bring about without wear is, say, that of debris that leaves and so
        opens the gap.
        """
        feedback, slope, response = self.feedback(now), self.rate_slope(now), now.response
        by_force = feedback.rate_by_force(slope, response)
        touch = feedback.touching(response, ahead * now.rate, ahead * by_force)
        jacobian = feedback.rate_jacobian(slope, response, touch)
        rate = now.rate + by_force * feedback.force_change(response, touch)
        if not self.model.has_laws:
            return LinearisedRate(rate, jacobian, np.zeros_like(now.rate))
        idle = self.model.evolve(now.slow, jump, np.zeros_like(now.rate), jump * response.dissipated_energy, response)
        change = (jacobian @ (self.model.gap(idle) - self.model.gap(now.slow)) + self.rate(response, idle) - now.rate)
        own = jacobian * self.model.opening_share(now.slow, jump) - np.diag(self.self_limiting(now, jump))
        return LinearisedRate(rate, np.asarray(own), np.asarray(change))

    def remaining(self, now: WearStep) -> int:
        """Return the cycles to the next asked count."""
        return self.settings.next_stop(now.cycles) - now.cycles

    def stable_jump(self, now: WearStep) -> float:
        """Return the cycles of the longest explicit jump that does not overshoot; inf when nothing slides."""
        bound = self.feedback(now).stability_bound(self.rate_slope(now), now.response)
        limiting = float(self.self_limiting(now, 1.0).max())
        return OVERSHOOT_FREE * (bound if limiting == 0.0 else 1.0 / (1.0 / bound + 0.5 * limiting))

    def shallow_jump(self, now: WearStep) -> float:
        """Return the cycles in which no node wears more than `Feedback.depth_scale`; inf when nothing wears.

        Where little slides the stability bound allows much, yet such a jump would reshape the contact unseen.
        """
        return _cycles_to(self.feedback(now).depth_scale(now.response), now)

    def unloaded_by(self, depth: NDArray[np.float64], now: WearStep) -> float:
        """Return the largest pressure that a further `depth` (nodes,), m, takes from a node, over the mean one."""
        response, areas = now.response, self.model.areas
        closed = response.contact_share > 0.0
        taken = self.feedback(now).unloading(closed) @ depth / areas
        return relative(float(np.abs(taken).max()),
                        float(areas @ response.mean_pressure) / float(areas[closed].sum() or np.inf))

    def is_short(self, now: WearStep, jump: float) -> bool:
        """Tell whether a jump wears no more than the tolerance tells apart."""
        worn = jump * float(now.rate.max())
        return worn < self.settings.tolerance * (float(now.depth.max()) + worn)

    def asked_jump(self, now: WearStep) -> float:
        """Return the cycles in which the fastest node wears `max_depth_per_jump`; inf if that was not given."""
        most = self.settings.max_depth_per_jump
        return math.inf if most is None else _cycles_to(most, now)

    def energy_error(self, end: SlowState, jump: int, first: CycleResponse, last: CycleResponse) -> float:
        """Return the error of the energy at the `end` of a jump over the tolerance, as if it were of first order.

        Without laws over cycles nothing depends on the energy, and it is not controlled.
        """
        if not self.model.has_laws:
            return 0.0
        error = 0.5 * jump * abs(last.dissipated_energy - first.dissipated_energy)
        return relative(error, self.settings.tolerance * end.energy)


def relative(error: float, allowed: float) -> float:
    """Return `error` over what is `allowed`; no error is none of nothing."""
    if error == 0.0:
        return 0.0
    return error / allowed if allowed > 0.0 else math.inf


def resized(error: float) -> float:
    """Return the factor on a jump whose `error`, over the tolerance, is of second order in the jump."""
    return min(GROWTH, max(SHRINK, SAFETY / math.sqrt(error))) if error > 0.0 else GROWTH


def even_share(remaining: int, jump: float) -> int:
    """Divide `remaining` cycles evenly into jumps of at most `jump` >= 1 and return one of them."""
    if jump >= remaining:
        return remaining
    return math.ceil(remaining / math.ceil(remaining / math.floor(jump)))


def _cycles_to(depth: float, now: WearStep) -> float:
    fastest = float(now.rate.max())
    return depth / fastest if fastest > 0.0 else math.inf


def _pressed(response: CycleResponse, factor: float) -> CycleResponse:
    """Return `response` under `factor` times the pressure."""
    return replace(response, pressure_sliding=factor * response.pressure_sliding,
                   mean_pressure=factor * response.mean_pressure,
                   dissipated_energy=factor * response.dissipated_energy)
