"""Raw signals as people record them.

What carries the weight: the loop is a spring and slider in closed form at every instant, so that after cleaning
each sample can be compared with what it should be, and each reading with its formula; every change is noted with
the rows it concerns.
"""

import numpy as np
import pytest
from fretflow.core.errors import UnreliableRecordingError
from fretflow.recordings import periods
from fretflow.recordings.recording import read_joint_recording
from fretflow.recordings.series import loops_of_series
from joint_readings import assert_readings, notes_about

LEAD = 0.3


def test_even_samples_are_kept_as_they_are(tmp_path, make):
    made = make(cycles=(0, 50, 1000), repeats=3, noise=(3e-8, 0.3))
    loops = read_joint_recording(made.write(tmp_path)).loops
    assert loops.cycles.tolist() == [0, 50, 1000]
    assert loops.aligned_to == "excitation"
    # The excitation leads by 0.3 turns: its maximum is 140 of 200 samples after the start.
    first = made.columns["displacement"].reshape(3, 3, 200)
    assert np.roll(first, 60, axis=2) == pytest.approx(loops.displacement, rel=1e-9, abs=1e-18)
    assert loops.phase[0] == pytest.approx(0.0, abs=1e-9)


def test_samples_between_grid_points_are_kept_too(tmp_path, make):
    made = make(starts=[0.31 / 200] * 4)
    loops = read_joint_recording(made.write(tmp_path)).loops
    assert np.sort(loops.displacement[0, 0]) == pytest.approx(np.sort(made.columns["displacement"][:200]), rel=1e-9)
    assert loops.phase[0] == pytest.approx(2.0 * np.pi * 0.31 / 200, rel=1e-6)


@pytest.mark.parametrize("excitation", [True, False])
def test_trigger_jitter_is_taken_out(tmp_path, make, exact, spring_slider, excitation):
    starts = np.random.default_rng(3).uniform(0.0, 1.0, 12)
    recording = read_joint_recording(make(repeats=6, starts=starts, excitation=excitation).write(tmp_path))
    loops = recording.loops
    turns = loops.phase / (2.0 * np.pi) - (LEAD if excitation else 0.0)
    x, force = spring_slider(turns)
    assert loops.displacement == pytest.approx(np.broadcast_to(x, (2, 6, 200)), abs=8e-6 * 1e-4)
    assert np.abs(loops.force - force).max() < 0.012 * 36.0  # at a kink between two samples
    assert_readings(loops, exact)
    assert notes_about(recording, "common phase grid")[0].rows == ((1, 2400),)


def test_offset_stays_and_does_not_matter(tmp_path, make, exact):
    made = make()
    made.columns["displacement"] += 3e-6
    made.columns["friction_force"] -= 4.0
    loops = read_joint_recording(made.write(tmp_path)).loops
    assert loops.displacement.mean() == pytest.approx(3e-6, rel=1e-6, abs=0.0)
    assert loops.force.mean() == pytest.approx(-4.0, rel=1e-6)
    assert_readings(loops, exact)


@pytest.mark.parametrize("drift", [0.02, 0.1])
def test_drift_within_one_period_is_closed(tmp_path, make, exact, drift):
    made = make()
    made.columns["friction_force"] += drift * 72.0 * 100.0 * made.columns["time"]
    made.columns["displacement"] -= drift * 16e-6 * 100.0 * made.columns["time"]
    recording = read_joint_recording(made.write(tmp_path))
    assert_readings(recording.loops, exact, mu=2e-3, stiffness=1e-2, lengths=4e-3)
    assert {note.channel for note in notes_about(recording, "drift removed")} == {"displacement", "friction_force"}


def test_slow_drift_over_several_periods_is_removed(tmp_path, make, exact):
    made = make(periods=8, repeats=1)
    time = made.columns["time"]
    made.columns["friction_force"] += 7.0 * np.sin(2.0 * np.pi * time / 0.5)
    recording = read_joint_recording(made.write(tmp_path))
    assert recording.loops.force.shape == (2, 8, 200)
    assert_readings(recording.loops, exact, mu=2e-3, stiffness=1e-2, lengths=2e-3)
    assert [note.channel for note in notes_about(recording, "drift removed")] == ["friction_force"]


