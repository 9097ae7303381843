"""The command line with a pipeline of one short stage, for ensembles under mpirun.

``python ensemble_run.py run CASES --executor mpi --out OUT``; the title of a case says how it ends.
"""

import sys

from fretflow import cli
from fretflow.core.errors import NonConvergenceError
from fretflow.pipeline import stages as pipeline_stages
from fretflow.pipeline.ranks import started_rank
from fretflow.pipeline.stage import Stage


def work(context):
    assert context.comm is None  # each case has one rank to itself
    if context.case.title == "fails":
        raise NonConvergenceError("no step helps", history=[1.0, 0.5])
    (context.folder / "rank.txt").write_text(str(started_rank()))
    return {}


# Workers unpickle the tasks' functions by name, and the pipeline that these look up is this one on every rank.
pipeline_stages.pipeline = lambda: (Stage("mesh", 1, lambda case: case.title, (), work, collective=True),)

if __name__ == "__main__":
    sys.exit(cli.execute(sys.argv[1:]))
