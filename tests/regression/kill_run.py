"""A small run of two stages, solve and wear, in a process that a test may kill at any moment."""

from pathlib import Path

import numpy as np
from fretflow.case.config import Solver, validate_case
from fretflow.contact.interface import Interface
from fretflow.core.store import write_record
from fretflow.effects.cycle import PeriodicCycle
from fretflow.pipeline.problem import rig_problem
from fretflow.pipeline.ranks import Ranks
from fretflow.pipeline.runner import Runner
from fretflow.pipeline.stage import Stage
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.history import WearSettings
from fretflow.wear.march import run_history

DATA = Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz"
SETTINGS = WearSettings(coefficient=1.1e-14, cycles=10_000, stops=(3_000,), max_depth_per_jump=4e-8)
CASE = {"format": "fretflow-case/1", "name": "kill", "test": {"excitation_amplitude": "75 N", "cycles": 10_000}}
SOLVER = Solver(harmonics=5, samples=24, estimate_error=False)


def problem():
    """Return the reference joint seen at 9 of its 49 nodes, a third of a millimetre apart."""
    data = np.load(DATA)
    position = data["x"][:, :2] * 1e-3
    centred = np.round((position - position.mean(axis=0)) / np.ptp(position, axis=0).max() * 6).astype(int)
    kept = np.flatnonzero(np.all(centred % 3 == 0, axis=1))
    dofs = (3 * kept[:, None] + np.arange(3)).ravel()
    stiffness = np.linalg.inv(np.linalg.inv(data["K"] * 1e3)[np.ix_(dofs, dofs)])
    share = np.where(np.abs(centred[kept]) == 3, 0.25, 0.5)
    return rig_problem(
        joint=QuasiStaticJoint.from_stiffness(0.5 * (stiffness + stiffness.T),
                                              LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)),
        interface=Interface(nodes=position[kept], areas=share.prod(axis=1) * 1e-6, gap=np.zeros(len(kept))),
        friction_coefficient=0.88, frequency=100.0, excitation=75.0, normal_load=60.0)


def solve(context):
    write_record(context.folder / "solution.h5", QuasiStaticSolver(SOLVER).solve(problem()))
    return {}


def wear(context):
    model = PeriodicCycle(QuasiStaticSolver(SOLVER), problem())
    history = run_history(model, SETTINGS, context.folder / "checkpoints")
    write_record(context.folder / "history.h5", history)
    return {"jumps": len(history.cycles) - 1}


class Silent:
    def begin(self, stage):
        pass

    def advance(self, stage, share, text):
        pass

    def end(self, result):
        pass


def run(out):
    stages = [Stage("solve", 1, lambda case: case.test.normal_load, (), solve),
              Stage("wear", 1, lambda case: case.test.total_cycles, ("solve",), wear)]
    return Runner(stages, Path(out), Ranks(), Silent()).run(validate_case(CASE))