def test_no_drift_is_seen_in_noise(tmp_path, make):
    noisy = make(cycles=tuple(range(15)), repeats=3, noise=(1e-7, 0.5))
    assert not notes_about(read_joint_recording(noisy.write(tmp_path / "a")), "drift")
    long = make(cycles=(0,), repeats=1, periods=50, noise=(1e-7, 0.5))
    assert not notes_about(read_joint_recording(long.write(tmp_path / "b")), "drift")


@pytest.mark.parametrize("start", [0.0, 0.07, 0.21, 0.43])
@pytest.mark.parametrize("order", [15, 23])
def test_a_force_that_rings_does_not_drift(tmp_path, make, order, start):
    """Of single periods that begin anywhere in it, parabolas through their ends saw a drift of up to a fifth."""
    ringing = make(noise=(5e-8, 0.2))
    phase = 2.0 * np.pi * (100.0 * ringing.columns["time"] + start)
    ringing.columns["friction_force"] += 10.0 * np.cos(order * phase) * np.exp(-(phase % np.pi))
    assert not notes_about(read_joint_recording(ringing.write(tmp_path)), "drift")


@pytest.mark.parametrize("samples", [27.3, 200.0, 333.7])
def test_record_of_several_periods_is_cut_into_repeats(tmp_path, make, exact, samples):
    made = make(samples=samples, periods=7.4, repeats=1)
    recording = read_joint_recording(made.write(tmp_path))
    assert recording.loops.force.shape == (2, 7, round(samples))
    coarse = 200.0 / min(samples, 200.0)
    stiffness = 5e-3 if samples > 100.0 else None  # three samples of a stick portion are none to fit
    assert_readings(recording.loops, exact, mu=1e-3 * coarse, stiffness=stiffness, lengths=1.5e-3 * coarse)
    left = notes_about(recording, "no whole period")[0]
    assert left.rows[0][1] == round(samples * 7.4)


def test_frequency_a_little_off_is_found(tmp_path, make, exact):
    made = make(periods=30, repeats=1, frequency=100.4, cycles=(0,))
    recording = read_joint_recording(made.write(tmp_path))
    assert_readings(recording.loops, exact, lengths=2e-3)
    assert notes_about(recording, "by which the signal comes back")


def test_wrong_frequency_is_a_contradiction(tmp_path, make):
    made = make(periods=10, repeats=1, frequency=80.0)
    with pytest.raises(UnreliableRecordingError, match=r"periods come at 80\.?\d* Hz where 100 Hz are stated"):
        read_joint_recording(made.write(tmp_path))


@pytest.mark.parametrize("times", [2, 3, 10])
def test_a_single_period_at_a_multiple_of_its_frequency_is_told(tmp_path, make, times):
    """It was cut into as many loops, each closed by what was taken for a drift."""
    made = make(repeats=1, frequency=100.0 / times, noise=(3e-8, 0.3))
    with pytest.raises(UnreliableRecordingError, match="does not come back at the 100 Hz stated"):
        read_joint_recording(made.write(tmp_path))


def test_missing_samples_are_filled_and_named(tmp_path, make, exact):
    made = make()
    made.columns["friction_force"][[30, 31, 32, 333]] = np.nan
    made.columns["displacement"][500] = np.inf
    recording = read_joint_recording(made.write(tmp_path))
    assert_readings(recording.loops, exact, mu=2e-3, stiffness=1e-2, lengths=2e-3)
    filled = {note.channel: note.rows for note in notes_about(recording, "filled by interpolation")}
    assert filled == {"friction_force": ((31, 33), (334, 334)), "displacement": ((501, 501),)}


def test_loop_with_a_long_hole_is_left_out(tmp_path, make, exact):
    made = make()
    made.columns["friction_force"][20:60] = np.nan
    recording = read_joint_recording(made.write(tmp_path))
    assert recording.loops.repeats.tolist() == [1, 2]
    assert np.isnan(recording.loops.force[0, 1]).all()
    assert_readings(recording.loops, exact)
    assert notes_about(recording, "loop left out: friction_force: more than 5 %")[0].rows == ((1, 200),)


def test_period_with_a_hole_is_left_out_and_its_neighbours_stay(tmp_path, make, exact):
    made = make(periods=5, repeats=1)
    made.columns["friction_force"][420:460] = np.nan
    recording = read_joint_recording(made.write(tmp_path))
    assert recording.loops.repeats.tolist() == [4, 5]
    assert notes_about(recording, "period left out")[0].rows == ((401, 600),)
    assert_readings(recording.loops, exact)


