"""Records cannot change after they were made.

What carries the weight: neither the record nor whoever made its arrays can alter it later.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
from fretflow.core.errors import InputError
from fretflow.core.records import digest, quantity, record, unit_of
from numpy.typing import NDArray


@record
class Pair:
    force: NDArray[np.float64] = quantity("N", "(n,)")
    count: int = 1

    def check(self):
        if self.count < 0:
            raise InputError("count: must not be negative")


@record
class Remembering:
    memory: Mapping[str, NDArray[np.float64]]


def test_fields_and_arrays_are_read_only():
    pair = Pair(force=np.ones(3))
    with pytest.raises(dataclasses.FrozenInstanceError):
        pair.count = 2
    with pytest.raises(ValueError, match="read-only"):
        pair.force[0] = 2.0


@pytest.mark.parametrize("view", [lambda a: a[:], lambda a: a.T, lambda a: np.broadcast_to(a[:1], 3)])
def test_a_view_is_copied_so_that_its_base_cannot_change_the_record(view):
    base = np.ones(3)
    pair = Pair(force=view(base))
    base[:] = 5.0
    assert pair.force.tolist() == [1.0, 1.0, 1.0]


def test_a_read_only_view_is_copied_too():
    base = np.ones(3)
    window = base[:]
    window.setflags(write=False)
    pair = Pair(force=window)
    base[0] = 5.0
    assert pair.force[0] == 1.0


def test_arrays_of_a_mapping_are_read_only_and_its_maker_cannot_change_them():
    made = {"layer_m": np.ones(3)}
    state = Remembering(memory=made)
    made["layer_m"] = np.zeros(3)
    assert state.memory["layer_m"].tolist() == [1.0, 1.0, 1.0]
    with pytest.raises(ValueError, match="read-only"):
        state.memory["layer_m"][0] = 2.0


def test_check_runs_also_on_a_changed_copy():
    with pytest.raises(InputError, match="count"):
        dataclasses.replace(Pair(force=np.ones(1)), count=-1)


def test_records_of_alike_arrays_are_equal():
    """Of arrays numpy could not tell whether they are."""
    made = [Remembering(memory={"layer_m": np.arange(3.0)}) for _ in range(2)]
    assert made[0] == made[1]
    assert made[0] != Remembering(memory={"layer_m": np.zeros(3)})
    assert Pair(force=np.ones(2)) == Pair(force=np.ones(2)) != Pair(force=np.ones(2), count=2)


def test_a_digest_tells_records_apart_by_what_they_hold():
    made = [Pair(force=np.ones(2)), Pair(force=np.ones((2, 1))), Pair(force=np.full(2, 1.0 + 1e-15)), Pair(
        force=np.ones(2), count=2), Remembering(memory={"a": np.ones(2)}), Remembering(memory={"b": np.ones(2)})]
    assert len({digest(one) for one in made}) == len(made)
    assert digest(Pair(force=np.ones(2)), (60,)) == digest(Pair(force=np.ones(2), count=1), [60.0])


def test_units_are_known_by_field():
    assert unit_of(Pair, "force") == "N"
    assert unit_of(Pair, "count") == ""
    with pytest.raises(KeyError, match="no field mass"):
        unit_of(Pair, "mass")


def test_a_record_is_shown_on_a_line_with_the_shape_of_what_is_large():
    held = Remembering(memory={"layer_m": np.zeros((50, 3)), "few": np.array([1.0, 2.0])})
    assert repr(held) == "Remembering(memory={'layer_m': <50 x 3>, 'few': array([1., 2.])})"
    assert repr(Pair(force=np.zeros(20))) == "Pair(force=<20 in N>, count=1)"
