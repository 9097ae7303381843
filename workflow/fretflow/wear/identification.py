"""The wear coefficient that a measured volume asks for, and the face on which long tests slide.

Wear at constant coefficient obeys ``dw/dn = K_w q(w)``, where q is what one period does to a contact worn by w
(Archard's p |du| summed up). With ``tau = K_w n`` this is ``dw/dtau = q(w)``: the history depends on the product
K_w n alone. One history, of any coefficient, is therefore the volume ``V(tau)`` of all of them, and a volume
measured after n cycles asks for ``K_w = tau(V) / n``. V rises, so tau(V) is unique while anything wears. It need not be
proportional: the worn face slides by another distance than the new one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.wear.history import WearHistory

TWO_SIDED_95 = 1.959964  # of the normal distribution


@record
class WearCoefficient:
    """K_w with its standard deviation, both from the volume's."""

    value: float = quantity("m^2/N")
    sd: float = quantity("m^2/N")
    proportional: float = quantity("m^2/N")  # what a volume proportional to K_w would ask for
    unworn: float = quantity("m^2/N")  # what the rate of the unworn contact would ask for

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval in m^2/N, from the volume's standard deviation alone."""
        return self.value - TWO_SIDED_95 * self.sd, self.value + TWO_SIDED_95 * self.sd


def identify_wear_coefficient(history: WearHistory, areas: NDArray[np.float64], coefficient: float, cycles: int,
                              volume: float, volume_sd: float) -> WearCoefficient | None:
    """Return the coefficient with which `volume` is worn after `cycles`; None if `history` does not go that far.

    Parameters
    ----------
    history : WearHistory
        Of the same joint and load, with any constant `coefficient`. Between its steps the volume is the cubic that
        has the volumes and rates of both, which is of fourth order in the jump.
    areas : ndarray, shape (nodes,), m^2
    coefficient : float
        K_w of `history`, m^2/N.
    cycles : int
        After which the volume was measured.
    volume, volume_sd : float
        m^3.

    Raises
    ------
    InputError
        If wear ends before the volume is reached, or nothing wears.
    """
    rate = history.rate @ areas
    if not coefficient * rate[0] > 0.0:
        raise InputError("worn_volume: nothing wears in the model, so that no coefficient follows; raise the "
                         "excitation or wear.coefficient")
    if volume > history.volume[-1]:
        if history.stopped_by != "cycles":
            raise InputError(f"worn_volume: wear ends at {history.volume[-1] * 1e9:.4g} mm³ in the model, whatever "
                             f"the coefficient; {volume * 1e9:.4g} mm³ asks for another load, rig or specimen")
        return None
    curve = CubicHermiteSpline(coefficient * history.cycles, history.volume, rate / coefficient)
    after = int(np.searchsorted(history.volume, volume))
    low, high = (coefficient * float(history.cycles[k]) for k in (after - 1, after))
    tau = float(brentq(lambda t: float(curve(t)) - volume, low, high, xtol=1e-12 * high))
    slope = float(curve.derivative()(tau))
    return WearCoefficient(
        value=tau / cycles, sd=volume_sd / (slope * cycles),
        proportional=coefficient * float(history.cycles[-1] / history.volume[-1]) * volume / cycles,
        unworn=coefficient * volume / (float(rate[0]) * cycles))


def settled_face(flexibility: NDArray[np.float64], areas: NDArray[np.float64], gap: NDArray[np.float64],
                 normal_load: float) -> NDArray[np.float64]:
    """Return the depth (nodes,), m, at which `normal_load` (N) is carried with the same pressure everywhere.

    It is where the wear of a face in gross slip settles, since all of it slides alike (Archard); the least such
    depth, zero at one node. With normal `flexibility` F (nodes, nodes), m/N, and ``f = p a``: all nodes are closed
    when ``gap + depth + F f + q = 0``.
    """
    uplift = flexibility @ (normal_load * areas / areas.sum()) + gap
    return np.asarray(uplift.max() - uplift)
