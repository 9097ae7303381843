"""A linearly implicit cycle jump, whose length is bounded by accuracy and not by stability.

ROS2, a second-order Rosenbrock-W method (J. G. Verwer et al., A second-order Rosenbrock method applied to
photochemical dispersion problems, SIAM J. Sci. Comput. 20 (1999)), on dw/dn = r(w)::

    (1 - g dn J) k1 = r(w0) + g dn r'
    (1 - g dn J) k2 = r(w0 + dn k1) - 2 k1 - g dn r'
    w1 = w0 + dn (3 k1 + k2) / 2,   g = 1 -+ 1 / sqrt 2

r' is how the rate changes at held depth, by laws over cycles. The method keeps its order with any J and r', so
the Jacobian with frozen slip path (see `feedback`) will do, and is L-stable when J is exact: wear patterns that
have settled stay settled however long the jump. Of patterns that settle within a jump, at t times the rate that J has
for them, ``1 - 2 t / g + (t / g)^2 / 2`` is left: with the smaller g, whose errors are a sixth, they grow from jump to
jump where t is over 1.17; with the larger, where it is over 6.8. So a jump of which such patterns are the largest error
is made with the larger g.

At the border of a scar nodes come to touch, and others leave: J is of the nodes that touch g dn cycles on, as the
contact problem has it with a layer that yields to force as wear does, and r(w0) is as if these touched at once, less
what nodes that are still open must approach first.

The difference to the embedded first-order solution ``w0 + dn k1`` estimates that one's error and controls the jump;
the error of w1 is far smaller. Of a deep scar a small share of the depth lifts nodes off: an error that takes from a
node as much as the mean pressure is too large as well. A jump takes two periodic solutions, and one more for each
attempt that was too long or wanted the larger g. Depth never falls.

The dissipated energy is a further component of w with J = 0: k1 and k1 + k2 are the energies of the first and
the second period, so that E1 is their trapezoid. The laws over cycles remember by their own solution over the
jump, and the second stage sees cycles, energy and memory at its end: the order holds for all of them together.
Where there are such laws, the energy's error controls the jump as the depth's does.
"""

from __future__ import annotations

import math
from typing import Generic, TypeVar

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from fretflow.core.errors import NonConvergenceError
from fretflow.wear.cycle import mean_response, settle
from fretflow.wear.history import WearStep
from fretflow.wear.scheme import SHRINK, WearingJoint, even_share, relative, resized
from fretflow.wear.slow import SlowState

S = TypeVar("S")
ACCURATE, DAMPING = 1.0 - math.sqrt(0.5), 1.0 + math.sqrt(0.5)  # g
MAX_ATTEMPTS = 20


class Implicit(Generic[S]):
    """The implicit scheme: two periodic solutions a jump, error control, long jumps.

    A period that is not found near the last one asks for a shorter jump: from nothing, which is a hundred times slower,
    it is sought where nothing shorter is left that would be another state, and only by a scheme that may begin `anew`.
    """

    def __init__(self, joint: WearingJoint[S], anew: bool = True) -> None:
        self.joint = joint
        self.anew = anew

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
        asked = self.joint.asked_jump(now)
        solves, failed, anew, gamma = now.solves, [], False, ACCURATE
        for _ in range(MAX_ATTEMPTS):
            jump = even_share(self.joint.remaining(now), max(1.0, min(proposed, asked)))
            solves += 1
            try:
                end, errors, middle = self.attempt(now, jump, state, anew, gamma)
                error = max(errors)
                factor = resized(error)
                if gamma == ACCURATE and errors[1] == error > 0.0:
                    gamma = DAMPING
                    continue
                if error <= 1.0 or jump == 1:
                    # A jump that was cut to land on an asked count says nothing against the length proposed.
                    following = max(factor * jump, proposed if jump < proposed else 0.0)
                    return self.joint.settled(end, middle, solves + 1, following, anew)
            except NonConvergenceError:
                last = jump == 1 or self.joint.is_short(now, jump)
                if last and (anew or not self.anew):
                    raise
                anew, proposed = last, jump if last else SHRINK * jump
                continue
            failed.append(error)
            proposed = factor * jump
        raise NonConvergenceError(f"no implicit jump meets the tolerance in {MAX_ATTEMPTS} attempts; "
                                  "use scheme = \"explicit\"", history=failed)

    def attempt(self, now: WearStep, jump: int, state: S, anew: bool = False, gamma: float = ACCURATE
                ) -> tuple[SlowState, tuple[float, float, float], S]:
        """Return the slow state after `jump` cycles, its errors over what is allowed, and a state.

        The errors are those of the depth, of the pressure that this takes from a node, and of the energy.
        """
        joint, model, before = self.joint, self.joint.model, now.response
        linear = joint.linearised(now, jump, gamma * jump)
        factors = lu_factor(np.eye(len(now.depth)) - gamma * jump * linear.by_depth)
        first = lu_solve(factors, linear.rate + gamma * linear.over_jump)
        # The stage may ask a node to rise: it keeps its depth, as worn metal does.
        stage = model.evolve(now.slow, jump, jump * np.maximum(first, 0.0), jump * before.dissipated_energy, before)
        response, middle = settle(model, stage, state, anew)
        second = lu_solve(factors, joint.rate(response, stage) - 2.0 * first - gamma * linear.over_jump)
        worn = jump * np.maximum(1.5 * first + 0.5 * second, 0.0)
        energy = 0.5 * jump * (before.dissipated_energy + response.dissipated_energy)
        end = model.evolve(now.slow, jump, worn, energy, mean_response(before, response))
        missed = 0.5 * jump * (first + second)
        error = relative(float(np.abs(missed).max()), joint.settings.tolerance * float(end.depth.max()))
        # of what settles within the jump 1 - 1 / g is missed: neither that nor what there is to settle may lift a node
        unloading = joint.unloaded_by(missed, now) / min(1.0, abs(1.0 - 1.0 / gamma))
        return end, (error, unloading, joint.energy_error(end, jump, before, response)), middle
