"""Spikes, bursts and saturation in raw signals, found by row, and what they cost.

What carries the weight: the loop is a spring and slider in closed form, so that what is left out may move no reading.
"""

import numpy as np
import pytest
from fretflow.recordings import periods
from fretflow.recordings.notes import rows_in_words
from fretflow.recordings.recording import read_joint_recording
from fretflow.recordings.series import loops_of_series
from joint_readings import assert_readings, notes_about


@pytest.mark.parametrize("block", ["loops", "series"])
@pytest.mark.parametrize("place", [0, 7, 60, 150, 399])
@pytest.mark.parametrize(("channel", "size"), [
    ("displacement", 20e-6), ("displacement", -2e-3), ("friction_force", 30.0), ("friction_force", -5e3)])
def test_a_spike_is_named_by_its_row_and_moves_no_reading(tmp_path, make, exact, block, place, channel, size):
    made = make() if block == "loops" else make(cycles=(0,), repeats=1, periods=6.5)
    if block == "series":
        del made.columns["cycle"], made.columns["repeat"]
    made.columns[channel][place] += size
    recording = read_joint_recording(made.write(tmp_path, block=block))
    assert [(note.channel, note.rows) for note in notes_about(recording, "spike")] == [(channel, ((place + 1,) * 2,))]
    loops = recording.loops if block == "loops" else loops_of_series(recording.series)[0]
    assert_readings(loops, exact, mu=5e-3, stiffness=2e-2, lengths=5e-3)


@pytest.mark.parametrize("block", ["loops", "series"])
@pytest.mark.parametrize("channel", ["displacement", "friction_force"])
@pytest.mark.parametrize("rows", [(60, 61, 62), (0, 1, 2, 3, 4, 5, 6), (10, 90, 91, 330),
                                  (199, 200, 201, 202), (396, 397, 398, 399)])
def test_many_spikes_far_off_the_range_are_named_and_move_no_reading(tmp_path, make, exact, rows, channel, block):
    made = make() if block == "loops" else make(cycles=(0,), repeats=1, periods=6.5)
    if block == "series":
        del made.columns["cycle"], made.columns["repeat"]
    made.columns[channel][list(rows)] *= np.where(np.arange(len(rows)) % 2, -1.0, 1.0)
    made.columns[channel][list(rows)] += {"displacement": 1e-3, "friction_force": -900.0}[channel]
    recording = read_joint_recording(made.write(tmp_path, block=block))
    (note,) = notes_about(recording, "spike")
    assert (note.channel, tuple(k - 1 for a, b in note.rows for k in range(a, b + 1))) == (channel, rows)
    loops = recording.loops if block == "loops" else loops_of_series(recording.series)[0]
    assert_readings(loops, exact, mu=5e-3, stiffness=2e-2, lengths=5e-3)