def test_gap_in_time_is_bridged_or_refused(tmp_path, make, exact):
    made = make()
    made.columns = {name: np.delete(values, np.r_[40:44]) for name, values in made.columns.items()}
    recording = read_joint_recording(made.write(tmp_path / "short"))
    assert notes_about(recording, "follow gaps in time")[0].rows == ((41, 41),)
    assert_readings(recording.loops, exact, mu=2e-3, stiffness=2e-2, lengths=2e-3)
    made.columns = {name: np.delete(values, np.r_[40:70]) for name, values in made.columns.items()}
    recording = read_joint_recording(made.write(tmp_path / "long"))
    assert notes_about(recording, "5 % of a period is missing in one place")[0].rows == ((1, 166),)


def test_uneven_sampling(tmp_path, make, exact, spring_slider):
    made = make()
    rng = np.random.default_rng(5)
    time = made.columns["time"] + np.tile(rng.uniform(-1.5e-5, 1.5e-5, 200), 4)
    x, force = spring_slider(100.0 * time)
    made.columns.update(time=time, displacement=x, friction_force=force,
                        excitation=50.0 * np.cos(2.0 * np.pi * (100.0 * time + LEAD)))
    recording = read_joint_recording(made.write(tmp_path))
    assert notes_about(recording, "sampled unevenly")
    assert_readings(recording.loops, exact, mu=2e-3, stiffness=2e-2, lengths=2e-3)


def test_last_loop_cut_off(tmp_path, make):
    made = make()
    made.columns = {name: values[:-80] for name, values in made.columns.items()}
    recording = read_joint_recording(made.write(tmp_path))
    assert recording.loops.repeats.tolist() == [2, 1]
    assert notes_about(recording, "60 % of a period")[0].rows == ((601, 720),)


@pytest.mark.parametrize(("spoil", "message"), [
    (lambda c: c.update(friction_force=-c["friction_force"]),
     r"reverse the sign of one channel \(scale = -1\), or name the columns"),
    (lambda c: c.update(displacement=c["friction_force"] * 1e-7, friction_force=c["displacement"] * 1e7),
     "rows 1-800: loops run the wrong way round"),
    (lambda c: c.update(displacement=0.0 * c["displacement"]), "displacement: it never changes"),
    (lambda c: c.update(displacement=1e6 * c["displacement"]), r"16 m peak to peak is beyond fretting-rig"),
    (lambda c: c.update(friction_force=1e3 * c["friction_force"]), "600 times the normal load of 60 N"),
    (lambda c: c.update(friction_force=1e-3 * c["friction_force"]), "0.0006 times the normal load of 60 N"),
    (lambda c: c.update(excitation=1e3 * c["excitation"]), "50 kN was measured where excitation_amplitude says 50 N"),
    (lambda c: c.update(time=c["time"][::-1].copy()), "time does not grow at row 2"),
    (lambda c: c.update(repeat=0.0 * c["repeat"]), "time does not grow at row 201"),
    (lambda c: c.update(friction_force=np.nan * c["time"]), "friction_force: it holds no number"),
    (lambda c: c.update(time=1e3 * c["time"]), "no loop is usable; row"),
    (lambda c: c.update(cycle=1e6 + c["cycle"]), "goes up to 1001000, but test.cycles is 100000"),
    (lambda c: c.update(cycle=0.5 + c["cycle"]), "cycle, rows 1-800: must be a whole number"),
])
def test_damage_that_leaves_nothing(tmp_path, make, spoil, message):
    made = make()
    spoil(made.columns)
    folder = made.write(tmp_path)
    if "cycle" in message and "whole" in message:
        text = (folder / "loops.csv").read_text().replace("\n0,", "\n0.5,").replace("\n1000,", "\n1000.5,")
        (folder / "loops.csv").write_text(text)
    if "time" in message and "no loop" in message:
        message = r"time: periods come at|no loop is usable"
    with pytest.raises(UnreliableRecordingError, match=message) as caught:
        read_joint_recording(folder)
    assert "\n" not in str(caught.value)


def test_a_force_that_rings_is_no_wrong_unit(tmp_path, make):
    made = make()
    made.columns["friction_force"][::40] *= 20.0
    assert read_joint_recording(made.write(tmp_path)).loops.mean("friction_force").max() > 5.0 * 50.0


