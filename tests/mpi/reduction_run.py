"""Reduce a specimen on the ranks that started this: ``python reduction_run.py MESH SUMMARY RESULT``."""

import sys
from pathlib import Path

from fretflow.case.config import Reduction, Specimen
from fretflow.core.errors import MeshError
from fretflow.core.specimen_mesh import MeshSummary
from fretflow.core.store import read_record, write_record
from fretflow.structure.reduction.reduce import reduce_specimen
from mpi4py import MPI

if __name__ == "__main__":
    mesh, summary, result = map(Path, sys.argv[1:])
    comm = MPI.COMM_WORLD
    assert comm.size == 2
    try:
        reduced = reduce_specimen(mesh, read_record(summary, MeshSummary), Specimen(), Reduction(), 1, comm)
    except MeshError as error:
        result.with_name(f"error{comm.rank}").write_text(str(error))
        sys.exit(2)
    assert (reduced is None) == (comm.rank != 0)
    if reduced is not None:
        write_record(result, reduced[0])
        write_record(result.with_name(f"{result.stem}_modes.h5"), reduced[1])
