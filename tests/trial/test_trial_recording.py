"""Concealed recordings: composition, what each effect does, and the files as the program under test reads them."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.effects.catalogue import parse_effects
from fretflow.recordings.recording import read_joint_recording
from fretflow_trial import make
from fretflow_trial.campaign import Plan, Test
from fretflow_trial.case import LISTED, MOST_DRAWS, UNLISTED, Case, Simulated, compose, draw, key, simulate
from fretflow_trial.contact import UnsettledContactError
from fretflow_trial.hidden import CATALOGUE, Facts
from fretflow_trial.joint import specimens
from fretflow_trial.period import March
from fretflow_trial.physics import Condition, Physics, Slow
from fretflow_trial.record import write
from fretflow_trial.rig import Rig
from fretflow_trial.signal import signal_of
from numpy.random import SeedSequence

CHANNELS = ("displacement", "friction_force", "normal_force", "approach")


@dataclass(frozen=True)
class Short:
    """A short test, its recording and its answer."""

    case: Case
    simulated: Simulated


@pytest.fixture(scope="module")
def short() -> Short:
    """Return a short test with friction at 0.8 where the baseline's is 0.82, and its signal."""
    drawn = draw("nothing", (), SeedSequence(4))
    main = Condition(60.0, 58.0)
    plan = Plan(main, (0, 3000), (replace(main, load=45.0),), steps=200)
    case = replace(drawn, plan=plan, channels=CHANNELS, drive_recorded=True)
    outcome = Test(specimens(), case.physics, plan).run()
    other = replace(case.physics, friction=1.02 * case.physics.friction)
    seen, rates = signal_of(specimens(), outcome, other, plan, case.noise, case.seen, case.repeats)
    return Short(case, Simulated(case, outcome, rates, {"friction": seen}))


def test_composition_has_its_shares_and_comes_again() -> None:
    cases = compose(40, 11)
    assert Counter(kind for kind, _, _, _ in cases) == {"nothing": 8, "unlisted": 8, "pair": 8, "single": 16}
    for kind, names, _, _ in cases:
        assert len(set(names)) == len(names) == {"nothing": 0, "pair": 2}.get(kind, 1)
        assert set(names) <= set(UNLISTED if kind == "unlisted" else LISTED)
    assert Counter(names[0] for kind, names, _, _ in cases if kind == "single").most_common(1)[0][1] == 1
    assert [case[:2] for case in compose(40, 11)] == [case[:2] for case in cases]
    assert [case[:2] for case in compose(40, 12)] != [case[:2] for case in cases]
    assert len(compose(7, 1)) == 7
    for kind in ("nothing", "single"):
        assert len(set(Counter(world for own, _, _, world in cases if own == kind).values())) == 1
    assert {world for *_, world in compose(40, 11, 4)} == {4}


def test_listed_effects_are_the_catalogues_with_its_parameters() -> None:
    facts = Facts(300_000, 60.0, 60.0, Rig().hinge)
    rng = np.random.default_rng(0)
    for name, one in LISTED.items():
        hidden = one(rng, False, facts)
        (effect,) = parse_effects({name: {}}, "test")
        assert (hidden.id, hidden.listed, hidden.law) == (name, True, CATALOGUE)
        assert set(hidden.parameters) <= set(type(effect).model_fields)
        assert type(effect).block.value in hidden.blocks
    assert not set(UNLISTED) & set(LISTED)


@pytest.mark.parametrize("other", [False, True])
@pytest.mark.parametrize("name", [*LISTED, *UNLISTED])
def test_every_effect_changes_what_it_should(name: str, other: bool) -> None:
    joint, rng = specimens(), np.random.default_rng(3)
    hidden = {**LISTED, **UNLISTED}[name](rng, other, Facts(100_000, 60.0, 60.0, Rig().hinge))
    depth = 2e-6 * (1.0 + 2e3 * np.abs(joint.nodes[:, 0]))
    slow = Slow(80_000.0, 150.0, depth, 0.1 * depth, 12e-6, 0.8)
    seen = []
    for physics in (Physics(), hidden.apply(Physics())):
        march = March(joint, physics, Condition(), slow, np.full(joint.size, 60e6), steps=100)
        settled = march.settle(most=2)
        channels = march.channels(settled.track, 1)
        for sensor in physics.sensors:
            channels = sensor(channels, slow)
        worn = march.worn(settled.track)
        rate = np.prod([np.ones(joint.size), *(factor(worn, slow) for factor in physics.wear_factors)], axis=0)
        samples = slice(0, 100)
        seen.append(np.concatenate([channels.displacement[samples] / 12e-6, channels.friction_force[samples] / 50.0,
                                    channels.excitation[samples] / 60.0, rate]))
    assert np.all(np.isfinite(seen[1]))
    assert np.max(np.abs(seen[1] - seen[0])) > 1e-3


