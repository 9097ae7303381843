"""Faults of the instruments of a rig, on loops that satisfy its equations of motion exactly.

What carries the weight: the contact plays no part. Any friction force, with the motion that the rig makes of it, has no
fault; a wrong unit, gain, delay or a channel that saturates is told with its size. The same on recordings of an
independent rig, unchanged and with one channel altered.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fretflow.case.config import Rig
from fretflow.core.units import parse_quantity
from fretflow.experiments.rig.equations import DELAYS, Equations
from fretflow.experiments.rig.instruments import faults
from fretflow.experiments.rig.run import diagnose_rig
from fretflow.experiments.rig.setup import case_of
from fretflow.experiments.tools import DiagnosisTools
from fretflow.inference.words import headline
from fretflow.recordings.kinds import read_recording
from fretflow.recordings.loopset import LoopSet
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from rig_channels import altered, said

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
    texts = faults(*recorded(**change))
    assert said in texts[0]


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


@pytest.mark.real_data
@pytest.mark.parametrize("name", UNCHANGED)
def test_nothing_is_told_of_unchanged_recordings(name: str, recordings: Path) -> None:
    """Whatever physics is hidden in them."""
    assert said(read_recording(recordings / name)) == ((), ())


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
    match = re.match(rf"the {name} comes (\d+) µs (early|late) against", told)
    assert float(match.group(1)) * (1e-6 if match.group(2) == "late" else -1e-6) == pytest.approx(late, abs=20e-6)


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "by", "repeats"), [
    ("displacement", 8e-6, None), ("friction_force", -6.0, None), ("excitation", 6.0, None), ("displacement", 8e-6, 1)])
def test_a_zero_that_drifts_is_told_with_its_size(name: str, by: float, repeats: int | None, recordings: Path) -> None:
    """Of the channel whose mean no other follows, as the rig at rest would have it; no repeat is needed for that."""
    recording = read_recording(recordings / "example_baseline")
    recording = replace(recording, loops=replace(recording.loops, channels={
        name: values[:, :repeats] for name, values in recording.loops.channels.items()}))

    def drift(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        share = loops.cycles / loops.cycles[-1] if loops is recording.loops else np.ones(len(loops.cycles))
        return values + by * share[:, None, None]

    (told,), _ = said(altered(recording, name, drift))
    match = re.fullmatch(rf"the zero of the {name.replace('_', ' ')} drifts by (.+) over the test", told)
    assert parse_quantity(match.group(1), "m" if name == "displacement" else "N") == pytest.approx(by, rel=0.25)


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
    diagnosis = diagnose_rig(recording, True, lambda share, text: None, DiagnosisTools(reduce=None, pool=None))
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
@pytest.mark.parametrize("guess", [(-2e-4, -1e-4), (1e-4, 0.0), (3e-4, 1e-4)])
@pytest.mark.parametrize(("name", "known"), [("second_rig_2", False), ("second_rig_4", True)])
def test_delays_are_solved_to_the_end_from_any_guess(name: str, known: bool, guess: tuple[float, float],
                                                     recordings: Path) -> None:
    """Where the second step was longer than the first, what had been reached by then was told: none of a rig's play."""
    recording = read_recording(recordings / name)
    equations = Equations.of(recording, LumpedRig.of(case_of(recording).rig))
    assert equations is not None
    synchronised = equations.synchronised(np.array(guess))
    assert synchronised is not None or not known
    if synchronised is not None:
        start = equations.synchronised(np.zeros(2))
        assert start is not None
        errors = np.sqrt(np.diag(start[1].covariance)[DELAYS])
        np.testing.assert_allclose(synchronised[0] / errors, start[0] / errors, atol=0.01)


@pytest.mark.real_data
@pytest.mark.parametrize("compliance", [1e-7, 4e-7])
def test_soft_specimens_are_no_gain_of_the_force(compliance: float, recordings: Path) -> None:
    """Faces that lag behind the arm by more than it moves for the force."""
    recording = read_recording(recordings / "second_rig_1")
    assert said(altered(recording, "displacement", lambda loops, values: np.asarray(
        values - compliance * loops.channels[loops.force_name]))) == ((), ())


@pytest.mark.real_data
def test_specimens_that_yield_otherwise_as_they_wear_are_no_drift_of_a_gain(recordings: Path) -> None:
    """Wear spreads the pressure: the faces lag behind the arm by another compliance from loop to loop."""
    recording = read_recording(recordings / "second_rig_1")

    def yielding(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        force = loops.channels[loops.force_name]
        rise = np.arange(len(loops.cycles)) / len(loops.cycles) if loops is recording.loops else np.ones(len(values))
        return np.asarray(values - 3e-9 * rise[:, None, None] * force)

    assert said(altered(recording, "displacement", yielding)) == ((), ())

    def weaker(loops: LoopSet, values: np.ndarray) -> np.ndarray:
        rise = np.arange(len(loops.cycles)) / len(loops.cycles) if loops is recording.loops else np.ones(len(values))
        return np.asarray(values * (1.0 - 0.05 * rise[:, None, None]))

    (told,), _ = said(altered(recording, "friction_force", weaker))
    assert "gain of the friction force drifts" in told


@pytest.mark.real_data
def test_columns_that_a_file_swaps_are_told(recordings: Path, tmp_path: Path) -> None:
    """What is read as friction force then is aligned, cleaned and repeated as one."""
    for file in (recordings / "example_baseline").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    table = tmp_path / "recording.toml"
    names = {"friction_force_N": "excitation_N", "excitation_N": "friction_force_N"}
    table.write_text(re.sub("|".join(names), lambda one: names[one.group()], table.read_text()))
    assert said(read_recording(tmp_path))[0][0].startswith("excitation and friction force are swapped")
