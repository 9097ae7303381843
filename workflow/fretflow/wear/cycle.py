"""What wear needs to know of one vibration period, and the protocol that provides it.

Wear and the periodic solution are siblings: wear sees the period only through `CycleModel`.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import NonConvergenceError
from fretflow.core.records import quantity, record

S = TypeVar("S")


@record
class CycleResponse:
    """What one period does to the contact at a given wear depth.

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


class CycleModel(Protocol[S]):
    """The vibrating joint as wear sees it: a wear depth in, one steady period out."""

    @property
    def state_type(self) -> type[S]:
        """Return the record class of the state that one solution leaves for the next."""
        ...

    @property
    def areas(self) -> NDArray[np.float64]:
        """Return the contact area of each node, (nodes,), m^2."""
        ...

    @property
    def normal_flexibility(self) -> NDArray[np.float64]:
        """Return the static normal flexibility of the faces, back faces held, (nodes, nodes), m/N."""
        ...

    def cycle(self, depth: NDArray[np.float64], start: S | None) -> tuple[CycleResponse, S]:
        """Return the steady period with `depth` (nodes,), m, added to the gap, and a state to start from.

        The result depends on the arguments alone, so that a resumed run repeats the same numbers.

        Raises
        ------
        NonConvergenceError
            If the period is not found.
        """
        ...


def settle(model: CycleModel[S], depth: NDArray[np.float64], start: S | None) -> tuple[CycleResponse, S]:
    """Return the period at `depth`, found from `start` or, should that fail, from nothing.

    Raises
    ------
    NonConvergenceError
        If the period is not found from nothing either.
    """
    try:
        return model.cycle(depth, start)
    except NonConvergenceError:
        if start is None:
            raise
        return model.cycle(depth, None)


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
    steps = displacement[:, :, :2] - np.roll(displacement[:, :, :2], 1, axis=0)
    mean_x: Any = displacement[:, :, 0] @ areas / areas.sum()
    return CycleResponse(
        pressure_sliding=np.einsum("jm,jm->m", normal, slip) / areas,
        mean_pressure=normal.mean(axis=0) / areas,
        mean_opening=np.maximum(gap + displacement[:, :, 2], 0.0).mean(axis=0),
        slip_path=slip.sum(axis=0),
        contact_share=in_contact.mean(axis=0),
        dissipated_energy=-float(np.einsum("jmc,jmc->", force[:, :, :2], steps)),
        sliding_distance=float(np.ptp(mean_x)))
