"""Checkpoints of a wear history.

The weight lies on resumption: a run that is broken at any of its writes goes on to the same bits, with a
joint whose period depends on the state it starts from, so that a lost or stale state would show.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
from fretflow.case.config import WearScheme
from fretflow.core.errors import InputError, NonConvergenceError, StoreError
from fretflow.core.records import quantity, record
from fretflow.core.store import read_record, write_record
from fretflow.wear import checkpoint
from fretflow.wear.checkpoint import kept_states
from fretflow.wear.cycle import CycleResponse, WearAlone
from fretflow.wear.history import WearHistory, WearSettings
from fretflow.wear.march import run_history

AREAS = np.array([1.0, 2.0, 1.0]) * 1e-7
SCHEMES = list(WearScheme)


@record
class Memory:
    """What a period hands to the next."""

    count: int
    trace: np.ndarray = quantity("1", "(nodes,)")


class Joint(WearAlone):
    """Springs that slide, with a rate that remembers the state it was started from."""

    state_type = Memory

    def __init__(self, fail_beyond=np.inf, fail_warm=False):
        self.areas, self.fail_beyond, self.fail_warm = AREAS, fail_beyond, fail_warm

    def normal_flexibility(self, slow):
        return np.diag(1.0 / (3e14 * AREAS))

    def cycle(self, slow, start):
        depth = slow.depth
        if depth.max() > self.fail_beyond or (self.fail_warm and start is not None):
            raise NonConvergenceError("no period", history=(1.0, 0.5))
        start = start or Memory(count=0, trace=np.zeros(3))
        height = depth + 2e-8 * np.array([0.0, 1.0, 3.0])
        pressure = 1.5e8 + 3e14 * (AREAS @ height / AREAS.sum() - height)
        pressure += 1e3 * np.sin(start.count + start.trace)
        state = Memory(count=start.count + 1, trace=np.cos(1e8 * depth + start.trace))
        return CycleResponse(
            pressure_sliding=2e-5 * pressure, mean_pressure=pressure, mean_opening=np.zeros(3),
            slip_path=np.full(3, 2e-5), contact_share=np.ones(3), sliding_distance=1e-5,
            dissipated_energy=1e-3 * float(pressure.sum())), state


class Remembering(Joint):
    """The same with laws over cycles: a film that slows wear, which also follows energy and cycles."""

    has_laws = True

    def initial(self):
        return replace(super().initial(), memory={"film.layer_m": np.zeros(3), "film.made_m3": np.asarray(0.0)})

    def evolve(self, before, cycles, worn, energy, response):
        layer = before.memory["film.layer_m"] * np.exp(-cycles / 3e3) + 0.3 * worn
        made = before.memory["film.made_m3"] + AREAS @ worn
        return before.after(cycles, worn, energy, {"film.layer_m": layer, "film.made_m3": made})

    def wear_factor(self, response, slow):
        return np.exp(-slow.memory["film.layer_m"] / 1e-7 - slow.energy / 1e10 - slow.cycles / 1e5)


def settings(scheme, **changes):
    given = {"coefficient": 2e-14, "cycles": 12_000, "stops": (5_000,), "scheme": scheme}
    return WearSettings(**{**given, **changes})


def assert_same(history, expected):
    for f in fields(WearHistory):
        one, other = getattr(history, f.name), getattr(expected, f.name)
        if f.name == "memory":
            assert list(one) == list(other)
            one, other = (np.concatenate([np.zeros(0), *map(np.ravel, part.values())]) for part in (one, other))
        np.testing.assert_array_equal(one, other, err_msg=f.name)


def break_at(monkeypatch, write):
    """Let the `write`-th record of a run fail half-way, as a kill or a full disk would."""
    count = 0

    def failing(path, content):
        nonlocal count
        count += 1
        if count == write:
            (path.parent / f".{path.name}.1.tmp").write_bytes(b"half")
            raise StoreError(f"{path}: cannot be written (No space left on device)")
        return write_record(path, content)

    monkeypatch.setattr(checkpoint, "write_record", failing)


@pytest.mark.parametrize(("joint", "changes"), [
    (Joint, {}), (Remembering, {"tolerance": 0.3, "cycles": 1_500, "stops": (400,)})])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_run_broken_at_any_write_goes_on_to_the_same_bits(tmp_path, monkeypatch, scheme, joint, changes):
    asked = settings(scheme, **changes)
    expected = run_history(joint(), asked)
    writes = 1 + 2 * len(expected.cycles)
    for write in range(1, writes + 1):
        break_at(monkeypatch, write)
        folder = tmp_path / str(write)
        with pytest.raises(StoreError, match="No space"):
            run_history(joint(), asked, folder)
        monkeypatch.undo()
        assert_same(run_history(joint(), asked, folder), expected)
        assert not list(folder.glob(".*"))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_run_broken_again_and_again_goes_on_to_the_same_bits(tmp_path, monkeypatch, scheme):
    expected = run_history(Joint(), settings(scheme))
    for _ in range(len(expected.cycles)):
        break_at(monkeypatch, 4)
        try:
            history = run_history(Joint(), settings(scheme), tmp_path)
        except StoreError:
            continue
        break
    assert_same(history, expected)


def test_states_at_asked_counts_are_kept_and_no_others(tmp_path):
    history = run_history(Joint(), settings(WearScheme.EXPLICIT), tmp_path)
    states = kept_states(tmp_path, Memory)
    assert sorted(states) == [0, 5_000, 12_000]
    assert states[5_000].count == 1 + history.cycles.tolist().index(5_000)


def test_a_history_holds_the_slow_state_of_every_step(tmp_path):
    history = run_history(Remembering(), settings(WearScheme.IMPLICIT), tmp_path)
    stored = read_record(write_record(tmp_path / "history.h5", history), WearHistory)
    assert_same(stored, history)
    assert stored.memory["film.layer_m"].shape == (len(history.cycles), 3)
    np.testing.assert_allclose(stored.memory["film.made_m3"], history.volume, rtol=1e-12)
    end = stored.slow(-1)
    assert (end.cycles, end.energy) == (12_000.0, history.energy[-1])
    np.testing.assert_array_equal(end.memory["film.layer_m"], history.memory["film.layer_m"][-1])
    trapezoid = np.sum(0.5 * np.diff(history.cycles) * (history.dissipated_energy[1:] + history.dissipated_energy[:-1]))
    assert end.energy == pytest.approx(trapezoid, rel=1e-3)


def test_progress_is_told(tmp_path):
    told = []
    history = run_history(Joint(), settings(WearScheme.EXPLICIT), tmp_path, lambda *done: told.append(done))
    assert told == [(int(n), 12_000) for n in history.cycles[1:]]


def test_other_settings_are_not_mixed_in(tmp_path):
    run_history(Joint(), settings(WearScheme.EXPLICIT), tmp_path)
    with pytest.raises(StoreError, match="begun with other settings"):
        run_history(Joint(), settings(WearScheme.EXPLICIT, coefficient=1e-14), tmp_path)


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="file/wear: cannot be written"):
        run_history(Joint(), settings(WearScheme.EXPLICIT), tmp_path / "file" / "wear")


def test_non_convergence_keeps_the_last_good_state(tmp_path):
    with pytest.raises(NonConvergenceError, match=r"wear after \d+ cycles: no period") as caught:
        run_history(Joint(fail_beyond=4e-7), settings(WearScheme.EXPLICIT), tmp_path)
    assert caught.value.last_good == tmp_path
    assert caught.value.history == (1.0, 0.5)
    assert max(kept_states(tmp_path, Memory)) > 0
    assert_same(run_history(Joint(), settings(WearScheme.EXPLICIT), tmp_path),
                run_history(Joint(), settings(WearScheme.EXPLICIT)))


def test_a_period_not_found_from_its_neighbour_is_sought_from_nothing():
    history = run_history(Joint(fail_warm=True), settings(WearScheme.EXPLICIT))
    assert history.cycles[-1] == 12_000


def test_an_implicit_jump_too_far_for_the_period_is_shortened():
    # the stage of a long jump lies deeper than its end
    end = run_history(Joint(), settings(WearScheme.IMPLICIT)).depth[-1].max()
    history = run_history(Joint(fail_beyond=1.0001 * end), settings(WearScheme.IMPLICIT))
    assert history.cycles[-1] == 12_000


@pytest.mark.parametrize(("changes", "message"), [
    ({"coefficient": -1e-14}, r"wear\.coefficient"),
    ({"cycles": -1, "stops": ()}, "cycles"),
    ({"stops": (20_000,)}, "20000"),
    ({"max_depth_per_jump": 0.0}, r"wear\.max_depth_per_jump"),
    ({"tolerance": 0.0}, r"wear\.tolerance"),
    ({"upper_share": 1.5}, r"wear\.upper_share"),
])
def test_impossible_settings_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        settings(WearScheme.EXPLICIT, **changes)
