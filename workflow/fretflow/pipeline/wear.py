"""The wear stage: cycle jumps to the end of the test, with a checkpoint after each."""

from __future__ import annotations

from fretflow.case.config import Case
from fretflow.core.store import write_record
from fretflow.pipeline.stage import Figures, Stage, StageContext

CHECKPOINTS = "checkpoints"


def stops(case: Case) -> tuple[int, ...]:
    """Return the cycle counts to land on, ascending, besides the end."""
    asked = {*case.output.loop_cycles, *case.output.wear_map_cycles}
    return tuple(sorted(asked - {0, case.test.total_cycles}))


def _slice(case: Case) -> list[object]:
    return [case.wear, case.test.total_cycles, list(stops(case)), case.effects]


def _run(context: StageContext) -> Figures:
    """Write ``history.h5`` (WearHistory) and, in ``checkpoints``, the period at each asked cycle count."""
    from fretflow.effects.catalogue import parse_effects
    from fretflow.effects.cycle import march_wear
    from fretflow.pipeline.problem import make_problem, make_solver
    from fretflow.wear.archard import Archard

    case = context.case
    history = march_wear(
        make_problem(case, context.inputs["reduce"]), Archard(case.wear.coefficient, upper_share=case.wear.upper_share),
        case.test.total_cycles, effects=parse_effects(case.effects), solver=make_solver(case.solver),
        folder=context.folder / CHECKPOINTS, scheme=case.wear.scheme, stops=stops(case), tolerance=case.wear.tolerance,
        max_depth_per_jump=case.wear.max_depth_per_jump, vanishing_rate=case.wear.vanishing_rate,
        progress=lambda done, asked: context.progress(done / max(asked, 1), f"{done:_} of {asked:_} cycles"))
    write_record(context.folder / "history.h5", history)
    return {"jumps": len(history.cycles) - 1, "solutions": history.solves, "stopped_by": history.stopped_by,
            "shortened_jumps": history.shortened_jumps, "volume_m3": float(history.volume[-1]),
            "largest_depth_m": float(history.depth[-1].max())}


STAGE = Stage("wear", 2, _slice, ("reduce", "solve"), _run)
