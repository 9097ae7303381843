"""What wear needs to know of one vibration period and of the laws over cycles, and the protocol that provides it.

Wear, the periodic solution and the laws over cycles are apart: wear sees the others only through `CycleModel`.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fretflow.contact.interface import area_mean, work_of_friction
from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import quantity, record
from fretflow.wear.slow import SlowState

S = TypeVar("S")


@record
class CycleResponse:
    """What one period does to the contact in a given slow state.

    Sums run over the increments of the period; pressure and force are those at the end of each increment,
    in wear and in energy alike, so that both share one quadrature.
    """

    pressure_sliding: NDArray[np.float64] = quantity("N/m", "(nodes,), sum of p |du_t| per cycle")
    mean_pressure: NDArray[np.float64] = quantity("Pa", "(nodes,), mean over the period")
    mean_opening: NDArray[np.float64] = quantity("m", "(nodes,), mean gap over the period")
    slip_path: NDArray[np.float64] = quantity("m", "(nodes,), path slid in contact per cycle")
    contact_share: NDArray[np.float64] = quantity("1", "(nodes,), share of the period in contact")
    dissipated_energy: float = quantity("J")
    sliding_distance: float = quantity("m")  # area mean of the relative x displacement, peak to peak
    arm_range: float = quantity("m", default=0.0)  # of the moving specimen's holder along x, peak to peak
    approach: float = quantity("m", default=0.0)  # mean over the period of the specimens at their observed points


class CycleModel(Protocol[S]):
    """The vibrating joint as wear sees it: a slow state in, one steady period out, and the laws over cycles.

    A joint without such laws takes theirs from `WearAlone`.
    """

    @property
    def state_type(self) -> type[S]:
        """Return the record class of the state that one solution leaves for the next."""
        ...

    @property
    def areas(self) -> NDArray[np.float64]:
        """Return the contact area of each node, (nodes,), m^2."""
        ...

    @property
    def has_laws(self) -> bool:
        """Return whether anything but the depth changes the period or the wear rate over cycles."""
        ...

    @property
    def load_held(self) -> bool:
        """Return whether the normal load is held as faces wear, as by a weight; bolts let it go as they relax."""
        ...

    def initial(self) -> SlowState:
        """Return the start of the test."""
        ...

    def normal_flexibility(self, slow: SlowState) -> NDArray[np.float64]:
        """Return the static normal flexibility of the faces, (nodes, nodes), m/N.

        Back faces are held where the load is, and otherwise as they are.
        """
        ...

    def cycle(self, slow: SlowState, start: S | None) -> tuple[CycleResponse, S]:
        """Return the steady period of the joint in the state `slow`, and a state to start from.

        The result depends on the arguments alone, so that a resumed run repeats the same numbers.

        Raises
        ------
        NonConvergenceError
            If the period is not found.
        """
        ...

    def evolve(self, before: SlowState, cycles: float, worn: NDArray[np.float64], energy: float,
               response: CycleResponse) -> SlowState:
        """Return the slow state after a jump.

        Parameters
        ----------
        before
            The joint before the jump.
        cycles, worn, energy
            What the jump adds: cycles, depth (nodes,) in m of both faces, dissipated energy in J.
        response
            The period that stands for the jump.
        """
        ...

    def wear_factor(self, response: CycleResponse, slow: SlowState) -> NDArray[np.float64] | float:
        """Return the factor of the laws on Archard's wear rate, () or (nodes,)."""
        ...

    def opening_share(self, slow: SlowState, cycles: float) -> NDArray[np.float64] | float:
        """Return the share of the wear of a jump of `cycles` that opens the gap, () or (nodes,)."""
        ...

    def gap(self, slow: SlowState) -> NDArray[np.float64]:
        """Return the gap of the undeformed faces but for a constant, (nodes,), m."""
        ...


class WearAlone:
    """The laws over cycles of a joint that has none: a base for cycle models in which wear alone changes."""

    areas: NDArray[np.float64]
    has_laws = False
    load_held = True

    def initial(self) -> SlowState:
        """Return the unworn joint."""
        return SlowState.unworn(len(self.areas))

    def evolve(self, before: SlowState, cycles: float, worn: NDArray[np.float64], energy: float,
               response: CycleResponse) -> SlowState:
        """Return the slow state after a jump: it adds up."""
        return before.after(cycles, worn, energy)

    def wear_factor(self, response: CycleResponse, slow: SlowState) -> float:
        """Return 1: Archard's law as it is."""
        return 1.0

    def opening_share(self, slow: SlowState, cycles: float) -> float:
        """Return 1: all wear opens the gap."""
        return 1.0

    def gap(self, slow: SlowState) -> NDArray[np.float64]:
        """Return the depth: wear alone opens the gap."""
        return slow.depth


def settle(model: CycleModel[S], slow: SlowState, start: S | None, anew: bool = True) -> tuple[CycleResponse, S]:
    """Return the period of `model` in the state `slow`, found from `start` or, should that fail, `anew` from nothing.

    Raises
    ------
    NonConvergenceError
        If the period is not found.
    """
    try:
        return model.cycle(slow, start)
    except NonConvergenceError:
        if start is None or not anew:
            raise
        return model.cycle(slow, None)


def mean_response(one: CycleResponse, other: CycleResponse) -> CycleResponse:
    """Return the mean of two responses, field by field: the period that stands for a jump between them."""
    return CycleResponse(**{f.name: 0.5 * (getattr(one, f.name) + getattr(other, f.name))
                            for f in fields(CycleResponse)})


def summarise_cycle(displacement: NDArray[np.float64], force: NDArray[np.float64], slip: NDArray[np.float64],
                    in_contact: NDArray[np.bool_], gap: NDArray[np.float64],
                    areas: NDArray[np.float64]) -> CycleResponse:
    """Sum up one period of N samples.

    Parameters
    ----------
    displacement, force : ndarray, shape (N, nodes, 3), m and N
        Relative displacement, and contact force on the upper nodes (z positive in compression).
    slip : ndarray, shape (N, nodes), m
        Length of the tangential increment that ends at each sample, zero where the node is open.
    in_contact : ndarray of bool, shape (N, nodes)
        Whether the node is closed at the sample.
    gap : ndarray, shape (nodes,), m
        Gap of the undeformed faces, wear included.
    areas : ndarray, shape (nodes,), m^2
        Contact area of each node.
    """
    normal = np.maximum(force[:, :, 2], 0.0)
    return CycleResponse(
        pressure_sliding=np.einsum("jm,jm->m", normal, slip) / areas,
        mean_pressure=normal.mean(axis=0) / areas,
        mean_opening=np.maximum(gap + displacement[:, :, 2], 0.0).mean(axis=0),
        slip_path=slip.sum(axis=0),
        contact_share=in_contact.mean(axis=0),
        dissipated_energy=work_of_friction(displacement, force),
        sliding_distance=float(np.ptp(area_mean(displacement[:, :, 0], areas))))
