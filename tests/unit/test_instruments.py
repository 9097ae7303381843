"""Faults of the instruments of a rig, on loops that satisfy its equations of motion exactly.

What carries the weight: the contact plays no part. Any friction force, with the motion that the rig makes of it, has no
fault; a wrong unit, gain, delay or a channel that saturates is told with its size. The same on recordings of an
independent rig, unchanged and with one channel altered.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.case.config import Rig
from fretflow.core.units import parse_quantity
from fretflow.experiments.rig import instruments
from fretflow.experiments.rig.equations import Equations
from fretflow.experiments.rig.hum import hum_between_repeats
from fretflow.experiments.rig.instruments import _small_gains, doubts, faults
from fretflow.experiments.rig.run import RigTools, diagnose_rig
from fretflow.experiments.rig.setup import case_of
from fretflow.inference.words import headline
from fretflow.recordings.kinds import read_recording
from fretflow.recordings.loopset import LoopSet
from fretflow.recordings.recording import Recording
from fretflow.structure.two_mass_rig.lumped import LumpedRig

SAMPLES, FREQUENCY, LOAD = 100, 100.0, 60.0
OMEGA = 2.0 * np.pi * FREQUENCY


class Loops:
    """Loops of displacement and friction force, one repeat each."""

    force_name = "friction_force"

    def __init__(self, channels: dict[str, np.ndarray]) -> None:
        self.channels = {name: values[:, None] for name, values in channels.items()}
        self.phase = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
        self.cycles = np.arange(len(channels["displacement"]))
        self.usable = np.ones((len(self.cycles), 1), dtype=bool)
        self.repeats = self.usable.sum(axis=1)

    def mean(self, name: str) -> np.ndarray:
        """Return the loops (K, N)."""
        return np.asarray(self.channels[name][:, 0])


def recorded(gain: float = 1.0, late: float = 0.0, limit: float = np.inf) -> tuple[Any, Any]:
    """Return a recording of four loops at other drives and friction forces, and its case; the force sensor is wrong."""
    rig = Rig()
    solved = LumpedRig.from_modes(rig.moving_mass, rig.arm_mass, rig.in_phase_frequency, rig.out_of_phase_frequency,
                                  rig.damping_ratio)
    receptance = np.linalg.inv(solved.impedance(np.array([OMEGA])))[0]
    turn = np.exp(1j * OMEGA / FREQUENCY * np.arange(SAMPLES) / SAMPLES)
    drive, friction = np.array([50.0, 60.0, 70.0, 60.0]), np.array([48.0, 50.0, 52.0, 40.0]) * np.exp(
        1j * np.array([-1.0, -0.8, -0.7, -0.5]))
    motion = receptance[1, 0] * drive - receptance[1, 1] * friction
    noise = 0.05 * np.random.default_rng(1).standard_normal((4, SAMPLES))
    shown = gain * friction * np.exp(-1j * OMEGA * late)
    loops = {"displacement": np.real(np.outer(motion, turn)), "excitation": np.real(np.outer(drive, turn)),
             "friction_force": np.clip(np.real(np.outer(shown, turn)) + abs(gain) * noise, -limit, limit)}
    test = SimpleNamespace(excitation_amplitude=60.0, excitation_frequency=FREQUENCY, normal_load=LOAD)
    wear = SimpleNamespace(worn_volume=None)
    return SimpleNamespace(loops=Loops(loops), sweep=None, test=test, wear=wear), SimpleNamespace(rig=rig)


def test_a_rig_in_motion_with_any_friction_has_no_fault() -> None:
    """The loops satisfy the equations of motion."""
    assert faults(*recorded()) == ()


@pytest.mark.parametrize(("change", "said"), [
    ({"gain": 1e-3}, "friction force is 0.001 times what the rig's masses"),
    ({"gain": 3.0}, "friction force is 3 times"),
    ({"gain": -1.0}, "friction force is recorded with its sign reversed"),
    ({"late": 5e-4}, "friction force comes 500 µs late"), ({"limit": 42.0}, "friction force saturates at 42 N in")])
def test_a_fault_is_told_with_its_size(change: dict[str, float], said: str) -> None:
    """Unit, gain, sign, delay and saturation of the force."""
    found = faults(*recorded(**change))
    assert said in found[0]


def test_what_effects_of_the_catalogue_do_is_no_fault() -> None:
    """A delay of a filter is left to the diagnosis; where nothing is repeated, so is a gain that is off by a fifth."""
    assert faults(*recorded(late=2e-4)) == ()
    assert faults(*recorded(gain=1.2)) == ()


def test_loops_without_a_record_of_their_drive_tell_no_gain() -> None:
    """Their phase is counted from the displacement, so that the stated drive's is not known."""
    recording, case = recorded()
    loops = recording.loops.channels
    del loops["excitation"]
    for name, values in loops.items():
        loops[name] = np.roll(values, SAMPLES // 3, axis=-1)
    assert faults(recording, case) == ()


@pytest.mark.parametrize(("scale", "ringing", "told"), [(1.0, 250.0, False), (10.0, 0.0, True), (10.0, 250.0, True)])
def test_a_force_that_rings_is_no_wrong_unit(scale: float, ringing: float, told: bool) -> None:
    """Both have peaks beyond what friction has under the load; what rings dissipates no more for them."""
    recording, case = recorded()
    loops = recording.loops.channels
    del loops["excitation"]
    loops["friction_force"] = scale * loops["friction_force"] + ringing * np.cos(5.0 * recording.loops.phase)
    assert (["no dry contact" in one for one in faults(recording, case)] == [True]) is told


def test_further_forces_on_the_rig_are_no_fault_of_an_instrument() -> None:
    """A force that follows the cube of the motion, of the size of the drive: no two gains make the equations hold."""
    recording, case = recorded()
    x = recording.loops.channels["displacement"]
    drive = recording.loops.channels["excitation"]
    recording.loops.channels["excitation"] = drive - 3.0 * np.abs(drive).max() * (x / np.abs(x).max())**3
    assert faults(recording, case) == ()


UNCHANGED = ("example_baseline", "example_run_in", *(f"second_rig_{k}" for k in range(1, 8)))


def altered(recording: Recording, name: str, change: Callable[[LoopSet, np.ndarray], np.ndarray]) -> Recording:
    """Return a recording one of whose channels is `change` of its loops and itself (K, R, N)."""
    own, swept = (replace(loops, channels={**loops.channels, name: change(loops, np.array(loops.channels[name]))})
                  for loops in (recording.loops, recording.sweep.loops))
    return replace(recording, loops=own, sweep=replace(recording.sweep, loops=swept))


def said(recording: Recording) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return faults and doubts of a recording."""
    case = case_of(recording)
    return faults(recording, case), doubts(recording, case)


@pytest.mark.real_data
@pytest.mark.parametrize("name", UNCHANGED)
def test_nothing_is_told_of_unchanged_recordings(name: str, recordings: Path) -> None:
    """Whatever physics is hidden in them."""
    assert said(read_recording(recordings / name)) == ((), ())


@pytest.mark.real_data
@pytest.mark.parametrize("size", [0.9, 1.1])
@pytest.mark.parametrize("name", ["friction_force", "excitation"])
def test_a_small_gain_is_told_with_its_size(name: str, size: float, recordings: Path) -> None:
    """Within its interval, of the channel that has it alone."""
    recording = altered(read_recording(recordings / "example_baseline"), name, lambda _, values: size * values)
    (told,), doubted = said(recording)
    low, high = map(float, re.search(r"\((\S+) to (\S+)\)", told).groups())
    assert told.startswith(f"the {name.replace('_', ' ')} is ")
    assert low <= size <= high
    assert round(high - low, 3) <= 0.03
    assert not doubted


def test_noise_of_channels_makes_no_gain_smaller() -> None:
    """A regressor with a noise of a fifth of its size has plain least squares find 1 / 1.04 of its factor."""
    rng = np.random.default_rng(1)
    loop, harmonic = (own.ravel() for own in np.meshgrid(np.repeat(np.arange(40), 40), np.arange(1, 6)))
    key = 6 * loop + harmonic

    def drawn(size: float, rows: np.ndarray) -> np.ndarray:
        values = size * (rng.standard_normal((2, rows.max() + 1)).T @ [1.0, 1.0j])
        return values[rows]

    x, force, every = drawn(1.0, key), drawn(1.0, key), np.arange(len(key))
    found = Equations(x / 0.9 + force, x + drawn(0.2, every), force + drawn(0.2, every), drawn(1.0, key),
                      drawn(1.0, key), harmonic.astype(float), harmonic, loop, every // 5, loop).solve()
    sd = np.sqrt(np.diag(found.covariance))
    assert np.abs(found.values - [1.0 / 0.9, 0.0, 1.0, 0.0, 0.0, 0.0]) == pytest.approx(np.zeros(6), abs=4.0 * sd.max())
    assert found.values[0] - found.attenuated[0] == pytest.approx(1.0 / 0.9 / 1.04, rel=0.02)
    assert not found.holds


def test_gains_are_no_surer_than_the_repeats_that_tell_them() -> None:
    """Each of 32 repeats has a gain of its own in all of its harmonics: what is found scatters as much as is told."""
    rng = np.random.default_rng(2)
    repeat, harmonic = (own.ravel() for own in np.meshgrid(np.arange(32), np.arange(1, 6), indexing="ij"))
    loop = repeat // 4

    def drawn(size: float, rows: np.ndarray) -> np.ndarray:
        values = size * (rng.standard_normal((2, rows.max() + 1)).T @ [1.0, 1.0j])
        return values[rows]

    found, told = [], []
    for _ in range(200):
        x, force, other, damped = (drawn(1.0, 6 * loop + harmonic) for _ in range(4))
        gains = 1.0 + 0.05 * rng.standard_normal((2, 32))[:, repeat]
        one = Equations(x + force + drawn(1e-3, np.arange(160)), x * gains[0], force * gains[1], other, damped,
                        harmonic.astype(float), harmonic, loop, repeat, loop).solve()
        found.append(one.values[[0, 2]])
        told.append(np.sqrt(np.diag(one.covariance)[[0, 2]]))
    assert np.std(found, axis=0) == pytest.approx(np.mean(told, axis=0), rel=0.25)


@pytest.mark.real_data
def test_a_displacement_gain_is_told_beside_the_mass_that_explains_the_same(recordings: Path) -> None:
    """Receptances go with the total mass: 10.5 / 0.9 kg less the arm's 0.5 kg are 11.7 % above 10 kg."""
    recording = altered(read_recording(recordings / "example_baseline"), "displacement", lambda _, values: 0.9 * values)
    told, (doubted,) = said(recording)
    found = re.search(r"would be (\S+) % above the file's: a displacement gain of (\S+) ", doubted)
    mass, gain = map(float, found.groups())
    assert not told
    assert mass == pytest.approx(11.7, abs=1.0)
    assert gain == pytest.approx(0.9, abs=0.01)


@pytest.mark.real_data
@pytest.mark.parametrize("size", [-0.2, 0.05])
@pytest.mark.parametrize("name", ["displacement", "friction_force", "excitation"])
def test_a_gain_that_drifts_is_told_with_its_size(name: str, size: float, recordings: Path) -> None:
    """It goes with the root of the cycles, as no law here knows."""
    recording = read_recording(recordings / "example_baseline")
    last = recording.loops.cycles[-1]

    def drift(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        share = np.sqrt(loops.cycles / last) if loops is recording.loops else np.ones(len(loops.cycles))
        return values * (1.0 + size * share)[:, None, None]

    (told,), _ = said(altered(recording, name, drift))
    found = re.fullmatch(r"the gain of the (.+) drifts: at 300,000 cycles it is (\S+) times that at 0", told)
    assert found.group(1) == name.replace("_", " ")
    assert float(found.group(2)) == pytest.approx(1.0 + size, abs=0.015)


@pytest.mark.real_data
@pytest.mark.parametrize("share", [-0.3, 0.03, 0.1, 0.3])
@pytest.mark.parametrize("law", [lambda x: x**3, lambda x: np.abs(x) * x,
                                 lambda x: np.gradient(x, axis=-1) * x.shape[-1] / (2.0 * np.pi)])
def test_further_forces_on_a_recorded_rig_are_no_gain(law: Callable[[np.ndarray], np.ndarray], share: float,
                                                      recordings: Path) -> None:
    """A support or a damper of up to a third of the drive, of either sign: neither a fault nor another mass."""
    recording = read_recording(recordings / "example_baseline")

    def drive(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        lines = np.fft.rfft(np.nanmean(loops.channels["displacement"], axis=1, keepdims=True))
        lines[..., 0] = lines[..., 13:] = 0.0
        return values + share * 60.0 * law(np.fft.irfft(lines, values.shape[-1]) / 20e-6)

    assert said(altered(recording, "excitation", drive)) == ((), ())


def test_friction_that_differs_from_repeat_to_repeat_is_no_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    """What repeats of a force differ by is no error of its sensor where the drive answers to it."""
    rng = np.random.default_rng(3)
    repeat, harmonic = (own.ravel() for own in np.meshgrid(np.arange(80), np.arange(1, 6), indexing="ij"))
    loop, every = repeat // 4, np.arange(400)

    def drawn(size: float, rows: np.ndarray) -> np.ndarray:
        values = size * (rng.standard_normal((2, rows.max() + 1)).T @ [1.0, 1.0j])
        return values[rows]

    made: dict[str, Any] = {}
    monkeypatch.setattr(instruments.Equations, "of", lambda *_: made["equations"])
    monkeypatch.setattr(instruments, "further_forces", lambda *_: [])
    recording, told, apart = SimpleNamespace(loops=Loops({"displacement": np.zeros((1, 2))})), 0, []
    recording.loops.calibration_sd = {}
    for _ in range(100):
        x, force, other, damped = (drawn(1.0, 6 * loop + harmonic) for _ in range(4))
        force = force + drawn(0.1, every)
        made["equations"] = Equations(x + force + drawn(0.1, every), x, force, other, damped, harmonic.astype(float),
                                      harmonic, loop, repeat, loop)
        solved = made["equations"].solve()
        apart.append((solved.values[2] - 1.0) / np.sqrt(solved.covariance[2, 2]))
        told += bool(_small_gains(recording, SimpleNamespace(rig=Rig()))[0])
    assert np.mean(apart) > 1.0  # that sd off, by what is taken off for errors
    assert told <= 1


def test_noise_that_a_filter_has_passed_is_no_hum() -> None:
    """Interpolation, as of periods that are sampled anew, takes off high frequencies of noise and leaves the low."""
    rng, frequency, told = np.random.default_rng(8), np.array([122.0, 122.0]), []
    for _ in range(500):
        white = rng.standard_normal((2, 3, SAMPLES + 1))
        passed = 0.85 * white[..., :-1] + 0.15 * white[..., 1:]
        loops = SimpleNamespace(channels={"normal_force": 50.0 + 0.1 * passed}, phase=np.arange(SAMPLES),
                                repeats=np.full(2, 3), usable=np.ones((2, 3), dtype=bool))
        found = hum_between_repeats([(loops, frequency)], "normal_force", 50.0)
        told += [] if found is None else [found[0]]
    assert 0.02 < np.mean(np.array(told) < 0.05) < 0.08  # uniform but for three standard errors


@pytest.mark.real_data
@pytest.mark.parametrize("share", [3.0, 10.0])
@pytest.mark.parametrize("power", [1.0, 2.5, 3.0])
def test_a_spring_that_turns_the_motion_is_no_reversed_sign(power: float, share: float, recordings: Path) -> None:
    """A support of thrice the drive and more holds the block below its resonance: in phase instead of against it."""
    loops = read_recording(recordings / "example_baseline").loops
    motion = np.nanmean(loops.channels["displacement"], axis=1, keepdims=True)
    x = (motion - motion.mean(axis=-1, keepdims=True)) / 20e-6
    drive = loops.channels["excitation"] + share * 60.0 * np.sign(x) * np.abs(x)**power
    own = replace(loops, channels={**loops.channels, "excitation": drive})
    assert said(replace(read_recording(recordings / "example_baseline"), loops=own, sweep=None)) == ((), ())


@pytest.mark.real_data
def test_a_force_in_step_with_the_friction_s_fundamental_is_no_gain_of_it(recordings: Path) -> None:
    """By its first harmonic the friction force would be a third of what it is; by the others, all of it."""
    recording = read_recording(recordings / "example_baseline")
    rig = case_of(recording).rig
    solved = LumpedRig.from_modes(rig.moving_mass, rig.arm_mass, rig.in_phase_frequency, rig.out_of_phase_frequency,
                                  rig.damping_ratio)

    def drive(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        lines = np.fft.rfft(np.nanmean(loops.channels["friction_force"], axis=1, keepdims=True))
        lines[..., 0] = lines[..., 2:] = 0.0
        receptance = np.linalg.inv(solved.impedance(2.0 * np.pi * np.asarray(loops.frequency)))
        turned = (receptance[:, 1, 1] / receptance[:, 1, 0])[:, None, None] * lines
        return values + 2.0 * np.fft.irfft(turned, values.shape[-1])

    assert said(altered(recording, "excitation", drive))[0] == ()


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "size", "anew"), [
    ("displacement", 0.4e-6, False), ("friction_force", 2.0, False), ("displacement", 0.4e-6, True),
    ("excitation", 2.0, False), ("excitation", 6.0, True), ("friction_force", 5.0, True)])
def test_hum_is_told_with_its_size(name: str, size: float, anew: bool, recordings: Path) -> None:
    """Of 50 Hz, in periods of 10 ms that cannot tell it from 60."""
    recording, rng = read_recording(recordings / "example_baseline"), np.random.default_rng(7)
    swept = np.array([one.excitation_frequency for one in recording.sweep.conditions])

    def humming(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        frequency = np.full(len(loops.cycles), 100.0) if loops is recording.loops else swept
        turns = np.arange(values.shape[2]) / values.shape[2] / frequency[:, None, None]
        begin = 0.0 if anew else rng.uniform(0.0, 2.0 * np.pi, (*values.shape[:2], 1))
        return values + size * np.sin(2.0 * np.pi * 50.0 * turns + begin)

    (told,), _ = said(altered(recording, name, humming))
    found = re.match(r"the (.+) has a hum of the mains, (.+) to (.+) in all", told)
    low, high = (parse_quantity(found.group(k), "m" if name == "displacement" else "N") for k in (2, 3))
    assert found.group(1) == name.replace("_", " ")
    assert 0.75 * low < size < 1.25 * high


@pytest.mark.real_data
@pytest.mark.parametrize("late", [100e-6, -60e-6, 1e-3])
@pytest.mark.parametrize("name", ["displacement", "excitation"])
def test_a_channel_that_is_not_in_step_is_told_with_its_delay(name: str, late: float, recordings: Path) -> None:
    """Within what a channel is in step with the drive anyway; higher harmonics are turned by half a period."""
    recording = read_recording(recordings / "example_baseline")
    swept = np.array([one.excitation_frequency for one in recording.sweep.conditions])

    def delayed(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        turns = late * (np.full(len(loops.cycles), FREQUENCY) if loops is recording.loops else swept)
        lines = np.fft.rfft(values, axis=2)
        turning = np.exp(-2j * np.pi * np.outer(turns, np.arange(lines.shape[2])))
        return np.fft.irfft(turning[:, None] * lines, values.shape[2], axis=2)

    (told,), _ = said(altered(recording, name, delayed))
    found = re.match(rf"the {name} comes (\d+) µs (early|late) against", told)
    assert float(found.group(1)) * (1e-6 if found.group(2) == "late" else -1e-6) == pytest.approx(late, abs=20e-6)


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "by"), [("displacement", 8e-6), ("friction_force", -6.0), ("excitation", 6.0)])
def test_a_zero_that_drifts_is_told_with_its_size(name: str, by: float, recordings: Path) -> None:
    """Of the channel whose mean no other follows, as the rig at rest would have it."""
    recording = read_recording(recordings / "example_baseline")

    def drift(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        share = loops.cycles / loops.cycles[-1] if loops is recording.loops else np.ones(len(loops.cycles))
        return values + by * share[:, None, None]

    (told,), _ = said(altered(recording, name, drift))
    found = re.fullmatch(rf"the zero of the {name.replace('_', ' ')} drifts by (.+) over the test", told)
    assert parse_quantity(found.group(1), "m" if name == "displacement" else "N") == pytest.approx(by, rel=0.25)


@pytest.mark.real_data
def test_a_friction_force_that_grows_to_one_side_is_no_drift_of_a_zero(recordings: Path) -> None:
    """The rig at rest follows it: ``H_aa = 1 / k_g + 1 / k_h``."""
    recording = read_recording(recordings / "example_baseline")
    rig = recording.rig or Rig()
    ground = (rig.moving_mass + rig.arm_mass) * (2.0 * np.pi * rig.in_phase_frequency)**2
    share = (recording.loops.cycles / recording.loops.cycles[-1])[:, None, None]
    moved = {"friction_force": 10.0 * share, "displacement": -10.0 / ground * share}
    loops = replace(recording.loops, channels={
        name: values + moved.get(name, 0.0) for name, values in recording.loops.channels.items()})
    assert said(replace(recording, loops=loops))[0] == ()


REVERSED = [(recording, name) for recording in UNCHANGED for name in ("excitation", "displacement", "friction_force")
            if (recording, name) != ("second_rig_2", "friction_force")]  # play leaves a ninth of it: no clear case


@pytest.mark.real_data
@pytest.mark.parametrize(("recording", "name"), REVERSED)
def test_a_channel_with_its_sign_reversed_is_told_by_its_name(recording: str, name: str, recordings: Path) -> None:
    """And not as columns that are swapped, which in gross slip differ little from a reversed displacement."""
    told, _ = said(altered(read_recording(recordings / recording), name, lambda _, values: -values))
    assert told == (f"the {name.replace('_', ' ')} is recorded with its sign reversed",)


@pytest.mark.real_data
def test_columns_that_are_swapped_are_told(recordings: Path) -> None:
    """Both are forces, so that no unit tells."""
    recording = read_recording(recordings / "example_baseline")

    def swapped(loops: LoopSet) -> LoopSet:
        channels = dict(loops.channels)
        channels["excitation"], channels["friction_force"] = channels["friction_force"], channels["excitation"]
        return replace(loops, channels=channels)

    recording = replace(recording, loops=swapped(recording.loops),
                        sweep=replace(recording.sweep, loops=swapped(recording.sweep.loops)))
    assert said(recording)[0][0].startswith("excitation and friction force are swapped")


@pytest.mark.real_data
@pytest.mark.parametrize("share", [0.9, 0.7])
@pytest.mark.parametrize("name", ["displacement", "friction_force", "excitation"])
def test_a_clipped_channel_saturates_and_a_coarse_one_does_not(name: str, share: float, recordings: Path) -> None:
    """Eight bits leave a twentieth of a sine on its last step, as a limit would."""
    recording = read_recording(recordings / "example_baseline")
    most = float(np.nanmax(np.abs(recording.loops.channels[name])))
    clipped = altered(recording, name, lambda _, values: np.clip(values, -share * most, share * most))
    assert said(clipped)[0][0].startswith(f"the {name.replace('_', ' ')} saturates at ")
    step = most / 2**7
    assert said(altered(recording, name, lambda _, values: step * np.round(values / step)))[0] == ()


@pytest.mark.real_data
def test_hum_of_the_normal_force_is_told(recordings: Path) -> None:
    """A channel that no equation of motion holds: its repeats differ by the hum, those of motion and force do not."""
    recording, rng = read_recording(recordings / "example_baseline"), np.random.default_rng(3)

    def pressed(loops: LoopSet, size: float) -> LoopSet:
        shape = loops.channels["displacement"].shape
        turns = np.arange(shape[2]) / shape[2] / FREQUENCY
        hum = size * np.sin(2.0 * np.pi * 50.0 * turns + rng.uniform(0.0, 2.0 * np.pi, (*shape[:2], 1)))
        pressing = LOAD + hum + 0.3 * rng.standard_normal(shape)
        return replace(loops, channels={**loops.channels, "normal_force": pressing})

    for size, expected in ((0.0, 0), (2.0, 1)):
        changed = replace(recording, loops=pressed(recording.loops, size),
                          sweep=replace(recording.sweep, loops=pressed(recording.sweep.loops, size)))
        told, _ = said(changed)
        assert len(told) == expected
        assert all(one.startswith("the normal force has a hum of the mains") for one in told)


@pytest.mark.real_data
@pytest.mark.parametrize("factor", [1e-3, 1e9])
def test_cycles_or_volumes_of_another_unit_are_told(factor: float, recordings: Path) -> None:
    """In thousands the cycles had been explained, by a wear coefficient of 1.1e-11 m^2/N and nothing else."""
    recording = read_recording(recordings / "example_baseline")
    if factor < 1.0:
        loops = replace(recording.loops, cycles=np.round(factor * recording.loops.cycles).astype(int))
        recording = replace(recording, loops=loops)
    else:
        wear = recording.wear.model_copy(update={
            name: getattr(recording.wear, name) / factor for name in ("worn_volume", "worn_volume_sd")})
        recording = replace(recording, wear=wear)
    (told,), _ = said(recording)
    assert told.startswith("the worn volume would be that of a wear coefficient of 1.1e-")
    assert "counted in thousands" in told
    (told,), _ = said(altered(recording, "displacement", lambda _, values: 1e-3 * values))
    assert told.startswith("the displacement is 0.000")  # which explains the volume too


@pytest.mark.real_data
def test_instruments_at_fault_are_no_missing_physics(recordings: Path, tmp_path: Path) -> None:
    """Neither the headline nor the page speaks of the catalogue."""
    recording = read_recording(recordings / "example_baseline")
    recording = altered(recording, "friction_force", lambda _, values: 3.0 * values)
    diagnosis = diagnose_rig(recording, True, lambda share, text: None, RigTools(reduce=None, pool=None))
    assert headline(diagnosis) == "Instruments at fault"
    page = diagnosis.to_html(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Instruments at fault" in page
    assert "Not in the catalogue" not in page
    assert "the catalogue lacks" not in page
    assert "refitted" not in page
    assert "p = " not in page


@pytest.mark.real_data
@pytest.mark.parametrize(("share", "phase"), [(0.1, 0.0), (0.1, 2.4), (0.4, 2.4)])
def test_loops_that_come_again_every_second_period_tell_nothing_of_their_sensors(share: float, phase: float,
                                                                                 recordings: Path) -> None:
    """Two repeats that differ by half the drive's frequency, in all that moves: no errors of the channels."""
    recording = read_recording(recordings / "example_baseline")

    def swinging(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        way = np.where(np.arange(values.shape[1]) < 2, (-1.0)**np.arange(values.shape[1]), np.nan)
        return values + share * np.nanmax(np.abs(values)) * way[:, None] * np.cos(0.5 * loops.phase + phase)

    for name in ("displacement", "friction_force"):
        recording = altered(recording, name, swinging)
    assert said(recording) == ((), ())


@pytest.mark.real_data
def test_columns_that_a_file_swaps_are_told(recordings: Path, tmp_path: Path) -> None:
    """What is read as friction force then is aligned, cleaned and repeated as one."""
    for file in (recordings / "example_baseline").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    table = tmp_path / "recording.toml"
    names = {"friction_force_N": "excitation_N", "excitation_N": "friction_force_N"}
    table.write_text(re.sub("|".join(names), lambda one: names[one.group()], table.read_text()))
    assert said(read_recording(tmp_path))[0][0].startswith("excitation and friction force are swapped")
