"""How wear depth feeds back on pressure, and the longest explicit jump that this allows.

With a normal load N held by a free vertical motion q and the forces f of the closed nodes c::

    F_cc f + q 1 = -(gap + w),   1^T f = N
    df = -(S - S 1 (1^T S 1)^-1 1^T S) dw,   S = F_cc^-1

A worn node unloads itself and loads its neighbours. With the slip path s frozen, the wear rate ``r_m = K_w
s_m f_m / a_m`` has the Jacobian ``J = -diag(K_w s / a) C`` with the bracket C, positive semi-definite, so
that its eigenvalues are real and not positive. Explicit Euler is stable while ``dN |J|_max < 2``, and free
of overshoot up to half of it. For a uniform sliding pressure p this is a depth of ``2 p / k_max``, k_max
the largest stiffness per area: about ``2 p h / E*`` on a mesh of element side h.
Where the surroundings hold the faces instead of the load, C is S.

Where the wear rate follows another law than Archard's, its slope by the pressure takes the place of K_w, node by node.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, eigvalsh

from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.wear.capped_contact import MAX_SET_CHANGES
from fretflow.wear.cycle import CycleResponse

Coefficient = float | NDArray[np.float64]  # K_w in m^2/N, () or (nodes,)


class Feedback:
    """The linear response of nodal contact forces to wear depth.

    Parameters
    ----------
    flexibility : ndarray, shape (nodes, nodes), m/N
        Normal flexibility of the faces against each other.
    areas : ndarray, shape (nodes,), m^2
        Contact area of each node.
    load_held : bool
        Whether the normal load stays as it is.

    Raises
    ------
    InputError
        If the flexibility is not symmetric and positive definite.
    """

    def __init__(self, flexibility: NDArray[np.float64], areas: NDArray[np.float64],
                 load_held: bool = True) -> None:
        scale = np.abs(flexibility).max()
        if not np.abs(flexibility - flexibility.T).max() <= 1e-6 * scale:
            raise InputError("normal_flexibility: is not symmetric; give the static flexibility of the joint")
        self.flexibility = 0.5 * (flexibility + flexibility.T)
        self.areas, self.load_held = areas, load_held

    def unloading(self, closed: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return C = -df/dw (nodes, nodes), N/m; zero at open nodes."""
        result = np.zeros_like(self.flexibility)
        index = np.flatnonzero(closed)
        if index.size < 1 + self.load_held:  # a single node carries a held load whatever its depth
            return result
        try:
            factor = cho_factor(self.flexibility[np.ix_(index, index)])
        except np.linalg.LinAlgError as error:
            raise InputError("normal_flexibility: is not positive definite; give the static one") from error
        stiffness = cho_solve(factor, np.eye(index.size))
        if self.load_held:
            sums = stiffness.sum(axis=0)
            stiffness = stiffness - np.outer(sums, sums) / sums.sum()
        result[np.ix_(index, index)] = stiffness
        return result

    def rate_jacobian(self, coefficient: Coefficient, response: CycleResponse,
                      closed: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """Return d(rate)/d(depth) (nodes, nodes), 1/cycle, with the slip path frozen, of the `closed` nodes.

        By default those are closed that touch in the period.
        """
        touch = response.contact_share > 0.0
        return -self.rate_by_force(coefficient, response)[:, None] * self.unloading(touch if closed is None else closed)

    def rate_by_force(self, coefficient: Coefficient, response: CycleResponse) -> NDArray[np.float64]:
        """Return the change of each node's wear rate by its force, (nodes,), m/(cycle N), with the slip path frozen.

        Nodes that are open slide and wear as those do, in the mean, that touch.
        """
        by_pressure = np.broadcast_to(coefficient * response.slip_path, self.areas.shape)
        touch = response.contact_share > 0.0
        mean = np.average(by_pressure[touch], weights=self.areas[touch]) if touch.any() else 0.0
        return np.asarray(np.where(touch, by_pressure, mean) / self.areas)

    def touching(self, response: CycleResponse, worn: NDArray[np.float64], softness: NDArray[np.float64]
                 ) -> NDArray[np.bool_]:
        """Return which nodes (nodes,) touch once the faces wear.

        Parameters
        ----------
        response
            The period before that.
        worn : (nodes,), m
            Depth that nodes would lose under the forces of that period.
        softness : (nodes,), m/N
            How much less that is for each newton that they lose: of a backward Euler step, a layer of such flexibility.
        """
        closed, clearance = response.contact_share > 0.0, _clearance(response)
        for _ in range(MAX_SET_CHANGES):
            change, approach = self._moved(response, closed, clearance + worn, softness)
            opening = self.flexibility @ change + softness * change + approach + clearance + worn
            following = np.where(closed, self._forces(response) + change > 0.0, opening < 0.0)
            if np.array_equal(following, closed):
                return closed
            closed = following
        return response.contact_share > 0.0  # laws that fall with pressure may let no set hold: the jump's error tells

    def force_change(self, response: CycleResponse, closed: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return how the forces (nodes,), N, would change if just the nodes `closed` touched, and pulled if need be."""
        return self._moved(response, closed, _clearance(response), np.zeros_like(self.areas))[0]

    def _forces(self, response: CycleResponse) -> NDArray[np.float64]:
        return response.mean_pressure * self.areas

    def _moved(self, response: CycleResponse, closed: NDArray[np.bool_], opening: NDArray[np.float64],
               softness: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """Return the change of forces (nodes,), N, and the vertical motion, m, that keep `closed` nodes in touch.

        Their gaps grow by `opening` (nodes,), m; the others carry nothing.
        """
        change = np.where(closed, 0.0, -self._forces(response))
        index = np.flatnonzero(closed)
        if not index.size:
            return change, 0.0
        matrix = self.flexibility[np.ix_(index, index)] + np.diag(softness[index])
        right = -(self.flexibility[index] @ change + opening[index])
        if not self.load_held:
            change[index] = np.linalg.solve(matrix, right)
            return change, 0.0
        bordered = np.block([[matrix, np.ones((index.size, 1))], [np.ones(index.size), 0.0]])
        *change[index], approach = np.linalg.solve(bordered, np.r_[right, -change.sum()])
        return change, float(approach)

    def fastest_decay(self, coefficient: Coefficient, response: CycleResponse) -> float:
        """Return the largest eigenvalue of minus `rate_jacobian`, 1/cycle; 0 when nothing wears.

        Nodes whose wear falls with pressure, as a law may have it, are left out: nothing decays there.

        Raises
        ------
        NonConvergenceError
            If the wear has grown beyond all bounds.
        """
        root = np.sqrt(np.maximum(coefficient, 0.0) * response.slip_path / self.areas)
        if not np.all(np.isfinite(root)):
            raise NonConvergenceError("the wear of a cycle is not finite; the law of wear leads beyond its range")
        matrix = root[:, None] * self.unloading(response.contact_share > 0.0) * root
        return _largest(matrix)

    def depth_scale(self, response: CycleResponse) -> float:
        """Return the depth in m whose stiffest pattern takes up the mean pressure: about p h / E*."""
        closed = response.contact_share > 0.0
        root = 1.0 / np.sqrt(self.areas)
        stiffness = _largest(root[:, None] * self.unloading(closed) * root)
        mean = float(self.areas @ response.mean_pressure) / float(self.areas[closed].sum() or np.inf)
        return mean / stiffness if stiffness > 0.0 else np.inf

    def stability_bound(self, coefficient: Coefficient, response: CycleResponse) -> float:
        """Return the number of cycles (inf if unbounded) beyond which an explicit jump amplifies errors."""
        decay = self.fastest_decay(coefficient, response)
        return 2.0 / decay if decay > 0.0 else np.inf


def _clearance(response: CycleResponse) -> NDArray[np.float64]:
    """Return how far open nodes are apart, (nodes,), m; 0 where they touch."""
    return np.where(response.contact_share > 0.0, 0.0, response.mean_opening)


def _largest(matrix: NDArray[np.float64]) -> float:
    """Return the largest eigenvalue of a symmetric, positive semi-definite matrix."""
    last = len(matrix) - 1
    try:
        largest = eigvalsh(matrix, subset_by_index=(last, last))[0]
    except np.linalg.LinAlgError:  # LAPACK's choice of single eigenvalues may fail where many are equal
        largest = eigvalsh(matrix, driver="ev")[last]
    return max(0.0, float(largest))
