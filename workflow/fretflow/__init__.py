"""fretflow: vibration and fretting wear of structures held together by friction.

``import fretflow as ff`` gives the names below; each is imported when it is first used, so that the import itself and
the command line start at once. Everything is in SI. ``docs/architecture.md`` tells how the parts fit together, and
``examples/`` shows them at work.

The import gives OpenBLAS one thread, unless the environment says how many or NumPy is there already: the contact's
matrices have a few hundred rows, where a second thread waits more than it works.
"""

import ast
import os
import sys
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

if not {"numpy", "scipy"} & sys.modules.keys() and "OMP_NUM_THREADS" not in os.environ:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if TYPE_CHECKING:
    from fretflow.case.config import Case as Case
    from fretflow.case.config import load_case as load_case
    from fretflow.contact.coulomb import Coulomb as Coulomb
    from fretflow.contact.interface import Interface as Interface
    from fretflow.core import units as units
    from fretflow.core.errors import AuditError as AuditError
    from fretflow.core.errors import FretflowError as FretflowError
    from fretflow.core.errors import FretflowWarning as FretflowWarning
    from fretflow.core.errors import HeavyContactWarning as HeavyContactWarning
    from fretflow.core.errors import InputError as InputError
    from fretflow.core.errors import NonConvergenceError as NonConvergenceError
    from fretflow.core.errors import RecordingError as RecordingError
    from fretflow.core.errors import UnstablePeriodWarning as UnstablePeriodWarning
    from fretflow.core.provenance import own_version
    from fretflow.effects.bolted_cycle import BoltedCycle as BoltedCycle
    from fretflow.effects.catalogue import add_effects as add_effects
    from fretflow.effects.catalogue import catalogue as catalogue
    from fretflow.effects.cycle import find_asymptotic_shape as find_asymptotic_shape
    from fretflow.effects.cycle import march_wear as march_wear
    from fretflow.effects.effect import ALL_KINDS as ALL_KINDS
    from fretflow.effects.effect import Block as Block
    from fretflow.effects.effect import Effect as Effect
    from fretflow.effects.effect import Motion as Motion
    from fretflow.effects.effect import parameter as parameter
    from fretflow.inference.verdict import Diagnosis as Diagnosis
    from fretflow.pipeline.bolted import JointStudy as JointStudy
    from fretflow.pipeline.bolted import study_joint as study_joint
    from fretflow.pipeline.diagnose import diagnose as diagnose
    from fretflow.pipeline.results import RunResults as RunResults
    from fretflow.pipeline.run import run as run
    from fretflow.recordings.hysteresis import LoopReadings as LoopReadings
    from fretflow.recordings.hysteresis import read_loop as read_loop
    from fretflow.recordings.kinds import read_recording as read_recording
    from fretflow.solvers.continuation.curve import ResponseCurve as ResponseCurve
    from fretflow.solvers.continuation.follow import continue_response as continue_response
    from fretflow.solvers.nonlinear_modes.joint import BoltedJoint as BoltedJoint
    from fretflow.solvers.nonlinear_modes.periodic_mode import follow_mode as follow_mode
    from fretflow.solvers.nonlinear_modes.quasi_static import quasi_static_backbone as quasi_static_backbone
    from fretflow.solvers.periodic import Harmonic as Harmonic
    from fretflow.solvers.periodic import NormalLoad as NormalLoad
    from fretflow.solvers.periodic import PeriodicProblem as PeriodicProblem
    from fretflow.solvers.periodic import PeriodicSolution as PeriodicSolution
    from fretflow.solvers.solve import solve_periodic as solve_periodic
    from fretflow.structure.bodies import Bolt as Bolt
    from fretflow.structure.bodies import Material as Material
    from fretflow.structure.fem.bodies import structure_from_mesh as structure_from_mesh
    from fretflow.structure.matrices import StructureMatrices as StructureMatrices
    from fretflow.structure.matrix_joint import Joint as Joint
    from fretflow.structure.reduction.contact_modes import reduce_structure as reduce_structure
    from fretflow.structure.sensors import HysteresisLoop as HysteresisLoop
    from fretflow.wear.archard import Archard as Archard

    __version__ = own_version()

# What is public, and the module that it is in: the imports above, which tell type checkers and editors the same.
_ROOM_OF = {alias.name: str(node.module) for node in ast.walk(ast.parse(Path(__file__).read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom) for alias in node.names if alias.asname}
__all__ = sorted(_ROOM_OF)
# Classes whose objects users make; those of the others come from functions.
_MADE = frozenset({
    "Archard", "Bolt", "BoltedCycle", "BoltedJoint", "Coulomb", "Harmonic", "HysteresisLoop", "Interface", "Joint",
    "Material", "Motion", "NormalLoad", "PeriodicProblem", "StructureMatrices"})


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from fretflow.core.provenance import own_version

        value: Any = own_version()
    elif name in _ROOM_OF:
        room = import_module(_ROOM_OF[name])
        value = import_module(f"{room.__name__}.{name}") if name == "units" else getattr(room, name)
        if name in _MADE or isinstance(value, FunctionType):
            from fretflow.core.arguments import checked

            value = checked(value)
            setattr(room, name, value)  # one object by either name, also in another process
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
