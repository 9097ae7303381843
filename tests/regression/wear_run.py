"""A run of one wear stage on the reference stiffness, as a process of its own that a test can kill.

``python wear_run.py OUT`` writes to OUT and reports each step on stdout.
"""

import sys
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
SETTINGS = WearSettings(coefficient=1.1e-14, cycles=60_000, stops=(20_000,))
CASE = {
    "format": "fretflow-case/1",
    "name": "wear",
    "test": {"excitation_amplitude": "75 N", "cycles": 60_000},
}


def say(text):
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def problem():
    data = np.load(DATA)
    side = np.unique(data["x"][:, 0]) * 1e-3
    share = np.full(len(side), side[1] - side[0])
    share[[0, -1]] *= 0.5
    areas = np.outer(share, share)[np.searchsorted(side, data["x"][:, 0] * 1e-3 - 1e-12),
                                   np.searchsorted(side, data["x"][:, 1] * 1e-3 - 1e-12)]
    rig = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
    return rig_problem(
        joint=QuasiStaticJoint.from_stiffness(data["K"] * 1e3, rig),
        interface=Interface(nodes=data["x"][:, :2] * 1e-3, areas=areas, gap=np.zeros(len(areas))),
        friction_coefficient=0.88, frequency=100.0, excitation=75.0, normal_load=60.0)


def wear(context):
    solver = QuasiStaticSolver(Solver(harmonics=7, samples=64, estimate_error=False))

    def report(done, asked):
        say(done)

    history = run_history(PeriodicCycle(solver, problem()), SETTINGS, context.folder / "checkpoints", report)
    write_record(context.folder / "history.h5", history)
    return {"jumps": len(history.cycles) - 1}


class Silent:
    def begin(self, stage):
        say("begin")

    def advance(self, stage, share, text):
        pass

    def end(self, result):
        say(f"end {result.folder}")


if __name__ == "__main__":
    stage = Stage("wear", 1, lambda case: case.test.total_cycles, (), wear)
    Runner([stage], Path(sys.argv[1]), Ranks(), Silent()).run(validate_case(CASE))
