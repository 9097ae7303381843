"""Archard's law: worn volume in proportion to load and sliding.

J. F. Archard, Contact and rubbing of flat surfaces, J. Appl. Phys. 24 (1953), per node and per cycle as in
Tubita et al., equation (9)::

    r_m = K_w sum_j p_m,j |du_m,j|

with the pressure at the end of each increment. In gross slip with one friction coefficient mu the
dissipated energy is ``mu sum_m a_m sum_j p_m,j |du_m,j|``, so the volume per energy is K_w / mu exactly.
"""

from __future__ import annotations

from numbers import Real

import numpy as np
from numpy.typing import NDArray

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.wear.cycle import CycleResponse


@record
class Archard:
    """Archard's law with one coefficient K_w, ``Archard(1.1e-14)``; see this module for its form.

    Examples
    --------
    >>> import fretflow as ff
    >>> ff.Archard(1.1e-14).coefficient  # m^2/N: volume worn off both faces over load and sliding
    1.1e-14
    """

    coefficient: float = quantity("m^2/N", kw_only=False)
    upper_share: float = quantity("1", default=0.5)  # of the depth, taken from the upper face

    def check(self) -> None:
        """Check the ranges.

        Raises
        ------
        InputError
            If the coefficient is negative or no finite number, or the share none from 0 to 1.
        """
        if not (isinstance(self.coefficient, Real) and 0.0 <= self.coefficient < np.inf):
            raise InputError(f"wear coefficient: {self.coefficient!r} m^2/N is no finite number from 0 on")
        if not (isinstance(self.upper_share, Real) and 0.0 <= self.upper_share <= 1.0):
            raise InputError(f"upper_share: {self.upper_share!r} is no share from 0 to 1")


def wear_rate(coefficient: float, response: CycleResponse) -> NDArray[np.float64]:
    """Return the depth per cycle (nodes,), m, of both faces together; `coefficient` K_w in m^2/N."""
    return coefficient * response.pressure_sliding


def split_between_faces(depth: NDArray[np.float64],
                        upper_share: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the depths of the upper and of the lower face, m; together they are `depth`.

    The contact feels the total depth only. Its split is a statement: `upper_share` of it is taken from the
    upper face, one half for two faces of the same steel.
    """
    upper = upper_share * depth
    return upper, depth - upper
