"""The wear history, jump after jump, each followed by a new periodic solution and a checkpoint."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from fretflow.case.config import WearScheme
from fretflow.core.errors import NonConvergenceError
from fretflow.wear.checkpoint import Checkpoints
from fretflow.wear.cycle import CycleModel
from fretflow.wear.explicit import Explicit
from fretflow.wear.history import WearHistory, WearSettings, WearStep, collect
from fretflow.wear.implicit import Implicit
from fretflow.wear.scheme import Scheme, WearingJoint

S = TypeVar("S")
Progress = Callable[[int, int], None]


def run_history(model: CycleModel[S], settings: WearSettings, checkpoint_dir: Path | None = None,
                progress: Progress | None = None, joint: str = "") -> WearHistory:
    """March the wear to the asked cycles or, without laws over cycles that might revive it, until it vanishes.

    Jumps land exactly on `settings.stops` and on the end. With `checkpoint_dir` every jump is written
    before the next begins, and a run that finds jumps there goes on from the last one to the same numbers,
    bit for bit.

    Parameters
    ----------
    model : CycleModel
        The vibrating joint.
    settings : WearSettings
        How far and how.
    checkpoint_dir : Path, optional
        Folder of the checkpoints; the states at the asked counts stay there, see `checkpoint.kept_states`.
    progress : callable, optional
        Called with the cycles done and the cycles asked after each jump.
    joint : str
        Tells the model from others, whose checkpoints it does not go on from.

    Raises
    ------
    NonConvergenceError
        If a period is not found; `last_good` is the checkpoint folder.
    StoreError
        If a checkpoint cannot be written or read, or is of another joint.
    """
    wearing = WearingJoint(model, settings)
    scheme: Scheme[S] = Explicit(wearing) if settings.scheme is WearScheme.EXPLICIT else Implicit(wearing)
    checkpoints = None if checkpoint_dir is None else Checkpoints(checkpoint_dir, model.state_type, settings, joint)
    kept = {0, settings.cycles, *settings.stops}
    steps = checkpoints.steps() if checkpoints else []
    try:
        if steps and checkpoints:
            state = checkpoints.state(len(steps) - 1)
        else:
            first, state = wearing.unworn()
            steps = [first]
            if checkpoints:
                checkpoints.save(0, first, state, keep_previous=True)
        while (stopped_by := _finished(steps, settings, model)) is None:
            step, state = scheme.advance(steps[-1], state)
            if checkpoints:
                checkpoints.save(len(steps), step, state, keep_previous=steps[-1].cycles in kept)
            steps.append(step)
            if progress:
                progress(step.cycles, settings.cycles)
    except NonConvergenceError as error:
        raise NonConvergenceError(f"wear after {steps[-1].cycles if steps else 0} cycles: {error}",
                                  history=error.history, last_good=checkpoint_dir) from error
    return collect(steps, model.areas, settings.upper_share, stopped_by)


def _finished(steps: list[WearStep], settings: WearSettings, model: CycleModel[S]) -> str | None:
    if steps[-1].cycles >= settings.cycles:
        return "cycles"
    if model.has_laws:
        return None
    if model.areas @ steps[-1].rate <= settings.vanishing_rate * (model.areas @ steps[0].rate):
        return "vanishing rate"
    return None
