"""Parameter directions: where and how a parameter acts on the equations of the period.

A direction is the derivative of the model's data by one parameter, all else held. An effect adds its own by making a
`Direction`; linear combinations of parameters (a wear depth, a tilt) are directions too. What depends on the
solution, such as a friction coefficient that changes with speed, is given as a history over the samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record
from fretflow.solvers.quasi_static.sample import Array
from fretflow.structure.two_mass_rig.lumped import LumpedRig

_NO_RIG = LumpedRig(moving_mass=0.0, arm_mass=0.0, ground_stiffness=0.0, hinge_stiffness=0.0, ground_damping=0.0,
                    hinge_damping=0.0)


@record
class Direction:
    """Derivative of the model's data by one parameter; units are per unit of the parameter.

    Arrays over the nodes are in node order (x, y, z per node where they have 3 n entries). None: does not act there.
    """

    name: str
    friction: Array | float | None = quantity("1", "(), (nodes,) or (N, nodes)", default=None)
    normal_load: Array | float | None = quantity("N", "() or (N,)", default=None)
    gap: Array | None = quantity("m", "(nodes,)", default=None)
    compliance: Array | None = quantity("m/N", "(3 n,), springs in series with each DOF", default=None)
    flexibility: Array | None = quantity("m/N", "(3 n, 3 n), of the faces against each other", default=None)
    locked: Array | None = quantity("m", "(nodes, 2), where nodes that stick all the period sit", default=None)
    rig: LumpedRig | None = None
    excitation: float = quantity("N", default=0.0)
    frequency: float = quantity("Hz", default=0.0)
    force: Array | None = quantity("N", "(N, 2), on block and arm, x", default=None)

    @property
    def acts_in_contact(self) -> bool:
        """Return whether the contact changes at a given motion of the arm."""
        return any(part is not None for part in (self.friction, self.normal_load, self.gap, self.compliance,
                                                 self.flexibility, self.locked))

    def validate(self, samples: int, nodes: int) -> None:
        """Check the shapes for a period of `samples` and a contact of `nodes`.

        Raises
        ------
        InputError
            Naming the direction and its part.
        """
        allowed: dict[str, tuple[tuple[int, ...], ...]] = {
            "friction": ((), (nodes,), (samples, nodes)), "normal_load": ((), (samples,)), "gap": ((nodes,),),
            "compliance": ((3 * nodes,),), "flexibility": ((3 * nodes, 3 * nodes),), "locked": ((nodes, 2),),
            "force": ((samples, 2),)}
        for part, shapes in allowed.items():
            value = getattr(self, part)
            shape = getattr(value, "shape", ())
            if value is not None and shape not in shapes:
                wanted = " or ".join(map(str, shapes))
                raise InputError(f"direction {self.name}: {part} has shape {shape}; give {wanted} "
                                 f"for {nodes} nodes and {samples} samples")


def friction(weights: Array | float = 1.0) -> Direction:
    """Return the friction coefficient, or a pattern `weights` of it over the nodes, and samples if it varies."""
    return Direction(name="friction", friction=weights)


def normal_load(weights: Array | float = 1.0) -> Direction:
    """Return the normal load, or a history `weights` (N,) of it."""
    return Direction(name="normal load", normal_load=weights)


def gap(weights: Array, name: str = "gap") -> Direction:
    """Return a pattern `weights` (nodes,) of the gap, 1 where it opens by the parameter."""
    return Direction(name=name, gap=weights)


def gap_of_each_node(nodes: int) -> list[Direction]:
    """Return the gap of every one of `nodes` nodes by itself."""
    return [gap(row, f"gap of node {m}") for m, row in enumerate(np.eye(nodes))]


def compliance(weights: Array, name: str = "compliance") -> Direction:
    """Return springs in series with the contact, `weights` (3 n,) of the parameter at each DOF."""
    return Direction(name=name, compliance=weights)


def flexibility(matrix: Array, name: str = "flexibility") -> Direction:
    """Return a change `matrix` (3 n, 3 n) of the faces' flexibility; G itself scales it, -G scales the stiffness."""
    return Direction(name=name, flexibility=matrix)


def locked(weights: Array) -> Direction:
    """Return a pattern `weights` (nodes, 2) of the positions at which permanently stuck nodes were left."""
    return Direction(name="locked", locked=weights)


def rig_part(name: str) -> Direction:
    """Return one of the masses, springs and dashpots of a `LumpedRig`, such as ``hinge_stiffness``."""
    return Direction(name=name.replace("_", " "), rig=replace(_NO_RIG, **{name: 1.0}))  # type: ignore[arg-type]


def excitation() -> Direction:
    """Return the amplitude of the excitation."""
    return Direction(name="excitation", excitation=1.0)


def frequency() -> Direction:
    """Return the frequency of the excitation; histories are compared at equal phase, not at equal time."""
    return Direction(name="frequency", frequency=1.0)


def rig_force(history: Array, name: str) -> Direction:
    """Return a force `history` (N, 2) on block and arm in N, also what a spring or dashpot there would do."""
    return Direction(name=name, force=history)
