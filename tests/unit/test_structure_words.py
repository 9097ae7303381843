"""Property: an unknown of a structure says why the nearest effect is not enough, in the words of a rig's."""

from types import SimpleNamespace
from typing import Any

import pytest
from fretflow.experiments.structure import backbone, worn
from fretflow.inference.verdict import Remainder, Verdict

REST = Remainder(share=0.7, times_noise=4.7, where="damping")


@pytest.mark.parametrize("room", [backbone, worn])
@pytest.mark.parametrize(("against", "words"), [
    ("", "and what the nearest leaves (4.7 times the noise) is more than another form of its law would"),
    ("explains nothing", "but the nearest explains nothing, and leaves 4.7 times the noise")])
def test_an_unknown_says_why_the_nearest_is_not_enough(room: Any, against: str, words: str) -> None:
    judged = SimpleNamespace(verdict=Verdict.UNKNOWN, sets=(), after=frozenset({"bending-gap"}), against=against)
    search = SimpleNamespace(explained=lambda names: 0.3)
    said = room._sentence(judged, search, REST, "It is there.")
    assert f"bending-gap would explain 30 % of the difference, {words}. It is there." in said


def test_an_unknown_says_that_a_finer_mesh_would_leave_nothing_missing() -> None:
    judged = SimpleNamespace(verdict=Verdict.UNKNOWN, sets=(), after=frozenset(), against="")
    said = [backbone._sentence(judged, SimpleNamespace(explained=lambda names: 0.0), REST, "", finer)
            for finer in (False, True)]
    assert ["matrices of a finer mesh tell" in one for one in said] == [False, True]
