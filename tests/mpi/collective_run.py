"""The command line with a pipeline of one collective stage, for tests that start it under mpirun.

``python collective_run.py KIND run CASE --out OUT``; KIND says how the stage ends.
"""

import sys

from fretflow import cli
from fretflow.cli import run as cli_run
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.pipeline import stages as pipeline_stages
from fretflow.pipeline.stage import Stage

KIND = sys.argv[1]


def local(context):
    assert context.comm is None
    (context.folder / "local.txt").write_text("by rank 0")
    return {}


def collective(context):
    comm = context.comm
    assert (context.inputs["local"] / "local.txt").read_text() == "by rank 0"
    if KIND == "all-fail":
        raise InputError("contact: the mesh has no such group; name it")
    if KIND == "no-convergence":
        raise NonConvergenceError("eigenvalues", history=[1.0, 0.5])
    if KIND == "rank-0-fails" and comm.rank == 0:
        raise InputError("only rank 0 fails")
    if KIND == "rank-1-fails" and comm.rank == 1:
        raise InputError("only rank 1 fails")
    if KIND == "rank-1-fails-late":
        comm.barrier()
        if comm.rank == 1:
            raise InputError("rank 1 fails at its end")
        return {}
    total = comm.allreduce(comm.rank + 1)
    if comm.rank == 0:
        (context.folder / "total.txt").write_text(str(total))
    return {"total": total}


if __name__ == "__main__":
    stages = (Stage("local", 1, lambda case: 0, (), local),
              Stage("reduce", 1, lambda case: 1, ("local",), collective, collective=True))
    pipeline_stages.pipeline = lambda: stages
    cli_run._summarise = lambda case, results, home: None
    sys.exit(cli.execute(sys.argv[2:]))
