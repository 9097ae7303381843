"""The worn shape that wear tends to, found without marching.

In the end every worn node wears at one rate and the face sinks without changing its shape; or, where
sticking nodes can carry the load alone, wearing nodes have lost contact and the rate vanishes. With the
slip path per node frozen that face is a contact with a pressure cap (`capped_contact`); the periodic
solution on it gives a new slip path, and so on. In gross slip the slip path hardly depends on the face, so
a few rounds suffice. Where gross slip turns into partial slip while the face wears, the end depends on the
way there, which this does not follow: the distance to a marched solution says so.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.core.records import quantity, record
from fretflow.wear.capped_contact import CappedContact, CappedSolution, solve_capped_contact
from fretflow.wear.cycle import CycleModel, CycleResponse, settle
from fretflow.wear.feedback import Feedback

S = TypeVar("S")
STUCK = 1e-9  # share of the largest slip path below which a node counts as sticking


@record
class AsymptoticShape:
    """The face that wears uniformly, or no more."""

    depth: NDArray[np.float64] = quantity("m", "(nodes,), both faces together")
    rate: float = quantity("m")  # depth per cycle of the worn nodes; 0 when wear has ended
    volume: float = quantity("m^3")
    residual: float = quantity("1")  # deviation from uniform; relative to the unworn rate when wear ends
    solves: int  # periodic solutions that it took

    def distance(self, depth: NDArray[np.float64]) -> float:
        """Return the largest difference to a marched `depth` (nodes,), m, over the largest depth here."""
        return float(np.abs(depth - self.depth).max() / self.depth.max())


def solve_asymptotic_shape(model: CycleModel[S], coefficient: float, volume: float, tolerance: float = 1e-6,
                           max_rounds: int = 60) -> AsymptoticShape:
    """Find the face that `model` wears to.

    Parameters
    ----------
    model : CycleModel
        The vibrating joint.
    coefficient : float
        K_w in m^2/N.
    volume : float
        Worn volume in m^3 at which to give the face; where wear ends before, the face is that at its end.
    tolerance : float
        Largest accepted deviation of the rate from uniform.
    max_rounds : int
        Rounds of face and period before giving up.

    Raises
    ------
    InputError
        If the volume is not positive, nothing slides, or laws over cycles act.
    NonConvergenceError
        With the deviations of all rounds.
    """
    if not volume > 0.0:
        raise InputError(f"asymptotic shape: the worn volume must be positive, got {volume}")
    if model.has_laws:
        raise InputError("asymptotic shape: laws over cycles change the joint as it wears; march the wear instead")
    start = model.initial()
    flexibility = Feedback(model.normal_flexibility(start), model.areas).flexibility
    depth = np.zeros_like(model.areas)
    response, state = model.cycle(start, None)
    first_rate = coefficient * float(response.pressure_sliding.max())
    if not first_rate > 0.0:
        raise InputError("asymptotic shape: nothing slides, so that nothing wears; raise the excitation")
    path = np.full_like(depth, _mean_path(response, model.areas))
    residuals: list[float] = []
    for _ in range(max_rounds):
        path = _sliding_path(response, path)
        contact = _capped(flexibility, model.areas, coefficient, depth, path, response)
        contact = contact if model.load_held else replace(contact, load=None)
        worn = depth > 0.0 if residuals else np.isfinite(contact.cap)
        solution = solve_capped_contact(contact, volume, worn, ~worn & (response.contact_share > 0.0))
        depth = solution.depth
        response, state = settle(model, replace(start, depth=depth), state)
        rate = coefficient * response.pressure_sliding
        residuals.append(_deviation(rate, solution, model.areas, first_rate))
        if residuals[-1] <= tolerance:
            return AsymptoticShape(depth=depth, rate=solution.rate, volume=float(model.areas @ depth),
                                   residual=residuals[-1], solves=len(residuals) + 1)
    raise NonConvergenceError(
        f"asymptotic shape: rate not uniform to {tolerance:g} after {max_rounds} rounds", history=residuals)


def _mean_path(response: CycleResponse, areas: NDArray[np.float64]) -> float:
    return float(areas @ response.pressure_sliding / (areas @ response.mean_pressure))


def _sliding_path(response: CycleResponse, last: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the path (nodes,), m, of wear at the mean pressure; an open node keeps its `last`."""
    loaded = response.mean_pressure > 0.0
    return np.divide(response.pressure_sliding, response.mean_pressure, out=last.copy(), where=loaded)


def _capped(flexibility: NDArray[np.float64], areas: NDArray[np.float64], coefficient: float,
            depth: NDArray[np.float64], path: NDArray[np.float64], response: CycleResponse) -> CappedContact:
    """Return the capped contact whose solution at `depth` has the mean forces and gaps of `response`."""
    force = areas * response.mean_pressure
    opening = np.where(response.contact_share > 0.0, 0.0, response.mean_opening)
    slides = path > STUCK * path.max()
    cap = np.divide(areas, coefficient * path, out=np.full_like(path, np.inf), where=slides)
    return CappedContact(flexibility, opening - depth - flexibility @ force, cap, areas, float(force.sum()))


def _deviation(rate: NDArray[np.float64], solution: CappedSolution, areas: NDArray[np.float64],
               first_rate: float) -> float:
    """Return how far `rate` (nodes,) is from uniform at worn nodes and above that elsewhere."""
    worn = solution.depth > 0.0
    if solution.rate == 0.0:
        return float(rate.max()) / first_rate
    uniform = float(areas[worn] @ rate[worn] / areas[worn].sum())
    return float(np.max(np.where(worn, np.abs(rate - uniform), rate - uniform)) / uniform)
