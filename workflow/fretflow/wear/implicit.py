"""A linearly implicit cycle jump, whose length is bounded by accuracy and not by stability.

ROS2, a second-order Rosenbrock-W method (J. G. Verwer et al., A second-order Rosenbrock method applied to
photochemical dispersion problems, SIAM J. Sci. Comput. 20 (1999)), on dw/dn = r(w)::

    (1 - g dn J) k1 = r(w0)
    (1 - g dn J) k2 = r(w0 + dn k1) - 2 k1
    w1 = w0 + dn (3 k1 + k2) / 2,   g = 1 - 1 / sqrt 2

It keeps its order with any J, so the Jacobian with frozen slip path (see `feedback`) will do, and is
L-stable when J is exact: wear patterns that have settled stay settled however long the jump. The difference
to the embedded first-order solution ``w0 + dn k1`` estimates that one's error and controls the jump; the
error of w1 is far smaller. A jump takes two periodic solutions, and one more for each attempt that was too
long. Depth never falls.
"""

from __future__ import annotations

import math
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from fretflow.core.errors import NonConvergenceError
from fretflow.wear.archard import wear_rate
from fretflow.wear.cycle import settle
from fretflow.wear.history import WearStep
from fretflow.wear.scheme import WearingJoint, even_share

S = TypeVar("S")
GAMMA = 1.0 - math.sqrt(0.5)
SAFETY = 0.9
SHRINK, GROWTH = 0.2, 5.0
MAX_ATTEMPTS = 20


class Implicit(Generic[S]):
    """The implicit scheme: two periodic solutions a jump, error control, long jumps."""

    def __init__(self, joint: WearingJoint[S]) -> None:
        self.joint = joint

    def advance(self, now: WearStep, state: S) -> tuple[WearStep, S]:
        """Jump as far as the tolerance allows.

        Raises
        ------
        NonConvergenceError
            If no jump meets the tolerance; its history is that of the error estimates over the tolerance.
        """
        proposed = now.proposed_jump
        if math.isnan(proposed):
            proposed = min(self.joint.stable_jump(now), self.joint.shallow_jump(now))
        asked = self.joint.asked_jump(now) or math.inf
        solves, errors = now.solves, []
        for _ in range(MAX_ATTEMPTS):
            jump = even_share(self.joint.remaining(now), max(1.0, min(proposed, asked)))
            solves += 1
            try:
                depth, error, middle = self.attempt(now, jump, state)
            except NonConvergenceError:
                if jump == 1:
                    raise
                proposed = SHRINK * jump
                continue
            errors.append(error)
            factor = min(GROWTH, max(SHRINK, SAFETY / math.sqrt(error))) if error > 0.0 else GROWTH
            if error <= 1.0 or jump == 1:
                # A jump that was cut to land on an asked count says nothing against the length proposed.
                following = max(factor * jump, proposed if jump < proposed else 0.0)
                return self.joint.settled(now.cycles + jump, depth, middle, solves + 1, following)
            proposed = factor * jump
        raise NonConvergenceError(f"no implicit jump meets the tolerance in {MAX_ATTEMPTS} attempts; "
                                  "use scheme = \"explicit\"", history=errors)

    def attempt(self, now: WearStep, jump: int, state: S) -> tuple[NDArray[np.float64], float, S]:
        """Return the depth (nodes,), m, after `jump` cycles, its error over the tolerance, and a state."""
        settings = self.joint.settings
        jacobian = self.joint.feedback.rate_jacobian(settings.coefficient, now.response)
        factors = lu_factor(np.eye(len(now.depth)) - GAMMA * jump * jacobian)
        first = lu_solve(factors, now.rate)
        # The stage may ask a node to rise: it keeps its depth, as worn metal does.
        response, middle = settle(self.joint.model, now.depth + jump * np.maximum(first, 0.0), state)
        second = lu_solve(factors, wear_rate(settings.coefficient, response) - 2.0 * first)
        depth = now.depth + jump * np.maximum(1.5 * first + 0.5 * second, 0.0)
        error = 0.5 * jump * float(np.abs(first + second).max())
        return depth, error / (settings.tolerance * float(depth.max())), middle
