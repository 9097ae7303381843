"""Checkpoints of a wear history: one small file a jump, and the state of the last one.

A jump is written after its state, and an older state is removed after the jump that follows it; each file
is renamed into place whole. So at any moment the last jump on disk has its state, and a killed run goes on
from there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Generic, TypeVar

from fretflow.core.errors import StoreError
from fretflow.core.store import read_record, write_record, write_whole
from fretflow.wear.history import WearSettings, WearStep

S = TypeVar("S")


class Checkpoints(Generic[S]):
    """The checkpoint folder of one wear history; `joint` tells whose, where that is known.

    Raises
    ------
    StoreError
        If the folder cannot be made, or was begun with other settings or another joint.
    """

    def __init__(self, folder: Path, state_type: type[S], settings: WearSettings, joint: str = "") -> None:
        self.folder = folder
        self.state_type = state_type
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for leftover in folder.glob(".*.tmp"):
                leftover.unlink()
        except OSError as error:
            raise StoreError(f"{folder}: cannot be written ({error}); choose another folder") from error
        settings_file = folder / "settings.h5"
        if not settings_file.is_file():
            write_record(settings_file, settings)
        elif read_record(settings_file, WearSettings) != settings:
            raise StoreError(f"{folder}: was begun with other settings; remove it or choose another folder")
        joint_file = folder / "joint.txt"
        if joint and not joint_file.is_file():
            write_whole(joint_file, joint.encode())
        elif joint and joint_file.read_text(encoding="utf-8") != joint:
            raise StoreError(f"{folder}: holds the wear of another joint; remove it or choose another folder")

    def steps(self) -> list[WearStep]:
        """Return the jumps made so far."""
        steps: list[WearStep] = []
        while (path := self._jump(len(steps))).is_file():
            steps.append(read_record(path, WearStep))
        return steps

    def state(self, index: int) -> S:
        """Return the state after jump `index`; only the last one and those at asked cycle counts are kept."""
        return read_record(self._state(index), self.state_type)

    def save(self, index: int, step: WearStep, state: S, keep_previous: bool) -> None:
        """Write jump `index` with its state, then drop the state before it unless `keep_previous`."""
        write_record(self._state(index), state)
        write_record(self._jump(index), step)
        if index > 0 and not keep_previous:
            self._state(index - 1).unlink(missing_ok=True)

    def _jump(self, index: int) -> Path:
        return self.folder / f"jump-{index:05d}.h5"

    def _state(self, index: int) -> Path:
        return self.folder / f"state-{index:05d}.h5"


def kept_states(folder: Path, state_type: type[S]) -> dict[int, S]:
    """Return the states kept in `folder` by cycle count: the unworn one, the asked ones and the last."""
    states = {}
    for path in sorted(folder.glob("state-*.h5")):
        jump = folder / path.name.replace("state", "jump")
        if jump.is_file():
            states[read_record(jump, WearStep).cycles] = read_record(path, state_type)
    return states
