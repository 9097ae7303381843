"""The contact interface: matching node pairs of two faces, their areas and the gap between them; sums over it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record


@record
class Interface:
    """Node pairs of the contact.

    The DOF order everywhere is x, y, z per node, node after node: DOF ``3 m + c`` is direction c of node m. Where nodes
    lie matters to pictures and to the form of faces alone; numbers of nodes (nodes,) stand for nodes all in one place.

    Examples
    --------
    >>> import fretflow as ff
    >>> import numpy as np
    >>> ff.Interface(nodes=np.array([[0.0, 0.0], [1e-3, 0.0]]), areas=np.full(2, 1e-6), gap=np.zeros(2)).size
    2
    >>> ff.Interface([7, 9], [1e-6, 1e-6], [0.0, 0.0]).size  # lists, and nodes by number
    2
    """

    nodes: NDArray[np.float64] = quantity("m", "(nodes, 2), in the plane of the contact", kw_only=False)
    areas: NDArray[np.float64] = quantity("m^2", "(nodes,)", kw_only=False)
    gap: NDArray[np.float64] = quantity("m", "(nodes,)", kw_only=False)

    def check(self) -> None:
        """Check shapes and signs.

        Raises
        ------
        InputError
            If the arrays do not match, a number is not finite or an area not positive.
        """
        for name in ("nodes", "areas", "gap"):
            if not isinstance(given := getattr(self, name), np.ndarray):  # a list, as one types it
                object.__setattr__(self, name, np.array(given))
        n = len(self.areas)
        if self.nodes.ndim == 1 and np.all(self.nodes % 1.0 == 0.0):
            object.__setattr__(self, "nodes", np.zeros((len(self.nodes), 2)))
        if self.nodes.shape != (n, 2) or self.gap.shape != (n,):
            raise InputError(f"interface: nodes {self.nodes.shape}, areas {self.areas.shape} and gap "
                             f"{self.gap.shape} do not match; give one row a node")
        finite = all(np.all(np.isfinite(one)) for one in (self.nodes, self.areas, self.gap))
        if not (finite and np.all(self.areas > 0.0)):
            raise InputError("interface: areas must be positive, and nodes, areas and gaps finite")

    @property
    def size(self) -> int:
        """Return the number of node pairs."""
        return len(self.areas)

    def mean(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the area mean (...) of values (..., nodes)."""
        return area_mean(values, self.areas)


def area_mean(values: NDArray[np.float64], areas: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean (...) of values (..., nodes) over areas (nodes,)."""
    return np.asarray(values @ areas / areas.sum())


def work_of_friction(displacement: NDArray[np.float64], force: NDArray[np.float64]) -> float:
    """Return the work of friction in a period, J, of relative displacements and forces (N, nodes, 3) at its samples."""
    steps = displacement[:, :, :2] - np.roll(displacement[:, :, :2], 1, axis=0)
    return -float(np.einsum("jmc,jmc->", force[:, :, :2], steps))