def test_rows_without_a_cycle_are_left_out(tmp_path, make, exact):
    folder = make().write(tmp_path)
    lines = (folder / "loops.csv").read_text().splitlines()
    lines[5] = lines[5].replace("0,0,", ",0,", 1)
    (folder / "loops.csv").write_text("\n".join(lines) + "\n")
    recording = read_joint_recording(folder)
    assert notes_about(recording, "row left out")[0].rows == ((5, 5),)
    assert_readings(recording.loops, exact, mu=2e-3, stiffness=2e-2, lengths=2e-3)


def test_impossible_numbers_are_missing_ones(tmp_path, make, exact):
    made = make()
    made.columns["friction_force"][77] = 1e300
    recording = read_joint_recording(made.write(tmp_path))
    assert notes_about(recording, "beyond 1e+15")[0].rows == ((78, 78),)
    assert_readings(recording.loops, exact, mu=2e-3, stiffness=1e-2, lengths=2e-3)


def test_one_spoilt_loop_does_not_stop_the_others(tmp_path, make, exact):
    made = make(repeats=3)
    made.columns["displacement"][200:400] = 1e-6
    made.columns["friction_force"][800:1000] *= -1.0
    recording = read_joint_recording(made.write(tmp_path))
    assert recording.loops.repeats.tolist() == [2, 2]
    assert notes_about(recording, "never changes")[0].rows == ((201, 400),)
    assert notes_about(recording, "wrong way round")[0].rows == ((801, 1000),)
    assert_readings(recording.loops, exact)


def test_one_cycle_count_without_repeats_is_told(tmp_path, make):
    recording = read_joint_recording(make(cycles=(7,), repeats=1).write(tmp_path))
    assert notes_about(recording, "one cycle count only")
    assert notes_about(recording, "no repeats")


def test_series_is_cut_at_the_middle_of_its_displacement(tmp_path, make, exact):
    made = make(cycles=(0,), repeats=1, periods=6.2, starts=[0.4], excitation=False, noise=(2e-8, 0.05))
    del made.columns["cycle"], made.columns["repeat"]
    made.columns["displacement"] += 5e-6 + 5e-6 * made.columns["time"]
    made.columns["friction_force"][[250, 251]] = np.nan
    recording = read_joint_recording(made.write(tmp_path, block="series"))
    loops, notes = loops_of_series(recording.series)
    assert loops.cycles.tolist() == [1, 2, 3, 4, 5]
    assert loops.frequency == pytest.approx(np.full(5, 100.0), rel=5e-3)
    assert_readings(loops, exact, mu=4e-3, stiffness=3e-2, lengths=1e-2)
    assert notes_about(recording, "filled")[0].rows == ((251, 252),)
    assert any("no whole cycle" in note.text for note in notes)


@pytest.mark.parametrize("periods", [1, 2, 3, 4])
@pytest.mark.parametrize("start", [0.0, 0.75])  # at the maximum, and as the displacement rises through its middle
def test_a_series_of_a_few_whole_cycles_is_read_whole(tmp_path, make, exact, periods, start):
    """Of two that began at zero one was read, as each passage of the middle lies half a cycle from an end."""
    made = make(cycles=(0,), repeats=1, periods=periods, starts=[start], excitation=False, noise=(2e-8, 0.05))
    del made.columns["cycle"], made.columns["repeat"]
    loops, notes = loops_of_series(read_joint_recording(made.write(tmp_path, block="series")).series)
    assert loops.cycles.tolist() == list(range(1, periods + 1))
    assert not any("no whole cycle" in note.text for note in notes)
    assert_readings(loops, exact, mu=4e-3, stiffness=3e-2, lengths=1e-2)


@pytest.mark.parametrize(("stated", "told"), [("100 Hz", 0), ("120 Hz", 0), ("0.1 Hz", 1), ("100 kHz", 1)])
def test_a_series_at_quite_another_frequency_than_stated_is_told(tmp_path, make, stated, told):
    made = make(cycles=(0,), repeats=1, periods=6.2, excitation=False)
    del made.columns["cycle"], made.columns["repeat"]
    folder = made.write(tmp_path, block="series")
    toml = folder / "recording.toml"
    toml.write_text(toml.read_text().replace('"100 Hz"', f'"{stated}"'))
    assert len(notes_about(read_joint_recording(folder), "cycles come at 100 Hz where")) == told