def test_a_few_larger_loops_and_a_decay_have_no_spikes():
    """What is large in some cycles only gets there by slopes, or stays for half a period."""
    turns = np.arange(100 * 64) / 64
    force = np.clip(3.0 * np.sin(2.0 * np.pi * turns), -1.0, 1.0) * np.where(turns // 1 == 40, 5.0, 1.0)
    for signal in (force, np.exp(-0.05 * turns) * np.sin(2.0 * np.pi * turns), np.sign(np.sin(2.0 * np.pi * turns))):
        assert not len(periods.spikes(signal, np.zeros(len(signal), dtype=bool)))


def test_peaks_of_the_signal_s_own_are_no_spikes(tmp_path, make):
    """Friction that sticks at first peaks for one sample in every period, and comes back."""
    made = make(noise=(3e-8, 0.3))
    made.columns["friction_force"][90::200] += 14.0
    assert not notes_about(read_joint_recording(made.write(tmp_path)), "spike")


def test_a_saturated_channel_is_named_with_its_rows(tmp_path, make):
    made = make(cycles=(0,), repeats=1, periods=4, noise=(3e-8, 0.3))
    made.columns["friction_force"] = np.clip(made.columns["friction_force"], -18.0, 18.0)
    rows = np.flatnonzero(np.abs(made.columns["friction_force"]) == 18.0)
    (note,) = notes_about(read_joint_recording(made.write(tmp_path)), "saturated")
    assert note.channel == "friction_force"
    assert note.text.startswith(f"stands still at 18 N, in {len(rows) / 8:.0f} % of the samples")
    assert sum(b - a + 1 for a, b in note.rows) == len(rows)
    simulated = make(cycles=(0,), repeats=1, periods=4)  # whose plateaus are exact
    assert not notes_about(read_joint_recording(simulated.write(tmp_path / "b")), "saturated")


def test_a_long_burst_is_left_out_and_noise_of_all_repeats_is_kept(tmp_path, make):
    """Of a welder, say, for a quarter of a period: three in six and thirty loops, at any phase."""
    made, rng = make(cycles=tuple(range(12)), repeats=3, noise=(3e-8, 0.3)), np.random.default_rng(2)
    for begin in (250, 3130, 5290):
        made.columns["friction_force"][begin:begin + 50] += 5.0 * rng.standard_normal(50)
    (note,) = notes_about(read_joint_recording(made.write(tmp_path / "a")), "burst")
    assert (note.channel, note.rows) == ("friction_force", ((201, 400), (3001, 3200), (5201, 5400)))
    made = make(cycles=tuple(range(12)), repeats=3, noise=(3e-8, 0.3))
    made.columns["excitation"][2250:2310] += 60.0 * rng.standard_normal(60)  # passes the middle more than once a period
    (note,) = notes_about(read_joint_recording(made.write(tmp_path / "drive")), "left out")
    assert (note.channel, note.rows) == ("excitation", ((2201, 2400),))
    assert "burst" in note.text
    for k in range(20):  # where stick begins, a force that chatters in all loops, as it may by itself
        made = make(cycles=tuple(range(12)), repeats=3, noise=(3e-8, 0.3))
        rough = np.arange(7200) % 200 < 40
        made.columns["friction_force"][rough] += 5.0 * np.random.default_rng(k).standard_normal(rough.sum())
        assert not notes_about(read_joint_recording(made.write(tmp_path / f"b{k}")), "burst")


def test_a_channel_of_eight_bits_is_not_saturated(tmp_path, make):
    """A twentieth of a sine is on its last step then."""
    made = make(cycles=(0,), repeats=1, periods=4, noise=(3e-8, 0.3))
    most = np.abs(made.columns["displacement"]).max()
    made.columns["displacement"] = most / 128.0 * np.round(made.columns["displacement"] / most * 128.0)
    assert not notes_about(read_joint_recording(made.write(tmp_path)), "saturated")


def test_memory_grows_as_the_rows_do(make, tmp_path):
    """Where one count has a thousand repeats and a thousand have one, places for all would be the square of them."""
    made = make(cycles=tuple(range(200)), repeats=1, samples=16, excitation=False)
    extra = make(cycles=(0,), repeats=200, samples=16, excitation=False)
    extra.columns["repeat"] += 1
    made.columns = {name: np.r_[values, extra.columns[name]] for name, values in made.columns.items()}
    recording = read_joint_recording(made.write(tmp_path))
    there = recording.loops.usable
    assert there.size <= 20 * 400
    assert there[0].sum() == 40
    assert there[1:].sum() == 199
    assert any("40 repeats of one are kept" in note.text for note in recording.notes)


@pytest.mark.parametrize(("count", "told"), [(5, "1, 2, 3, 4 and 1 more place up to row 5"),
                                             (6, "1, 2, 3, 4 and 2 more places up to row 6")])
def test_rows_beyond_the_first_are_counted(count, told):
    assert rows_in_words(tuple((row, row) for row in range(1, count + 1))) == f"rows {told}"