def test_recording_is_read_as_it_was_measured(short: Short, tmp_path: Path) -> None:
    case, outcome = short.case, short.simulated.outcome
    recording = read_joint_recording(write(short.simulated, tmp_path / "recording", "Fretting rig"))
    assert recording.loops is not None
    assert recording.sweep is not None
    assert recording.wear_depth is not None
    assert recording.loops.cycles.tolist() == [0, 3000]
    assert recording.loops.repeats.tolist() == [3, 3]
    assert {name: recording.loops.calibration_sd[name] for name in CHANNELS} == dict.fromkeys(CHANNELS, 0.004)
    assert recording.sweep.conditions[0].normal_load == 45.0
    assert recording.test.normal_load == case.plan.main.load
    assert recording.rig is not None
    assert recording.rig.moving_mass == case.stated_mass
    for name in CHANNELS:
        ideal = np.stack([getattr(loop, name) for loop in outcome.loops])
        near = 0.015 * np.abs(ideal).max() + 4.0 * case.noise.offset[name]
        assert recording.loops.mean(name) == pytest.approx(ideal, abs=4.0 * case.noise.sample[name] + near)
    assert recording.loops.channels["friction_force"][0].std(axis=0).mean() == pytest.approx(
        case.noise.sample["friction_force"], rel=0.5)
    volume = float(outcome.depth @ specimens().areas)
    assert recording.wear.worn_volume == pytest.approx(volume, rel=0.05, abs=0.0)
    depth = recording.wear_depth.channels["depth"]
    assert depth.mean() == pytest.approx(outcome.depth @ specimens().share, abs=0.05e-6)
    assert "friction" not in (tmp_path / "recording" / "recording.toml").read_text().replace("friction_force", "")


def test_wrong_friction_is_no_signal(short: Short) -> None:
    seen = short.simulated.signals["friction"]
    assert seen.refit[0] == pytest.approx(-0.0196, abs=2e-3)
    assert seen.absorbed > 0.98
    assert seen.rms < 0.1


def test_force_offset_of_a_sensor_has_the_signal_that_it_should(short: Short) -> None:
    case, outcome = short.case, short.simulated.outcome
    shifted = replace(outcome, loops=tuple(replace(loop, friction_force=loop.friction_force + 2.0 * sign)
                                           for loop, sign in zip(outcome.loops, (1.0, -1.0), strict=True)))
    seen, _ = signal_of(specimens(), shifted, case.physics, case.plan, case.noise, case.seen, case.repeats)
    sd = case.noise
    level = np.hypot(sd.sample["friction_force"], sd.offset["friction_force"])
    assert seen.by_channel["friction_force"] == pytest.approx(2.0 / level * np.sqrt(2.0 / 3.0), rel=0.02)
    apart = np.sqrt(2.0 * 2.0**2 / (sd.offset["friction_force"]**2 + sd.sample["friction_force"]**2 / 600.0))
    assert seen.total == pytest.approx(apart, rel=0.05)


def test_without_a_record_of_the_drive_its_phase_is_no_signal(short: Short, tmp_path: Path) -> None:
    """A test that all starts nine degrees later differs from the drive's phase alone, which then nothing tells."""
    case, outcome = short.case, short.simulated.outcome
    late = replace(outcome, **{block: tuple(replace(loop, **{
        name: np.roll(getattr(loop, name), 5) for name in CHANNELS}) for loop in getattr(outcome, block))
        for block in ("loops", "sweep")})
    told, untold = (signal_of(specimens(), late, case.physics, case.plan, case.noise, seen, case.repeats)[0].total
                    for seen in (case.seen, replace(case, drive_recorded=False).seen))
    assert told > 50.0
    assert untold < 1e-6 * told
    undriven = replace(short.simulated, case=replace(case, drive_recorded=False))
    recording = read_joint_recording(write(undriven, tmp_path / "recording", "Fretting rig"))
    assert recording.loops is not None
    assert set(recording.loops.channels) == set(CHANNELS)
    assert recording.loops.aligned_to == "displacement"


def test_key_is_plain_json(short: Short) -> None:
    answer = key(short.simulated)
    assert answer["kind"] == "nothing"
    assert json.loads(json.dumps(answer, allow_nan=False)) == answer


def test_make_writes_a_recording_and_its_key(short: Short, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def quick(kind: str, names: list[str], seed: SeedSequence, world: int, least: float) -> Simulated:
        asked.append((kind, tuple(names), seed.entropy, world, least))
        return replace(short.simulated, signals={})

    monkeypatch.setattr(make, "simulate", quick)
    make.main(["--effect", "viscous", "--seed", "3", "--world", "4", "--least-signal", "15", "--out", str(tmp_path)])
    assert asked == [("single", ("viscous",), 3, 4, 15.0)]
    assert (tmp_path / "recording" / "recording.toml").is_file()
    assert json.loads((tmp_path / "key.json").read_text())["kind"] == "nothing"
    with pytest.raises(SystemExit):
        make.main(["--effect", "no-such-effect", "--out", str(tmp_path)])


def test_draws_that_show_too_little_are_told_apart_from_those_that_do_not_repeat(
        short: Short, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a weak effect it said that no motion repeats."""
    draws, weak = iter(range(MOST_DRAWS)), next(iter(short.simulated.signals.values()))

    def seen(drawn: Case, outcome: object) -> Simulated:
        if next(draws) < 5:
            raise UnsettledContactError("it runs wild")
        return replace(short.simulated, signals={"viscous": weak})

    monkeypatch.setattr("fretflow_trial.case.draw", lambda *_: short.case)
    monkeypatch.setattr(Test, "run", lambda *_: None)
    monkeypatch.setattr("fretflow_trial.case._seen", seen)
    with pytest.raises(RuntimeError, match=f"of {MOST_DRAWS} draws 5 have no motion that repeats, and "
                                           f"{MOST_DRAWS - 5} show less than 1e\\+09 times the noise"):
        simulate("single", ["viscous"], SeedSequence(4), 4, 1e9)