def test_series_cycle_with_a_long_hole_is_left_out(tmp_path, make):
    made = make(cycles=(0,), repeats=1, periods=6.2, excitation=False)
    del made.columns["cycle"], made.columns["repeat"]
    made.columns["friction_force"][450:480] = np.nan
    recording = read_joint_recording(made.write(tmp_path, block="series"))
    loops, notes = loops_of_series(recording.series)
    assert loops.cycles.tolist() == [1, 3, 4, 5]
    assert any("cycles left out" in note.text for note in notes)


@pytest.mark.parametrize("half_width", [2, 3, 6, 15])
def test_smoothing_leaves_parabolas_and_shifts_a_kink_as_derived(half_width):
    j = np.arange(400.0)
    ramp = 3.0 - 0.2 * j + 0.01 * j * j
    inside = slice(half_width, -half_width)
    assert periods.smoothed(ramp, half_width)[inside] == pytest.approx(ramp[inside], rel=1e-12)
    slope = 0.7
    kink = slope * np.maximum(0.0, j - 200.0)
    shift = periods.smoothed(kink, half_width) - kink
    m = half_width
    closed = slope * 3.0 * m * (m + 1) * (m + 2) * (m - 1) / 4.0 / ((2 * m - 1) * (2 * m + 1) * (2 * m + 3))
    assert shift[200] == pytest.approx(closed, rel=1e-9)
    far = np.abs(j - 200.0) >= half_width
    assert np.abs(shift[far][half_width:-half_width]).max() < 1e-9


def test_noise_is_measured_beside_kinks_and_jumps(spring_slider):
    rng = np.random.default_rng(4)
    turns = np.arange(200) / 200
    for stiffness in (20e6, 1e12):
        loops = spring_slider(turns, stiffness=stiffness)[1] + 0.5 * rng.standard_normal((400, 200))
        assert periods.noise_sd(loops).mean() == pytest.approx(0.5, rel=0.04)


@pytest.mark.parametrize("kind", ["fretting-rig", "imposed-displacement"])
def test_a_normal_load_in_the_wrong_unit_is_named(tmp_path, make, kind):
    made = make()
    made.test.update(kind=kind, normal_load="60 kN")
    with pytest.raises(UnreliableRecordingError, match=r"friction_force: .*normal load of 60 kN.*and normal_load"):
        read_joint_recording(made.write(tmp_path))


@pytest.mark.parametrize(("stiffness", "taken"), [(5e4, True), (2e5, False)])
def test_only_loops_that_slide_most_of_their_way_tell_friction(tmp_path, make, stiffness, taken):
    """They enclose 1 - 0.3 N / (stiffness 8 um) of the rectangle around them: 0.25 and 0.81."""
    folder = make(mu=(0.005, 0.005), stiffness=stiffness).write(tmp_path)
    if taken:
        assert read_joint_recording(folder).loops.force.max() == pytest.approx(0.3, rel=1e-3)
    else:
        with pytest.raises(UnreliableRecordingError, match=r"0\.005 times the normal load"):
            read_joint_recording(folder)


@pytest.mark.parametrize(("channel", "heading"), [
    ("displacement", "friction_force_N"), ("displacement", "friction_force"), ("displacement", "x [N]"),
    ("friction_force", "Displacement (um)"), ("friction_force", "velocity_mm/s"), ("time", "displacement_um")])
def test_a_column_whose_heading_says_that_it_is_something_else_is_refused(tmp_path, make, channel, heading):
    made = make()
    folder = made.write(tmp_path)
    own = {"displacement": "displacement_um", "friction_force": "force_N", "time": "time_s"}[channel]
    for name in ("recording.toml", "loops.csv"):
        text = (folder / name).read_text()
        if channel != "displacement":
            text = text.replace("displacement_um", "travel_um")
        (folder / name).write_text(text.replace(own, heading))
    with pytest.raises(UnreliableRecordingError, match=rf"loops\.{channel}: its column .* says that it is of"):
        read_joint_recording(folder)


@pytest.mark.parametrize("heading", ["travel", "x", "Weg [um]", "disp_sensor", "d_um", "position mm_s"])
def test_headings_in_words_of_one_s_own_are_taken(tmp_path, make, exact, heading):
    folder = make().write(tmp_path)
    for name in ("recording.toml", "loops.csv"):
        (folder / name).write_text((folder / name).read_text().replace("displacement_um", heading))
    assert_readings(read_joint_recording(folder).loops, exact)
