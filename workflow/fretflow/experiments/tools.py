"""What lies above a diagnosis, and is handed to it: meshes and reduction of a case, and processes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from fretflow.case.config import Case, Reduction
from fretflow.inference.search import Pool
from fretflow.solvers.periodic import PeriodicProblem

Reduce = Callable[[Case], PeriodicProblem]  # the unworn problem of a case, from meshes to reduction


@dataclass(frozen=True)
class DiagnosisTools:
    """Meshes and reduction of a case, and processes to call functions in."""

    reduce: Reduce
    pool: Pool

    def statics(self, cases: Iterable[Case]) -> list[PeriodicProblem]:
        """Return the problems of cases by their statics: contacts follow these, and specimens' own modes count little.

        Where the pool has several processes they are reduced at once.
        """
        few = Reduction(fixed_interface_modes=1, checked_frequencies=1)
        return self.pool(reduce_task, [(self.reduce, case.model_copy(update={"reduction": few})) for case in cases])


def reduce_task(asked: tuple[Reduce, Case]) -> PeriodicProblem:
    """Return the problem of a case, from meshes to reduction."""
    reduce, case = asked
    return reduce(case)
