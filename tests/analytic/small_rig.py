"""A rig with nine contact nodes and what a recording of it holds, for the tests of the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from fretflow.contact.interface import Interface
from fretflow.experiments.rig.model import RigModel
from fretflow.experiments.rig.observation import Observation, Piece
from fretflow.pipeline.problem import rig_problem
from fretflow.recordings.schema import DisplacementOf, MeasuredAt, SweepCondition
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
FEW = np.flatnonzero((np.arange(49) // 7 % 3 == 0) & (np.arange(49) % 7 % 3 == 0))  # 3 x 3
POINTS = 1e-3 * DATA["x"][FEW, :2]
SOLVED, HARMONICS = 40, 10
SAMPLES = 2 * HARMONICS + 1


def observed(sd: Mapping[str, float], counts: Sequence[int], conditions: Sequence[SweepCondition], volume_sd: float,
             depth_sd: float) -> Observation:
    """Return zeros in place of loops and sweep of the channels of `sd`, volume and map, with these sd."""
    pieces: list[Piece] = []
    sizes: list[np.ndarray] = []

    def add(block: str, channel: str, cycles: int, condition: int | None, size: int, one: float, label: str) -> None:
        at = pieces[-1].stop if pieces else 0
        pieces.append(Piece(block=block, channel=channel, cycles=cycles, condition=condition, start=at, stop=at + size,
                            label=label))
        sizes.append(np.full(size, one))

    for channel, one in sd.items():
        for count in counts:
            add("loops", channel, count, None, SAMPLES, one, f"{count:,} cycles")
        for condition in conditions:
            add("sweep", channel, -1, condition.id, SAMPLES, one, f"condition {condition.id}")
    add("volume", "worn_volume", counts[-1], None, 1, volume_sd, "worn volume")
    add("map", "wear_depth", counts[-1], None, len(POINTS), depth_sd, "wear map")
    floor = np.concatenate(sizes)
    return Observation(values=np.zeros(len(floor)), variance=floor**2, noise=np.ones(len(floor)),
                       modes=np.zeros((len(floor), 0)), floor=floor, pieces=tuple(pieces),
                       harmonics=HARMONICS, aligned_to="excitation", conditions=tuple(conditions), points=POINTS)


def rig(observation: Observation, kept: np.ndarray = FEW) -> RigModel:
    """Return the rig with the nodes that are `kept` of 49, as `observation` looks at it."""
    dofs = (3 * kept[:, None] + np.arange(3)).ravel()
    stiffness = np.linalg.inv(np.linalg.inv(1e3 * DATA["K"])[np.ix_(dofs, dofs)])
    face = Interface(nodes=1e-3 * DATA["x"][kept, :2], areas=np.full(len(kept), 1e-6 / len(kept)),
                     gap=np.zeros(len(kept)))
    problem = rig_problem(
        joint=QuasiStaticJoint.from_stiffness(0.5 * (stiffness + stiffness.T),
                                              LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)),
        interface=face, friction_coefficient=0.8, frequency=100.0, excitation=65.0, normal_load=60.0)
    return RigModel(problem=problem, wear_coefficient=1.1e-14, observation=observation,
                    displacement_of=DisplacementOf(MeasuredAt.CONTACT_FACES), samples=SOLVED,
                    total_cycles=max(observation.counts))
