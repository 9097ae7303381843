"""Parameter directions: where and how a parameter acts on the equations of the period.

A direction is the derivative of the model's data by one parameter, all else held. An effect adds its own by making a
`Direction`; linear combinations of parameters (a wear depth, a tilt) are directions too. Friction and normal load are
given as histories over the samples: they may depend on the solution, as a friction that changes with speed does.
"""

from __future__ import annotations

import numpy as np

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.solvers.quasi_static.sample import Array
from fretflow.structure.two_mass_rig.lumped import LumpedRig


@record
class Direction:
    """Derivative of the model's data by one parameter; units are per unit of the parameter.

    Arrays over the nodes are in node order (x, y, z per node where they have 3 n entries). None: does not act there.
    """

    name: str
    friction: Array | None = quantity("1", "(N, nodes), of the coefficient", default=None)
    normal_load: Array | None = quantity("N", "(N,)", default=None)
    gap: Array | None = quantity("m", "(nodes,)", default=None)
    flexibility: Array | None = quantity("m/N", "(3 n, 3 n), of the faces against each other, springs in series",
                                         default=None)
    locked: Array | None = quantity("m", "(nodes, 2), where nodes that stick all the period sit", default=None)
    rig: LumpedRig | None = None
    force: Array | None = quantity("N", "(N, 2), on block and arm, x, drive included", default=None)

    @property
    def acts_in_contact(self) -> bool:
        """Return whether the contact changes at a given motion of the arm."""
        return any(part is not None for part in (self.friction, self.normal_load, self.gap, self.flexibility,
                                                 self.locked))

    def validate(self, samples: int, nodes: int) -> None:
        """Check the shapes for a period of `samples` and a contact of `nodes`.

        Raises
        ------
        InputError
            Naming the direction and its part.
        """
        shapes = {"friction": (samples, nodes), "normal_load": (samples,), "gap": (nodes,),
                  "flexibility": (3 * nodes, 3 * nodes), "locked": (nodes, 2), "force": (samples, 2)}
        for part, wanted in shapes.items():
            value = getattr(self, part)
            if value is not None and np.shape(value) != wanted:
                raise InputError(f"direction {self.name}: {part} has shape {np.shape(value)}; give {wanted} "
                                 f"for {nodes} nodes and {samples} samples")


def gap(weights: Array, name: str = "gap") -> Direction:
    """Return a pattern `weights` (nodes,) of the gap, 1 where it opens by the parameter."""
    return Direction(name=name, gap=weights)


def gap_of_each_node(nodes: int) -> list[Direction]:
    """Return the gap of every one of `nodes` nodes by itself."""
    return [gap(row, f"gap of node {m}") for m, row in enumerate(np.eye(nodes))]


def rig_force(history: Array, name: str) -> Direction:
    """Return a force `history` (N, 2) on block and arm in N, also what a spring or dashpot there would do."""
    return Direction(name=name, force=history)
